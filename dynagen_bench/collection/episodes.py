"""Episodes of stored behaviour policies: a pure function of (dynamics, policy, seed).

What is here: `Episode`, its seeds, and the rollouts, many at once. Called by the Minari files and by whoever wants an
episode again. It must not know files, formats or what the episodes are for.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.policies import BehaviourPolicy
from dynagen_bench.dynamics import draws, load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics

EPISODES_PER_SNAPSHOT: Final = 50
"""Random rollouts of each stored policy (paper, appendix B)."""

SEED: Final = draws.SEED
"""Entropy of v0's reset seeds."""

_ACTION_NOISE: Final = (1,)
"""Spawn key of the action noise below a reset seed; the reset itself has no key, as in Gymnasium."""


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps, and where it is from.

    Attributes:
        seed: reset seed; `env.reset(seed=seed)` and then `actions` give the episode again, bit for bit.
        snapshot: environment steps after which its policy was stored.
        policy_hash: SHA-256 of that policy (`BehaviourPolicy.content_hash`).
        observations: (T + 1, S) float64, the last one after the last action.
        actions: (T, A) float32, multiples of 2^-12; what was stepped.
        rewards: (T,) float64.
        terminated: the last state ended the episode by itself.
    """

    seed: int
    snapshot: int
    policy_hash: str
    observations: NDArray[np.float64]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool

    def __len__(self) -> int:
        """Number of actions T."""
        return len(self.actions)

    @property
    def truncated(self) -> bool:
        """The horizon is reached; as with Gymnasium's TimeLimit, an episode that terminates there is both."""
        return len(self) == HORIZON

    @property
    def total_reward(self) -> float:
        """The undiscounted return."""
        return float(self.rewards.sum())


def reset_seed(name: ids.DynamicsId, *numbers: int, seed: int = SEED) -> int:
    """A reset seed in a dynamics, 31 bits; depends on nothing but its arguments.

    Those of the data have snapshot and episode as numbers, those of an evaluation the episode alone.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(*name.key, *numbers))
    return int(sequence.generate_state(1)[0] >> 1)


def action_noise(seed: int, action_size: int) -> NDArray[np.float64]:
    """The action noise of a whole episode, (HORIZON, A) standard normal, from its reset seed.

    Drawn at once and for each episode alone, so that an episode does not depend on the batch it ran in.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_ACTION_NOISE))
    return rng.standard_normal((HORIZON, action_size))


def collect_episodes(
    name: ids.DynamicsId,
    snapshots: Mapping[int, BehaviourPolicy],
    episodes_per_snapshot: int = EPISODES_PER_SNAPSHOT,
    threads: int = 0,
) -> Iterator[Episode]:
    """Yield the stochastic episodes of each snapshot, snapshots in the order given, episodes in order.

    Args:
        name: the dynamics they run in.
        snapshots: environment steps after which it was stored → policy.
        episodes_per_snapshot: this many simulations are stepped at once.
        threads: physics threads, as `BatchPhysics` takes them; the episodes are the same at any number.

    Raises:
        ValueError: no whole number of episodes a snapshot, or of threads.
        RuntimeError: MuJoCo reported a bad state; the message has what is needed to see it again. Such an episode is
            never stored.
    """
    count = ids.check_count("episodes_per_snapshot", episodes_per_snapshot)
    dynamics = load_dynamics(name.robot, name.split, name.index)
    physics = BatchPhysics(name.robot, [dynamics] * count, threads)
    for snapshot, policy in snapshots.items():
        seeds = [reset_seed(name, snapshot, episode) for episode in range(count)]
        yield from roll_out(physics, policy, snapshot, seeds)


def roll_out(
    physics: BatchPhysics, policy: BehaviourPolicy, snapshot: int, seeds: list[int], noisy: bool = True
) -> list[Episode]:
    """Run one episode a seed, simulation i of `physics` from seed i, and return them in order.

    The policy acts with the noise of each seed, as in the data, or without any.

    Raises:
        RuntimeError: as `collect_episodes`.
    """
    limit = physics.action_limit
    noise = np.stack([action_noise(seed, len(limit)) for seed in seeds]) if noisy else None  # (N, T, A)
    running = np.arange(len(seeds))
    first = physics.start(running, [seeding.np_random(seed)[0] for seed in seeds])  # (N, S)

    observations = np.zeros((len(seeds), HORIZON + 1, first.shape[1]))
    actions = np.zeros((len(seeds), HORIZON, len(limit)), dtype=np.float32)
    rewards = np.zeros((len(seeds), HORIZON))
    lengths = np.zeros(len(seeds), dtype=np.int64)
    terminated = np.zeros(len(seeds), dtype=np.bool_)
    observations[:, 0] = first
    for t in range(HORIZON):
        drawn = None if noise is None else noise[running, t]
        actions[running, t] = policy.act(observations[running, t], limit, drawn)
        result = physics.step(actions[running, t], running)
        if result.unstable.any():
            seed = seeds[int(running[result.unstable][0])]
            raise RuntimeError(
                f"{physics.robot}: MuJoCo reports a bad state at step {t} of the episode of reset seed {seed}, "
                f"snapshot {snapshot}: nothing is made of such an episode"
            )
        observations[running, t + 1] = result.observations
        rewards[running, t] = result.rewards
        lengths[running] = t + 1
        terminated[running] = result.terminated
        running = running[~result.terminated]
        if len(running) == 0:
            break

    policy_hash = policy.content_hash()
    return [
        Episode(
            seed=seed,
            snapshot=snapshot,
            policy_hash=policy_hash,
            observations=observations[i, : length + 1].copy(),
            actions=actions[i, :length].copy(),
            rewards=rewards[i, :length].copy(),
            terminated=bool(terminated[i]),
        )
        for i, (seed, length) in enumerate(zip(seeds, lengths.tolist(), strict=True))
    ]
