"""Speed of stepping: our environments beside Gymnasium's own, and many at once beside the ways there are.

`make benchmark` prints a table a group; within a group the ratios are what counts. Nothing here asserts a time. In the
groups of many environments nothing ends, so that all of them step through the same states.
"""

import functools
import subprocess
import sys
from collections.abc import Callable

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from dynagen_bench import ids
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import BatchPhysics
from tests.dynamics.test_parameters import GYMNASIUM_IDS

STEPS = 200
STEPS_AT_ONCE = 20
ENDLESS = {"terminate_when_unhealthy": False, "max_episode_steps": 10**6}


def small_actions(env: gymnasium.Env, steps: int = STEPS) -> np.ndarray:
    """Actions (steps, A) that let a robot stand for a while."""
    high = env.action_space.high
    return np.random.default_rng(0).uniform(-0.1 * high, 0.1 * high, (steps, len(high))).astype(np.float32)


def steps_of(env: gymnasium.Env, actions: np.ndarray) -> None:
    """Step an environment through actions (T, A)."""
    for action in actions:
        env.step(action)


@pytest.mark.parametrize("robot", ids.ROBOTS)
@pytest.mark.parametrize("whose", ["Gymnasium's v5", "ours"])
def test_single(benchmark, robot, whose):
    benchmark.group = f"{robot}: one environment, {STEPS} steps"
    ours = {"split": "nominal", "terminate_when_unhealthy": False}
    made = gymnasium.make(ids.v0_env_id(robot), **ours) if whose == "ours" else gymnasium.make(GYMNASIUM_IDS[robot])
    env = made.unwrapped
    actions = small_actions(env)

    # a reset outside the clock: its cost is not a step's; Gymnasium's robot goes on after a fall, as ours does here
    def setup() -> tuple[tuple[gymnasium.Env, np.ndarray], dict[str, object]]:
        env.reset(seed=0)
        return (env, actions), {}

    benchmark.pedantic(steps_of, setup=setup, rounds=20)


def many_actions(robot: str, num_envs: int) -> np.ndarray:
    """Actions (STEPS_AT_ONCE, N, A), the same for all N."""
    with gymnasium.make(ids.v0_env_id(robot)) as env:
        actions = small_actions(env, STEPS_AT_ONCE)
    return np.broadcast_to(actions[:, None], (STEPS_AT_ONCE, num_envs, actions.shape[1])).copy()


def bare(robot: str, num_envs: int, threads: int) -> tuple[Callable[[], None], Callable[[np.ndarray], None]]:
    """Reset and step of nothing but `mujoco.batch`, on the models and for the substeps of ours."""
    drawn = [load_dynamics(robot, "test", i) for i in range(5)]
    physics = BatchPhysics(robot, [drawn[i % 5] for i in range(num_envs)], threads)
    batch, substeps, stage = physics._batch, physics._substeps, physics._stage
    ctrl, warmstart = batch.bind("ctrl"), batch.bind("qacc_warmstart")

    def reset() -> None:
        physics.start(np.arange(num_envs), [np.random.default_rng(i) for i in range(num_envs)])

    def step(actions: np.ndarray) -> None:
        warmstart[:] = 0.0
        ctrl[:] = actions
        batch.step(nstep=substeps, stage=stage)

    assert stage in (mujoco.mjtStage.mjSTAGE_NONE, mujoco.mjtStage.mjSTAGE_ACC)
    return reset, step


def vector(
    make: Callable[[], gymnasium.vector.VectorEnv],
) -> tuple[Callable[[], None], Callable[[np.ndarray], None]]:
    """Reset and step of a vector environment."""
    env = make()
    return lambda: env.reset(seed=0), env.step


def makers(robot: str, num_envs: int) -> list[Callable[[], gymnasium.Env]]:
    """What Gymnasium's vector environments take: a maker a sub-environment."""
    return [
        functools.partial(gymnasium.make, f"{robot}-RandDyn-test{i % 5}", disable_env_checker=True, **ENDLESS)
        for i in range(num_envs)
    ]


def ours(robot: str, num_envs: int, threads: int) -> gymnasium.vector.VectorEnv:
    """Our vector environment."""
    return gymnasium.make_vec(ids.v0_env_id(robot), num_envs=num_envs, split="test", threads=threads, **ENDLESS)


def rounds_of(benchmark, robot: str, num_envs: int, way, rounds: int = 12) -> None:
    """Time STEPS_AT_ONCE steps of all N, a reset before each round outside the clock."""
    reset, step = way
    actions = many_actions(robot, num_envs)

    def setup() -> None:  # gives nothing back: pytest-benchmark would take it as arguments
        reset()

    def run() -> None:
        for action in actions:
            step(action)

    benchmark.extra_info["environment_steps"] = STEPS_AT_ONCE * num_envs
    benchmark.pedantic(run, setup=setup, rounds=rounds, warmup_rounds=1)


@pytest.mark.parametrize("robot", ids.ROBOTS)
@pytest.mark.parametrize(
    "way",
    ["bare Batch.step", "ours", "bare Batch.step, 1 thread", "ours, 1 thread", "SyncVectorEnv", "AsyncVectorEnv"],
)
def test_fifty_at_once(benchmark, robot, way):
    benchmark.group = f"{robot}: 50 environments, {STEPS_AT_ONCE} steps each"
    threads = 1 if "1 thread" in way else 0
    if way.startswith("bare"):
        made = bare(robot, 50, threads)
    elif way.startswith("ours"):
        made = vector(lambda: ours(robot, 50, threads))
    else:
        many = SyncVectorEnv if way.startswith("Sync") else AsyncVectorEnv
        made = vector(lambda: many(makers(robot, 50)))
    rounds_of(benchmark, robot, 50, made, rounds=4 if "VectorEnv" in way else 12)


MEMORY = """
import os, sys
from pathlib import Path
import gymnasium
import dynagen_bench
resident = lambda: int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
before = resident()
env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=int(sys.argv[1]), split="test")
env.reset(seed=0)
env.step(env.action_space.sample())
print(resident() - before)
"""
"""Run in a process of its own, whose memory nothing else has used before (Linux)."""


@pytest.mark.parametrize("num_envs", [1, 10, 50, 250, 1000])
def test_any_number(benchmark, num_envs):
    benchmark.group = f"Hopper: N environments, {STEPS_AT_ONCE} steps each"
    command = [sys.executable, "-c", MEMORY, str(num_envs)]
    benchmark.extra_info["bytes"] = int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    rounds_of(benchmark, "Hopper", num_envs, vector(lambda: ours("Hopper", num_envs, 0)))
