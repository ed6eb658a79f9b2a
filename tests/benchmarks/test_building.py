"""Speed of making data: all of a dataset's episodes beside nothing but `mujoco.batch` through the same actions."""

from collections.abc import Sequence

import numpy as np
import pytest
from gymnasium.utils import seeding

from dynagen_bench import ids
from dynagen_bench.collection.episodes import Episode, collect_episodes
from dynagen_bench.collection.minari_files import build_dataset, every_nth
from dynagen_bench.collection.policies import load_policies, policy_file
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import BatchPhysics

NAME = ids.make_id("Hopper", "test", 3)
EVERY = 4


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    """The episodes of every fourth snapshot."""
    return list(collect_episodes(NAME, every_nth(load_policies(policy_file(NAME))[0], EVERY)))


def bare_steps(physics: BatchPhysics, episodes: Sequence[Episode]) -> int:
    """Step the episodes of one snapshot through their actions, each until it ends; returns the number of steps."""
    batch, substeps = physics._batch, physics._substeps
    ctrl, warmstart = batch.bind("ctrl"), batch.bind("qacc_warmstart")
    physics.start(np.arange(len(episodes)), [seeding.np_random(episode.seed)[0] for episode in episodes])
    lengths = np.array([len(episode) for episode in episodes])
    steps = 0
    for t in range(lengths.max()):
        running = np.flatnonzero(lengths > t)
        ctrl[running] = [episodes[i].actions[t] for i in running]
        warmstart[running] = 0.0
        batch.step(ids=running, nstep=substeps)
        steps += len(running)
    return steps


@pytest.mark.parametrize("way", ["bare Batch.step", "episodes", "dataset"])
def test_dataset(benchmark, episodes, way, tmp_path, monkeypatch):
    benchmark.group = f"Hopper test3, every {EVERY}th snapshot: {sum(map(len, episodes)):,} steps"
    physics = BatchPhysics("Hopper", [load_dynamics("Hopper", "test", 3)] * 50)
    snapshots = every_nth(load_policies(policy_file(NAME))[0], EVERY)
    by_snapshot = [[e for e in episodes if e.snapshot == snapshot] for snapshot in snapshots]
    roots = iter(range(1000))

    def root() -> None:
        monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / str(next(roots))))

    def run() -> None:
        if way == "dataset":
            build_dataset(NAME, every=EVERY)
        elif way == "episodes":
            list(collect_episodes(NAME, snapshots))
        else:
            assert sum(bare_steps(physics, group) for group in by_snapshot) == sum(map(len, episodes))

    benchmark.pedantic(run, setup=root, rounds=5)
