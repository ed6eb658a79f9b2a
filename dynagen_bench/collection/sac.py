"""One SAC run on one dynamics: the only file that knows a SAC library.

What is here: the run and its way to stored snapshots. Called by `dynagen collect`, one process per run. It
needs the [collect] extra; nothing else in the package does. It must not know episodes, datasets or agents.
"""

import csv
import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from dynagen_bench import ids
from dynagen_bench.collection.policies import LAYERS, BehaviourPolicy, policy_file, save_policies
from dynagen_bench.collection.settings import SACSettings
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.whole import whole_file


class BatchVecEnv(VecEnv):
    """`BatchPhysics` as SB3's VecEnv: N episodes of one dynamics, each restarted as soon as it ends."""

    def __init__(self, name: ids.DynamicsId, environments: int, rng: np.random.Generator) -> None:
        """N environments of one dynamics on the calling thread; `rng` draws every episode's start."""
        self._physics = BatchPhysics(
            name.robot, [load_dynamics(name.robot, name.split, name.index)] * environments, threads=1
        )
        self._rng = rng
        self._steps = np.zeros(environments, dtype=np.int64)
        self._returns = np.zeros(environments)
        self._actions: NDArray[np.float32] = np.zeros((environments, 0), dtype=np.float32)
        self.render_mode = None
        example = gymnasium.make(name.env_id)
        shape = example.observation_space.shape
        space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        super().__init__(environments, space, example.action_space)
        example.close()

    def _start(self, simulations: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
        self._steps[simulations] = 0
        self._returns[simulations] = 0.0
        return self._physics.start(simulations, [self._rng] * len(simulations)).astype(np.float32)

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in every environment; returns observations (N, S) float32."""
        return self._start(np.arange(self.num_envs))

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the actions (N, A) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step all environments; ended ones start again, their last observation in `infos` as SB3 wants it."""
        result = self._physics.step(self._actions)
        observations = result.observations.astype(np.float32)
        self._steps += 1
        self._returns += result.rewards
        truncated = (self._steps >= HORIZON) & ~result.terminated
        dones = result.terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(dones)
        for i in ended:
            infos[i] = {
                "terminal_observation": observations[i].copy(),
                "TimeLimit.truncated": bool(truncated[i]),
                "episode": {"r": float(self._returns[i]), "l": int(self._steps[i]), "t": 0.0},
            }
        if len(ended):
            observations[ended] = self._start(ended)
        return observations, result.rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of this object, once an environment."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """There is nothing to set in one environment alone."""
        raise NotImplementedError("the environments of a batch have no attributes of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """There is nothing to call in one environment alone."""
        raise NotImplementedError("the environments of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No environment is wrapped."""
        return [False] * self.num_envs


class _Snapshots(BaseCallback):
    """Takes the actor each time another `every` steps are done, and one line of the learning curve with it."""

    def __init__(self, every: int, progress: Callable[[int], None]) -> None:
        super().__init__()
        self.policies: dict[int, BehaviourPolicy] = {}
        self.curve: list[dict[str, float]] = []
        self._every = every
        self._progress = progress
        self._started = time.monotonic()

    def _actor_state(self) -> Any:
        policy: Any = self.model.policy
        return policy.actor_state

    def _on_step(self) -> bool:
        step = (len(self.policies) + 1) * self._every
        if self.num_timesteps >= step:
            self.policies[step] = actor_policy(self._actor_state().params)
            # the last hundred episodes; there is none yet only in a run of a few steps
            episodes = list(self.model.ep_info_buffer or [{"r": math.nan, "l": math.nan}])
            self.curve.append(
                {
                    "step": step,
                    "mean_return": round(float(np.mean([e["r"] for e in episodes])), 3),
                    "mean_length": round(float(np.mean([e["l"] for e in episodes])), 2),
                    "seconds": round(time.monotonic() - self._started, 1),
                }
            )
        if self.n_calls % 50 == 0:
            self._progress(self.num_timesteps)
        return True


def actor_policy(params: Any) -> BehaviourPolicy:
    """The stored form of an sbx actor's parameters (Flax names its layers Dense_0 to Dense_3, in our order)."""
    layers = params["params"]
    names = dict(zip(LAYERS, sorted(layers), strict=True))
    return BehaviourPolicy(
        weights={ours: np.asarray(layers[theirs]["kernel"], dtype=np.float16) for ours, theirs in names.items()},
        biases={ours: np.asarray(layers[theirs]["bias"], dtype=np.float16) for ours, theirs in names.items()},
    )


def train_behaviour_policies(
    name: ids.DynamicsId, settings: SACSettings, folder: Path, progress: Callable[[int], None] = lambda step: None
) -> Path:
    """Train SAC on one dynamics and store its snapshots; returns the file.

    The file appears when the run is complete, with the learning curve beside it (`.csv`); a run that was stopped
    has left nothing and starts again. A run's randomness comes from (settings.seed, dynamics) alone.
    """
    from sbx import SAC  # here, so that a worker can set XLA's flags before JAX starts

    start_sequence, learner_sequence = np.random.SeedSequence([settings.seed, *name.key]).spawn(2)
    environments = BatchVecEnv(name, settings.environments, np.random.default_rng(start_sequence))
    model = SAC(
        "MlpPolicy",
        environments,
        learning_rate=settings.learning_rate,
        gamma=settings.gamma,
        batch_size=settings.batch_size,
        train_freq=1,
        gradient_steps=settings.gradient_steps,
        policy_delay=settings.policy_delay,
        learning_starts=settings.learning_starts,
        policy_kwargs={
            "net_arch": {"pi": [settings.hidden] * 2, "qf": [settings.critic_hidden] * 2},
            "layer_norm": settings.critic_layer_norm,
        },
        seed=int(learner_sequence.generate_state(1)[0]),
    )
    snapshots = _Snapshots(settings.snapshot_every, progress)
    model.learn(settings.total_steps, callback=snapshots, log_interval=10**9)
    path = policy_file(name, folder)
    _write_curve(path.with_suffix(".csv"), snapshots.curve)
    metadata = {
        "dynamics": name.env_id,
        "settings": dataclasses.asdict(settings),
        "versions": {p: version(p) for p in ("mujoco", "gymnasium", "sbx-rl", "jax", "stable-baselines3")},
    }
    save_policies(path, snapshots.policies, metadata)
    return path


def _write_curve(path: Path, rows: Sequence[dict[str, float]]) -> None:
    with whole_file(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
