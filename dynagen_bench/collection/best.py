"""Which snapshot of a SAC run is the best one: the same for the board's reference, for videos and for strips.

What is here: `best_snapshot`. Called by evaluation's experts and by pictures. It must not know what for.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from dynagen_bench import ids
from dynagen_bench.collection.episodes import reset_seed, roll_out
from dynagen_bench.collection.policies import BehaviourPolicy
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import BatchPhysics
from dynagen_bench.terminal import track

TRIALS: Final = 10
"""Episodes of each snapshot. The run's learning curve would cost nothing, but is a mean over policies that were still
changing."""

CHOICE_SEED: Final = 1
"""Entropy of their reset seeds, so that none of them is an official episode (evaluation's seed is 0)."""


def best_snapshot(name: ids.DynamicsId, snapshots: Mapping[int, BehaviourPolicy]) -> int:
    """The snapshot of the highest mean return in its own dynamics, the earlier of two equal ones.

    Each has `TRIALS` episodes of its own, without noise: seconds in all, of SlimHumanoid up to a minute, under a
    progress bar.

    Args:
        name: the dynamics.
        snapshots: environment steps → policy, in order.

    Raises:
        RuntimeError: as `roll_out`.
    """
    physics = BatchPhysics(name.robot, [load_dynamics(name.robot, name.split, name.index)] * TRIALS)
    means: dict[int, float] = {}
    for step, policy in track(snapshots.items(), f"{name.env_id}: best snapshot", len(snapshots)):
        first = TRIALS * len(means)
        seeds = [reset_seed(name, trial, seed=CHOICE_SEED) for trial in range(first, first + TRIALS)]
        episodes = roll_out(physics, policy, step, seeds, noisy=False)
        means[step] = float(np.mean([episode.total_reward for episode in episodes]))
    return max(means, key=means.__getitem__)
