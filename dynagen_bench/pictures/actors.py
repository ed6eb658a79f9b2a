"""Who acts in a picture: a stored behaviour policy as it made the data, random actions, none, or a policy of one's own.

What is here: the choice by name, and `given_actor`. Called by videos and strips. It must not know frames or files of
pictures.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.best import best_snapshot
from dynagen_bench.collection.episodes import action_noise
from dynagen_bench.collection.policies import POLICY_FOLDER, BehaviourPolicy, load_policies, policy_file
from dynagen_bench.envs import HORIZON

Act = Callable[[NDArray[np.float64], int, float], NDArray[np.float32]]
"""Action (A,) for an observation (S,) at step t, and the reward of the step before, 0 at first."""


class Predicts(Protocol):
    """Whoever `dynagen_bench.evaluate` scores, as `agents.load(run).policy()` or a model of Stable-Baselines3."""

    def predict(self, observation: Any, *, state: Any, episode_start: Any, deterministic: bool) -> Any:
        """Actions (N, A) and the state that the next call is given, for observations (N, S) of N episodes."""


class Actor(NamedTuple):
    """Somebody who acts: what to call it, and reset seed of an episode → how it acts in that episode."""

    label: str
    start: Callable[[int], Act]


def choose_actor(
    policy: str, name: ids.DynamicsId, limit: NDArray[np.floating[Any]], folder: Path = POLICY_FOLDER
) -> Actor:
    """The actor of this name.

    Args:
        policy: `zero`, `random`, `best` (`best_snapshot` of the stored ones), or the environment steps of a stored
            snapshot, `1000000`.
        name: the dynamics whose behaviour policies are meant.
        limit: (A,), the action space is ± this.
        folder: where the policies are.

    Raises:
        ValueError: a name of another form, or a snapshot that is not stored.
        FileNotFoundError: there are no policies of this dynamics; the message says what can be done.
    """
    size = len(limit)
    if policy == "zero":
        return Actor("no action", lambda seed: lambda observation, t, reward: np.zeros(size, np.float32))
    if policy == "random":
        return Actor("random actions", lambda seed: _replay(random_actions(seed, limit)))
    if policy != "best" and not policy.isdecimal():
        raise ValueError(f"unknown policy {policy!r}: write best, random, zero, or a snapshot's steps as 1000000")
    snapshots = stored_snapshots(name, folder)
    step = best_snapshot(name, snapshots) if policy == "best" else int(policy)
    if step not in snapshots:
        known = ", ".join(str(stored) for stored in snapshots)
        raise ValueError(f"{name.env_id} has no snapshot at {step} steps: choose best or one of {known}")
    label = f"policy of {name.label}, {step // 1000}K" if step >= 1000 else f"policy of {name.label}, {step}"
    return Actor(label, lambda seed: _behave(snapshots[step], np.asarray(limit, np.float64), seed))


def given_actor(policy: Predicts) -> Actor:
    """A policy of one's own, called by its class's name; it acts as it does where it is scored, in one episode."""

    def start(seed: int) -> Act:
        state: Any = None

        def act(observation: NDArray[np.float64], t: int, reward: float) -> NDArray[np.float32]:
            nonlocal state
            if t > 0 and hasattr(policy, "observe"):
                policy.observe(np.array([reward]))
            actions, state = policy.predict(
                observation[None], state=state, episode_start=np.array([t == 0]), deterministic=True
            )
            action: NDArray[np.float32] = np.asarray(actions, dtype=np.float32)[0]
            return action

        return act

    return Actor(type(policy).__name__, start)


def stored_snapshots(name: ids.DynamicsId, folder: Path = POLICY_FOLDER) -> dict[int, BehaviourPolicy]:
    """The behaviour policies of a dynamics, environment steps → policy; raises FileNotFoundError if there are none."""
    if name.split == "nominal":
        raise FileNotFoundError(
            "nominal has no behaviour policies: take --policy-of train0, or --policy random or zero"
        )
    try:
        return load_policies(policy_file(name, folder))[0]
    except FileNotFoundError as missing:
        raise FileNotFoundError(f"{missing}, or take --policy random or zero") from None


def random_actions(seed: int, limit: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Uniform actions of a whole episode, (HORIZON, A)."""
    return np.random.default_rng(seed).uniform(-limit, limit, (HORIZON, len(limit))).astype(np.float32)


def smooth_actions(seed: int, limit: NDArray[np.floating[Any]], seconds: float) -> NDArray[np.float32]:
    """Swinging actions of a whole episode, (HORIZON, A); `seconds` is the length of a control step.

    A sine an actuator, of drawn frequency (0.5 to 2 Hz) and phase, and a quarter of the limit high.
    """
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.5, 2.0, len(limit)), rng.uniform(0.0, 2.0 * np.pi, len(limit))
    time = seconds * np.arange(HORIZON)[:, None]
    swings: NDArray[np.float32] = (0.25 * limit * np.sin(2.0 * np.pi * frequency * time + phase)).astype(np.float32)
    return swings


def _replay(actions: NDArray[np.float32]) -> Act:
    return lambda observation, t, reward: actions[t]


def _behave(policy: BehaviourPolicy, limit: NDArray[np.float64], seed: int) -> Act:
    # the noise of the data's own episode of this reset seed: the same seed gives the same episode
    noise = action_noise(seed, len(limit))
    return lambda observation, t, reward: policy.act(observation[None], limit, noise[t : t + 1])[0].astype(np.float32)
