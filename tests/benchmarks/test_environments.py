"""Speed of stepping: our environments beside Gymnasium's own, and many at once beside one after another.

`make benchmark` prints a table a group; within a group the ratios are what counts. Nothing here asserts a time.
"""

import gymnasium
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import BatchPhysics
from tests.dynamics.test_parameters import GYMNASIUM_IDS

STEPS = 200


def steps_of(env: gymnasium.Env, actions: np.ndarray) -> None:
    """Step an environment through actions (T, A), starting again where an episode ends."""
    env.reset(seed=0)
    for action in actions:
        if env.step(action)[2]:
            env.reset()


def small_actions(env: gymnasium.Env) -> np.ndarray:
    """Actions (STEPS, A) that let a robot stand for a while."""
    high = env.action_space.high
    return np.random.default_rng(0).uniform(-0.1 * high, 0.1 * high, (STEPS, len(high))).astype(np.float32)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_gymnasiums_own(benchmark, robot):
    benchmark.group = f"{robot}, {STEPS} steps"
    env = gymnasium.make(GYMNASIUM_IDS[robot]).unwrapped
    benchmark(steps_of, env, small_actions(env))


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_ours(benchmark, robot):
    benchmark.group = f"{robot}, {STEPS} steps"
    env = gymnasium.make(ids.v0_env_id(robot), split="nominal").unwrapped
    benchmark(steps_of, env, small_actions(env))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_fifty_at_once(benchmark, robot, threads):
    benchmark.group = f"{robot}, 50 environments, 20 steps each"
    batch = BatchPhysics(robot, [load_dynamics(robot, "test", i % 5) for i in range(50)], threads)
    env = gymnasium.make(ids.v0_env_id(robot)).unwrapped
    actions = np.broadcast_to(small_actions(env)[:20, None], (20, 50, env.action_space.shape[0]))

    def run() -> None:
        batch.start(np.arange(50), [np.random.default_rng(i) for i in range(50)])
        for step in actions:
            batch.step(step)

    benchmark(run)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_fifty_one_after_another(benchmark, robot):
    benchmark.group = f"{robot}, 50 environments, 20 steps each"
    envs = [gymnasium.make(f"{robot}-RandDyn-test{i % 5}").unwrapped for i in range(50)]
    actions = small_actions(envs[0])[:20]

    def run() -> None:
        for i, env in enumerate(envs):
            env.reset(seed=i)
            for action in actions:
                env.step(action)

    benchmark(run)
