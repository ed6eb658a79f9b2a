"""Tiny real data: random behaviour policies that are stored, rolled out and built as the benchmark's own."""

from collections.abc import Iterable
from pathlib import Path

import gymnasium
import numpy as np

from dynagen_bench import ids
from dynagen_bench.collection.policies import BehaviourPolicy, policy_file, save_policies
from dynagen_bench.datasets import OfflineDataset

SNAPSHOTS = (100, 200, 300, 400)
EPISODES_PER_SNAPSHOT = 3


def random_policy(robot: str, rng: np.random.Generator, hidden: int = 8) -> BehaviourPolicy:
    """A policy that nobody trained; it acts, and its robot falls soon if it can."""
    env = gymnasium.make(ids.make_id(robot, "train", 0).env_id)
    state_size, action_size = env.observation_space.shape[0], env.action_space.shape[0]
    env.close()
    shapes = {
        "hidden0": (state_size, hidden),
        "hidden1": (hidden, hidden),
        "mean": (hidden, action_size),
        "log_std": (hidden, action_size),
    }
    return BehaviourPolicy(
        weights={layer: rng.normal(0, shape[0] ** -0.5, shape).astype(np.float16) for layer, shape in shapes.items()},
        biases={layer: np.zeros(shape[1], dtype=np.float16) for layer, shape in shapes.items()},
    )


def store_random_policies(
    folder: Path, names: Iterable[ids.DynamicsId], snapshots: Iterable[int] = SNAPSHOTS, seed: int = 0
) -> None:
    """Write the files that SAC runs would, of random policies; each depends on the seed and its name alone."""
    snapshots = tuple(snapshots)
    for name in names:
        rng = np.random.default_rng([seed, *name.key])
        policies = {step: random_policy(name.robot, rng) for step in snapshots}
        save_policies(policy_file(name, folder), policies, {"dynamics": name.env_id})


def three_step_episodes(split: str = "train") -> OfflineDataset:
    """Two episodes written by hand, of 3 and 2 steps, S = 2 and A = 1. Element [r, 0] of observations is 10 r."""
    rows = np.arange(7, dtype=np.float32)
    return OfflineDataset(
        robot="Hopper",
        split=split,
        observations=np.stack([10 * rows, -rows], axis=1),
        actions=np.array([[1], [2], [3], [0], [5], [6], [0]], dtype=np.float32),
        rewards=np.array([1, 2, 4, 0, 8, 16, 0], dtype=np.float32),
        returns_to_go=np.array([7, 6, 4, 0, 24, 16, 0], dtype=np.float32),
        episode_starts=np.array([0, 4]),
        episode_lengths=np.array([3, 2]),
        episode_dynamics=np.array([0, 1]),
        episode_snapshots=np.array([100, 100]),
        episode_returns=np.array([7.0, 24.0]),
        episode_seeds=np.array([11, 12]),
        episode_terminated=np.array([True, False]),
    )
