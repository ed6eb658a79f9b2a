"""Speed of what training repeats: a batch of windows, a gradient step, a step of acting. No test asserts a time.

The gradient steps of all agents, in both precisions, and the yardstick's take turns within one run, and a table of
their ratios is printed: where a machine does other things too, what slows one down slows its neighbours as much. On one
thread a step's time is that thread's processor time, which other processes do not count in; on two it is the clock's.
The smallest of the rounds is the least disturbed one.
"""

import time
from collections.abc import Callable

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.interface import RobotSpec
from agents.learner import Learner
from dynagen_bench.datasets import Normalization, WindowSampler, load_dataset
from dynagen_bench.evaluation import evaluate
from tests.agents.samples import SEQUENCE_AGENTS, TRANSFORMERS, random_dataset
from tests.benchmarks.yardstick import PlainDT

YARDSTICK = "yardstick"


@pytest.fixture
def dataset(tiny_data):
    """Hopper's tiny train data."""
    return load_dataset("Hopper", "train", progress=False)


@pytest.fixture
def threads(request):
    """Torch's threads, for one test."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def new_learner(name: str, dataset, **changes) -> Learner:
    """An untrained agent of the paper's configuration."""
    config = AGENTS[name][0](**changes).for_robot("Hopper")
    return Learner(name, config, RobotSpec.of_robot("Hopper", dataset.normalization()), seed=0)


def steps_of(dataset) -> dict[str, Callable[[], object]]:
    """Name → a gradient step, from sampling its windows to the numbers that are logged."""
    sampler, rng = WindowSampler(dataset, 20, dataset.normalization()), np.random.default_rng(0)
    plain = PlainDT(11, 3, 20)
    steps: dict[str, Callable[[], object]] = {YARDSTICK: lambda: plain.update(sampler.sample(64, rng))}
    for name in SEQUENCE_AGENTS:
        for precision in ("bfloat16", "float32") if name in TRANSFORMERS else ("float32",):
            learner = new_learner(name, dataset, **({"precision": precision} if name in TRANSFORMERS else {}))
            steps[f"{name}, {precision}"] = lambda learner=learner: learner.update(sampler)
    return steps


def test_all_that_is_timed_takes_its_step():
    """Where nothing is timed, too: a new agent does not break the benchmarks unseen."""
    steps = steps_of(random_dataset())
    assert {name.split(",")[0] for name in steps} == {YARDSTICK, *SEQUENCE_AGENTS}
    for step in steps.values():
        step()


def test_sixty_four_windows_of_twenty_steps(benchmark, dataset):
    benchmark.group = "windows"
    sampler = WindowSampler(dataset, 20, dataset.normalization())
    benchmark(sampler.sample, 64, np.random.default_rng(0))


@pytest.mark.parametrize("threads", [1, 2], indirect=True)
def test_gradient_steps_beside_the_yardstick(benchmark, dataset, threads, capsys):
    benchmark.group = f"a gradient step of each agent as in the paper's Table 6, {threads} threads"
    steps, clock = steps_of(dataset), time.thread_time if threads == 1 else time.perf_counter
    seconds: dict[str, list[float]] = {name: [] for name in steps}

    def one_round() -> None:
        for name, step in steps.items():
            start = clock()
            step()
            seconds[name].append(clock() - start)

    benchmark.pedantic(one_round, rounds=20, warmup_rounds=2)
    least = {name: min(values[2:]) for name, values in seconds.items()}
    benchmark.extra_info["milliseconds"] = {name: 1e3 * value for name, value in least.items()}
    with capsys.disabled():
        print(f"\n| a gradient step, {threads} threads | ms | yardstick's / its |\n| --- | ---: | ---: |")
        for name, value in least.items():
            print(f"| {name} | {1e3 * value:.1f} | {least[YARDSTICK] / value:.2f} |")


@pytest.mark.parametrize("name", SEQUENCE_AGENTS)
def test_acting_in_fifty_episodes(benchmark, dataset, name):
    benchmark.group = "a step of acting in 50 episodes, the context full"
    policy = new_learner(name, dataset).agent.policy()
    for _ in range(20):
        policy.predict(np.zeros((50, 11)))
    benchmark.pedantic(lambda: policy.predict(np.zeros((50, 11))), rounds=100)


@pytest.mark.parametrize("threads", [1, 2], indirect=True)
def test_evaluation(benchmark, threads):
    benchmark.group = "DADT untrained in HalfCheetah, where no episode ends early: 5 dynamics x 10 episodes x 200 steps"
    spec = RobotSpec.of_robot("HalfCheetah", Normalization(np.zeros(17, np.float32), np.ones(17, np.float32)))
    config = AGENTS["dadt"][0]().for_robot("HalfCheetah")
    agent = Learner("dadt", config, spec, seed=0).agent
    benchmark.pedantic(lambda: evaluate(agent.policy(), "HalfCheetah"), rounds=2)
