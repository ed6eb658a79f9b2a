"""Speed of getting at the data: flat arrays beside Minari's own reader, and windows. No test asserts a time."""

import minari
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.datasets import WindowSampler, load_dataset


@pytest.fixture
def cached(tiny_data):
    """Hopper's tiny train data, whose flat arrays are there."""
    return load_dataset("Hopper", "train", progress=False)


def every_step(observations: np.ndarray, actions: np.ndarray, rewards: np.ndarray) -> float:
    """Touch all numbers of some steps, so that a reader that maps files has to read them."""
    return float(observations.sum() + actions.sum() + rewards.sum())


def test_all_steps_of_flat_arrays(benchmark, cached):
    benchmark.group = "all steps of a robot's train data, from the files"

    def read() -> float:
        data = load_dataset("Hopper", "train", progress=False)
        return every_step(data.observations, data.actions, data.rewards)

    benchmark(read)


def test_all_steps_by_minaris_reader(benchmark, cached):
    benchmark.group = "all steps of a robot's train data, from the files"
    names = list(ids.dynamics_ids("Hopper", ("train",)))

    def read() -> float:
        return sum(
            every_step(episode.observations, episode.actions, episode.rewards)
            for name in names
            for episode in minari.load_dataset(name.dataset_id).iterate_episodes()
        )

    benchmark(read)


@pytest.mark.parametrize("quality", [None, 0.3])
def test_ready(benchmark, cached, quality):
    benchmark.group = "a train split, ready to sample from"
    benchmark(load_dataset, "Hopper", "train", quality=quality, progress=False)


def test_normalization(benchmark, cached):
    benchmark.group = "a train split, ready to sample from"
    benchmark(cached.normalization)


@pytest.mark.parametrize("context", [1, 20, 200])
def test_sixty_four_windows(benchmark, cached, context):
    benchmark.group = "64 windows"
    sampler = WindowSampler(cached, context, cached.normalization())
    benchmark(sampler.sample, 64, np.random.default_rng(0))
