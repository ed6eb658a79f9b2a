"""Speed of getting at the data: flat arrays beside Minari's own reader, and windows. No test asserts a time.

Of tiny data, and of all robots whose train data are on this machine (`dynagen data build`).
"""

import os
from typing import Final, NamedTuple

import minari
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.datasets import OfflineDataset, WindowSampler, load_dataset


def train_ids(robot: str) -> list[str]:
    """The Minari ids of a robot's train data."""
    return [name.dataset_id for name in ids.dynamics_ids(robot, ("train",))]


MACHINES: Final = {name: os.environ.get(name) for name in ("MINARI_DATASETS_PATH", "DYNAGEN_CACHE")}
"""Where this machine's own data are: read before a test has folders of its own."""

WHOLE: Final = [robot for robot in ids.ROBOTS if all(dataset_folder(one).is_dir() for one in train_ids(robot))]

TINY: Final = "tiny Hopper"


class Data(NamedTuple):
    """Data whose flat arrays are there."""

    robot: str
    title: str
    dataset: OfflineDataset


@pytest.fixture(params=[TINY, *WHOLE])
def data(request, tiny_dataset_root, monkeypatch):
    """Train data, tiny or whole."""
    tiny = request.param == TINY
    places = {"MINARI_DATASETS_PATH": str(tiny_dataset_root)} if tiny else MACHINES
    for name, place in places.items():
        monkeypatch.delenv(name) if place is None else monkeypatch.setenv(name, place)
    robot = "Hopper" if tiny else request.param
    dataset = load_dataset(robot, "train", progress=False)
    return Data(robot, f"{request.param}, {dataset.num_steps:,} steps", dataset)


def every_step(observations: np.ndarray, actions: np.ndarray, rewards: np.ndarray) -> float:
    """Touch all numbers of some steps, so that a reader that maps files has to read them."""
    return float(observations.sum() + actions.sum() + rewards.sum())


def test_all_steps_of_flat_arrays(benchmark, data):
    benchmark.group = f"{data.title}: all of them, from the files"

    def read() -> float:
        found = load_dataset(data.robot, "train", progress=False)
        return every_step(found.observations, found.actions, found.rewards)

    benchmark(read)


def test_all_steps_by_minaris_reader(benchmark, data):
    benchmark.group = f"{data.title}: all of them, from the files"

    def read() -> float:
        return sum(
            every_step(episode.observations, episode.actions, episode.rewards)
            for name in train_ids(data.robot)
            for episode in minari.load_dataset(name).iterate_episodes()
        )

    benchmark.pedantic(read, rounds=1)


@pytest.mark.parametrize("quality", [None, 0.3])
def test_ready(benchmark, data, quality):
    benchmark.group = f"{data.title}: ready to sample from"
    benchmark(load_dataset, data.robot, "train", quality=quality, progress=False)


def test_normalization(benchmark, data):
    benchmark.group = f"{data.title}: ready to sample from"
    benchmark(data.dataset.normalization)


@pytest.mark.parametrize("context", [1, 20, 200])
def test_sixty_four_windows(benchmark, data, context):
    benchmark.group = f"{data.title}: 64 windows"
    sampler = WindowSampler(data.dataset, context, data.dataset.normalization())
    benchmark(sampler.sample, 64, np.random.default_rng(0))
