"""Speed of what training repeats: a batch of windows, a gradient step, a step of acting. No test asserts a time."""

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.interface import RobotSpec
from agents.learner import Learner
from dynagen_bench.datasets import WindowSampler, load_dataset


@pytest.fixture
def dataset(tiny_data):
    """Hopper's tiny train data."""
    return load_dataset("Hopper", "train", progress=False)


def test_sixty_four_windows_of_twenty_steps(benchmark, dataset):
    benchmark.group = "windows"
    sampler = WindowSampler(dataset, 20, dataset.normalization())
    benchmark(sampler.sample, 64, np.random.default_rng(0))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", AGENTS)
def test_gradient_step(benchmark, dataset, name, threads):
    benchmark.group = f"a gradient step as in the paper's Table 6, {threads} threads"
    normalization = dataset.normalization()
    config = AGENTS[name][0]().for_robot("Hopper")
    learner = Learner(name, config, RobotSpec.of_robot("Hopper", normalization), seed=0)
    sampler = WindowSampler(dataset, config.context, normalization)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        benchmark(learner.update, sampler)
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("name", AGENTS)
def test_acting_in_fifty_episodes(benchmark, dataset, name):
    benchmark.group = "a step of acting in 50 episodes"
    config = AGENTS[name][0]().for_robot("Hopper")
    learner = Learner(name, config, RobotSpec.of_robot("Hopper", dataset.normalization()), seed=0)
    policy = learner.agent.policy()
    starts = np.ones(50, dtype=np.bool_)
    benchmark(lambda: policy.predict(np.zeros((50, 11)), episode_start=starts))
