"""The behaviour policies of the test dynamics as submissions' policies: references that no zero-shot agent can be.

What is here: `SnapshotPolicy`, of the snapshots that made the data or of the best of them. Called by `baselines`. It
must not know submissions. Each row of an evaluation is told its dynamics, because it is made for it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.best import CHOICE_SEED, best_snapshot
from dynagen_bench.collection.episodes import action_noise
from dynagen_bench.collection.policies import POLICY_FOLDER, BehaviourPolicy, load_policies, policy_file
from dynagen_bench.evaluation.rollout import EPISODES, action_space, reset_seeds


class SnapshotPolicy:
    """Stored behaviour policies, one a row of the evaluation."""

    def __init__(
        self, robot: str, rows: Sequence[BehaviourPolicy], noise_seeds: NDArray[np.int64] | None = None
    ) -> None:
        """Row i acts as `rows[i]`: by its best action, or, as in the data, with noise of the i-th of the seeds (N,)."""
        self._limit = action_space(robot).high.astype(np.float64)
        self._rows = {id(policy): policy for policy in rows}
        self._members = {key: [i for i, row in enumerate(rows) if id(row) == key] for key in self._rows}
        self._noise = None
        if noise_seeds is not None:
            self._noise = np.stack([action_noise(int(seed), len(self._limit)) for seed in noise_seeds])  # (N, T, A)

    def predict(
        self, observation: NDArray[np.float64], state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """Actions (N, A) float32 for observations (N, S); the state is the number of the step."""
        step = 0 if state is None else int(state)
        actions = np.zeros((len(observation), len(self._limit)), dtype=np.float32)
        for key, members in self._members.items():
            noise = None if self._noise is None else self._noise[members, step]
            actions[members] = self._rows[key].act(observation[members], self._limit, noise)
        return actions, step + 1


def behaviour_policy(robot: str, seed: int, folder: Path = POLICY_FOLDER) -> SnapshotPolicy:
    """What made the test dynamics' data, for the official evaluation: each snapshot in its own dynamics, stochastic.

    The ten episodes of a dynamics take every second of its twenty snapshots, from the first or from the second on as
    `seed` is even or odd; the noise is a function of `seed`, too.
    """
    rows = []
    for snapshots in snapshots_of_tests(robot, folder):
        stored = list(snapshots.values())
        rows += [stored[(episode * len(stored) // EPISODES + seed) % len(stored)] for episode in range(EPISODES)]
    noise = reset_seeds(robot, "test", range(ids.SPLIT_SIZES["test"]), seed=CHOICE_SEED + seed)
    return SnapshotPolicy(robot, rows, noise.ravel())


def best_policy(robot: str, folder: Path = POLICY_FOLDER) -> SnapshotPolicy:
    """The best snapshot of each test dynamics, for the official evaluation, deterministic.

    Chosen by `best_snapshot`, in episodes none of which is official.
    """
    rows = []
    for name, snapshots in zip(ids.dynamics_ids(robot, ("test",)), snapshots_of_tests(robot, folder), strict=True):
        rows += [snapshots[best_snapshot(name, snapshots)]] * EPISODES
    return SnapshotPolicy(robot, rows)


def snapshots_of_tests(robot: str, folder: Path = POLICY_FOLDER) -> list[dict[int, BehaviourPolicy]]:
    """Environment steps → stored policy, of each test dynamics; raises FileNotFoundError if they are not there."""
    return [load_policies(policy_file(name, folder))[0] for name in ids.dynamics_ids(robot, ("test",))]
