"""Many simulations at once: the bits of single environments, whoever else is in the batch."""

import multiprocessing
import os
import subprocess
import sys
from multiprocessing.connection import Connection

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding

from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import BatchPhysics
from dynagen_bench.evaluation.traces import physics_digest


def batch_of(robot: str, split: str, size: int, threads: int) -> BatchPhysics:
    """The first `size` dynamics of a split."""
    return BatchPhysics(robot, [load_dynamics(robot, split, i) for i in range(size)], threads)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_bits_of_single_environments(robot, threads):
    batch = batch_of(robot, "test", 5, threads)
    envs = [gymnasium.make(f"{robot}-RandDyn-test{i}").unwrapped for i in range(5)]
    rng = np.random.default_rng(threads)
    rows = np.arange(5)
    observations = batch.start(rows, [seeding.np_random(int(7 + i))[0] for i in rows])
    for i in rows:
        np.testing.assert_array_equal(envs[i].reset(seed=int(7 + i))[0], observations[i])
    limit = envs[0].action_space.high[0]
    for _ in range(60):
        actions = rng.uniform(-1.2 * limit, 1.2 * limit, (len(rows), envs[0].action_space.shape[0])).astype(np.float32)
        result = batch.step(actions, rows)
        for j, i in enumerate(rows):
            observation, reward, terminated, *_ = envs[i].step(actions[j])
            np.testing.assert_array_equal(observation, result.observations[j])
            assert (reward, terminated) == (result.rewards[j], result.terminated[j])
        rows = rows[~result.terminated]
        if not len(rows):
            break


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_bits_do_not_depend_on_how_actions_lie_in_memory(robot):
    batch = BatchPhysics(robot, [load_dynamics(robot, "test", i % 5) for i in range(30)], threads=1)
    plain = np.random.default_rng(0).uniform(-batch.action_limit, batch.action_limit, (30, len(batch.action_limit)))
    rewards = []
    for actions in (plain, np.asfortranarray(plain), np.repeat(plain, 2, axis=1)[:, ::2]):
        batch.start(np.arange(30), [np.random.default_rng(i) for i in range(30)])
        rewards.append(batch.step(actions).rewards)
    for others in rewards[1:]:
        np.testing.assert_array_equal(others, rewards[0])


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_thousand_random_steps_in_every_dynamics_raise_no_warning(robot):
    names = list(ids.dynamics_ids(robot))
    batch = BatchPhysics(robot, [load_dynamics(n.robot, n.split, n.index) for n in names])
    rngs = [np.random.default_rng(i) for i in range(len(names))]
    batch.start(np.arange(25), rngs)
    high = gymnasium.make(names[0].env_id).action_space.high
    for _ in range(1000):
        actions = np.stack([rng.uniform(-high, high) for rng in rngs])
        result = batch.step(actions)
        assert not result.unstable.any()
        ended = np.flatnonzero(result.terminated)
        if len(ended):
            batch.start(ended, [rngs[i] for i in ended])
    assert not batch._batch.warning[:, :, 1].any()  # counts of every kind of trouble


def test_an_unstable_simulation_touches_no_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where the process stands
    calm, shaken = (batch_of("Hopper", "test", 3, 2) for _ in range(2))
    for batch in (calm, shaken):
        batch.start(np.arange(3), [np.random.default_rng(i) for i in range(3)])
    shaken.qvel[1, 3] = 1e12
    before = shaken.qpos[1].copy()
    actions = np.full((3, 3), 0.3)
    good, bad = calm.step(actions), shaken.step(actions)
    assert bad.unstable.tolist() == [False, True, False]
    assert bad.terminated[1]
    assert bad.rewards[1] == 0.0
    np.testing.assert_array_equal(shaken.qpos[1], before)
    for i in (0, 2):
        np.testing.assert_array_equal(bad.observations[i], good.observations[i])
        assert bad.rewards[i] == good.rewards[i]
    assert shaken.step(actions[:1], np.array([0])).unstable.tolist() == [False]


