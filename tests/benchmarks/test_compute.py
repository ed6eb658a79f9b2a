"""The paper's Figure 3: gradient steps a second of each agent on Ant, and the time to act in ten episodes.

All take turns within one run, on one thread, and a table of their ratios to DADT is printed: a step's time is that
thread's processor time, and the smallest of the rounds. Batches and nets are those of each agent's defaults, and the
data are noise of Ant's sizes in 20 dynamics: what is in them changes no time. No test asserts a time.
"""

import dataclasses
import itertools
import time
from collections.abc import Callable

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.interface import Fitted, Phased, RobotSpec
from agents.learner import Learner
from results.tables import LAST_PHASE
from tests.agents.samples import flat_dataset

COMPARED = ("dadt", "dt", "focal", "merpo", "trajectory_transformer")
STATES, ACTIONS, EPISODES, HORIZON = 27, 8, 10, 200


@pytest.fixture(scope="module")
def learners():
    """Name and phase → a learner and what its batches are drawn by."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    episodes = 60
    dataset = flat_dataset(
        [rng.normal(size=(HORIZON + 1, STATES)) for _ in range(episodes)],
        [rng.uniform(-1, 1, size=(HORIZON, ACTIONS)) for _ in range(episodes)],
        [rng.uniform(0, 2, size=HORIZON) for _ in range(episodes)],
        robot="Ant",
    )
    dataset = dataclasses.replace(dataset, episode_dynamics=np.arange(episodes) % 20)
    spec, made = RobotSpec.of_robot("Ant", dataset.normalization()), {}
    for name in COMPARED:
        config = AGENTS[name][0]().for_robot("Ant")
        sampler = config.sampler(dataset, spec.normalization)
        learner = Learner(name, config, spec, seed=0)
        if isinstance(learner.agent, Fitted):
            learner.agent.fit(sampler)
        made[name] = (learner, sampler)
        if isinstance(learner.agent, Phased):
            later = Learner(name, config, spec, seed=0)
            later.step = config.steps - 100
            made[name + LAST_PHASE] = (later, sampler)
    yield made
    torch.set_num_threads(before)


def turns(benchmark, calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Least processor seconds of each call, over rounds in which all take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}

    def one_round() -> None:
        for name, call in calls.items():
            start = time.thread_time()
            call()
            seconds[name].append(time.thread_time() - start)

    benchmark.pedantic(one_round, rounds=rounds, warmup_rounds=1)
    least = {name: min(values[1:]) for name, values in seconds.items()}
    benchmark.extra_info["seconds"] = least
    return least


def show(capsys, title: str, least: dict[str, float]) -> None:
    with capsys.disabled():
        print(f"\n| {title} | s | beside DADT's |\n| --- | ---: | ---: |")
        for name, value in least.items():
            print(f"| {name} | {value:.3f} | {value / least['dadt']:.2f} |")


def test_gradient_steps(benchmark, learners, capsys):
    benchmark.group = "a gradient step of each agent on Ant, one thread"
    calls = {name: lambda made=made: made[0].update(made[1]) for name, made in learners.items()}
    show(capsys, "a gradient step", turns(benchmark, calls, rounds=5))


def acting(policy) -> Callable[[], object]:
    """A step of acting: what is seen and earned differs from step to step, as in an episode that goes on."""
    seen = itertools.cycle(np.random.default_rng(0).normal(size=(50, EPISODES, STATES)))

    def step() -> None:
        policy.predict(next(seen))
        policy.observe(np.ones(EPISODES))

    return step


def test_acting_in_ten_episodes(benchmark, learners, capsys):
    benchmark.group = "a step of acting in ten episodes of Ant at once, the context full, one thread"
    calls = {name: acting(learners[name][0].agent.policy()) for name in COMPARED}
    for name, call in calls.items():
        for _ in range(5 if name == "trajectory_transformer" else 20):
            call()
    least = {name: HORIZON * value for name, value in turns(benchmark, calls, rounds=3).items()}
    show(capsys, f"{HORIZON} steps of {EPISODES} episodes", least)