def test_every_unstable_step_is_reported_not_the_first_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    batch = batch_of("Hopper", "test", 3, 2)
    batch.start(np.arange(3), [np.random.default_rng(i) for i in range(3)])
    calm = batch.qvel[1].copy()
    for _ in range(3):
        batch.qvel[1, 3] = 1e12
        before = batch.states[1].copy()
        assert batch.step(np.zeros((3, 3))).unstable.tolist() == [False, True, False]
        np.testing.assert_array_equal(batch.states[1], before)
        batch.qvel[1] = calm
        assert not batch.step(np.zeros((2, 3)), np.array([1, 2])).unstable.any()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 3)), r"actions have shape \(2, 3\): give \(3, 3\)"),
        (np.full((3, 3), np.nan), "action 0 is not finite"),
    ],
)
def test_bad_actions_never_reach_the_physics(actions, message):
    batch = batch_of("Hopper", "test", 3, 1)
    batch.start(np.arange(3), [np.random.default_rng(0)] * 3)
    before = batch.qpos.copy()
    with pytest.raises(ValueError, match=message):
        batch.step(actions)
    np.testing.assert_array_equal(batch.qpos, before)


def test_an_unknown_robot_is_told_the_near_one():
    for call in (lambda: BatchPhysics("Hoper", [Dynamics()]), lambda: physics_digest("Hoper")):
        with pytest.raises(ValueError, match=r"unknown robot 'Hoper': .* did you mean 'Hopper'"):
            call()


def _step_what_was_inherited(batch: BatchPhysics, pipe: Connection) -> None:
    """In a forked process: step, then let go of it; what is said of it goes into `pipe`."""
    try:
        batch.step(np.zeros((2, 3)))
    except RuntimeError as error:
        pipe.send(str(error))
    del batch
    own = batch_of("Hopper", "test", 2, threads=2)
    own.start(np.arange(2), [np.random.default_rng(i) for i in range(2)])
    pipe.send(own.step(np.zeros((2, 3))).rewards.tolist())


def test_a_forked_process_is_told_to_make_its_own():
    batch = batch_of("Hopper", "test", 2, threads=2)
    batch.start(np.arange(2), [np.random.default_rng(i) for i in range(2)])
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_step_what_was_inherited, args=(batch, theirs))
    child.start()
    assert ours.poll(60)
    assert "make them in the process that steps them, with threads=1, or start it by 'spawn'" in ours.recv()
    assert ours.poll(60)
    assert ours.recv() == batch.step(np.zeros((2, 3))).rewards.tolist()
    child.join(60)
    assert child.exitcode == 0


def test_a_forked_process_steps_what_has_no_threads():
    batch = batch_of("Hopper", "test", 2, threads=1)
    batch.start(np.arange(2), [np.random.default_rng(i) for i in range(2)])
    ours, theirs = multiprocessing.Pipe()
    fork = multiprocessing.get_context("fork")
    child = fork.Process(target=lambda: theirs.send(batch.step(np.zeros((2, 3))).rewards.tolist()))
    child.start()
    assert ours.poll(60)
    assert ours.recv() == batch.step(np.zeros((2, 3))).rewards.tolist()
    child.join(60)
    assert child.exitcode == 0


THREADS = """
import os, sys
if sys.argv[1:]:
    os.sched_setaffinity(0, {int(sys.argv[1])})
from dynagen_bench.dynamics import Dynamics
from dynagen_bench.envs import BatchPhysics
before = len(os.listdir("/proc/self/task"))
physics = BatchPhysics("Hopper", [Dynamics()] * 4)
print(physics.threads, 1 + len(os.listdir("/proc/self/task")) - before)  # the caller's own is one of them
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be pinned here")
def test_threads_are_as_many_as_processors_that_the_process_may_run_on():
    mine = sorted(os.sched_getaffinity(0))
    for pin, variable, expected in (([], "", len(mine)), ([f"{mine[-1]}"], "", 1), ([], "1", 1), ([], "3", 3)):
        environment = {**os.environ, "DYNAGEN_THREADS": variable}
        told = subprocess.run([sys.executable, "-c", THREADS, *pin], env=environment, capture_output=True, check=True)
        assert told.stdout.split() == [b"%d" % expected] * 2


@pytest.mark.parametrize("given", ["0", "-1", "two"])
def test_a_variable_that_is_no_number_of_threads_is_refused(given, monkeypatch):
    monkeypatch.setenv("DYNAGEN_THREADS", given)
    with pytest.raises(ValueError, match=f"^DYNAGEN_THREADS is '?{given}'?: give a whole number from 1 on$"):
        BatchPhysics("Hopper", [Dynamics()])


def test_no_dynamics_is_refused():
    with pytest.raises(ValueError, match="needs at least one"):
        BatchPhysics("Hopper", [])
