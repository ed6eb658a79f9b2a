"""One SAC run: its environments are the benchmark's, its stored actors are what it learned, and it can be stopped."""

import contextlib
import dataclasses
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection import runs
from dynagen_bench.collection.policies import load_policies, policy_file
from dynagen_bench.collection.runs import collect, missing_runs, run_job
from dynagen_bench.collection.sac import BatchVecEnv, actor_policy, train_behaviour_policies
from dynagen_bench.collection.settings import SACSettings
from tests.jobs.test_local import surely

NAME = ids.make_id("Hopper", "test", 3)
TINY = SACSettings(
    total_steps=256, snapshot_every=128, environments=16, gradient_steps=2, batch_size=8, learning_starts=32, hidden=8
)


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> Path:
    """The file of one tiny run."""
    return train_behaviour_policies(NAME, TINY, tmp_path_factory.mktemp("first"))


def test_same_settings_same_bytes(stored, tmp_path):
    again = train_behaviour_policies(NAME, TINY, tmp_path)
    assert again.read_bytes() == stored.read_bytes()
    header = "step,mean_return,mean_length,seconds"
    assert again.with_suffix(".csv").read_text().splitlines()[0] == header


def test_a_run_stores_its_snapshots_and_what_made_them(stored):
    snapshots, metadata = load_policies(stored)
    assert list(snapshots) == [128, 256]
    assert metadata["dynamics"] == "Hopper-RandDyn-test3"
    assert metadata["versions"]["mujoco"] == "4.0.0"
    assert SACSettings(**metadata["settings"]) == TINY
    assert snapshots[128].content_hash() != snapshots[256].content_hash()
    assert all(w.dtype == np.float16 for w in snapshots[128].weights.values())


def test_stored_actor_acts_as_the_trained_one():
    from sbx import SAC

    model = SAC("MlpPolicy", BatchVecEnv(NAME, 4, np.random.default_rng(0)), policy_kwargs={"net_arch": [64, 64]})
    observations = np.random.default_rng(1).normal(size=(50, 11))
    theirs, _ = model.predict(observations.astype(np.float32), deterministic=True)
    ours = actor_policy(model.policy.actor_state.params).act(observations, np.ones(3), noise=None)
    np.testing.assert_allclose(ours, theirs, atol=5e-3)  # float16 weights


def test_training_environments_are_the_benchmarks():
    batch = BatchVecEnv(ids.make_id("HalfCheetah", "test", 0), 3, np.random.default_rng(5))
    single = gymnasium.make("HalfCheetah-RandDyn-test0")
    single.reset(seed=0)
    batch.reset()
    env = single.unwrapped
    env.set_state(batch._physics.qpos[1].copy(), batch._physics.qvel[1].copy())
    rng = np.random.default_rng(6)
    for step in range(200):
        action = rng.uniform(-1, 1, 6).astype(np.float32)
        batch.step_async(np.stack([action] * 3))
        observations, rewards, dones, infos = batch.step_wait()
        observation, reward, _, truncated, _ = single.step(action)
        assert rewards[1] == np.float32(reward)
        assert bool(dones[1]) == truncated == (step == 199)
        last = infos[1]["terminal_observation"] if truncated else observations[1]
        np.testing.assert_array_equal(last, observation.astype(np.float32))
    assert infos[1]["TimeLimit.truncated"]
    assert infos[1]["episode"]["l"] == 200


def test_a_fall_ends_an_episode_and_is_no_time_limit():
    batch = BatchVecEnv(NAME, 3, np.random.default_rng(5))
    single = gymnasium.make(NAME.env_id)
    single.reset(seed=0)
    batch.reset()
    single.unwrapped.set_state(batch._physics.qpos[1].copy(), batch._physics.qvel[1].copy())
    rng, total = np.random.default_rng(6), 0.0
    for step in range(1, 200):
        action = rng.uniform(-1, 1, 3).astype(np.float32)
        batch.step_async(np.stack([action] * 3))
        observations, _, dones, infos = batch.step_wait()
        observation, reward, terminated, *_ = single.step(action)
        total += reward
        assert bool(dones[1]) == terminated
        if terminated:
            break
        assert batch._steps[1] == step
    assert terminated
    np.testing.assert_array_equal(infos[1]["terminal_observation"], observation.astype(np.float32))
    assert infos[1]["TimeLimit.truncated"] is False
    assert (infos[1]["episode"]["r"], infos[1]["episode"]["l"]) == (pytest.approx(total), step)
    assert np.abs(observations[1, 5:]).max() < 0.01  # another start
    assert (batch._steps[1], batch._returns[1]) == (0, 0.0)


def test_every_setting_reaches_the_learner(tmp_path, monkeypatch):
    from sbx import SAC

    given = SACSettings(
        total_steps=256, snapshot_every=128, environments=6, gradient_steps=3, batch_size=9, policy_delay=4,
        learning_rate=7e-4, gamma=0.9, hidden=8, critic_hidden=12, critic_layer_norm=True, learning_starts=33, seed=5,
    )  # fmt: skip
    made = []

    def learn(self, total_timesteps, callback, **options):
        made.append((self, total_timesteps, callback))
        raise KeyboardInterrupt  # before the first step

    monkeypatch.setattr(SAC, "learn", learn)
    with pytest.raises(KeyboardInterrupt):
        train_behaviour_policies(NAME, given, tmp_path)
    ((model, steps, callback),) = made
    for field in ("gradient_steps", "batch_size", "policy_delay", "gamma", "learning_starts"):
        assert getattr(model, field) == getattr(given, field), field
    assert (model.n_envs, steps, callback._every) == (6, 256, 128)
    assert model.lr_schedule(1.0) == 7e-4
    assert model.policy_kwargs["net_arch"] == {"pi": [8, 8], "qf": [12, 12]}
    assert model.policy_kwargs["layer_norm"]
    assert not list(tmp_path.iterdir())


RUN = """
import dataclasses
from pathlib import Path
from dynagen_bench import ids
from dynagen_bench.collection import runs
from tests.collection import test_sac
if {tell}:
    job = runs.run_job
    runs.run_job = lambda *given: dataclasses.replace(job(*given), function="tests.collection.test_sac:run_and_tell")
names = [ids.make_id("Hopper", "test", i) for i in (3, 1)]
runs.collect(names, dataclasses.replace(test_sac.TINY, total_steps={steps}), Path({folder!r}), processes=1)
"""


def run_and_tell(scratch, report, **arguments):
    """`run_one`, and a file as soon as it has taken some steps."""

    def tell(steps):
        report(steps)
        (scratch / "steps").touch()

    runs.run_one(scratch, tell, **arguments)


@contextlib.contextmanager
def background_run(tmp_path: Path, steps: int, tell: bool = False) -> Iterator[subprocess.Popen[bytes]]:
    """`collect` in a process group of its own, killed whole (kill -9) when the block ends."""
    script = RUN.format(folder=str(tmp_path / "policies"), steps=steps, tell=tell)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    run = subprocess.Popen([sys.executable, "-c", script], start_new_session=True, env=environment)
    try:
        yield run
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)
        run.wait()


def test_a_killed_run_leaves_nothing_and_the_next_does_what_is_missing(stored, tmp_path):
    folder = tmp_path / "policies"
    names = [ids.make_id("Hopper", "test", i) for i in (3, 1)]
    with background_run(tmp_path, steps=10**8, tell=True) as run:
        surely(lambda: any(folder.glob(".jobs/*/steps")))  # into the run, however slow the machine is
        assert run.poll() is None
    assert missing_runs(names, folder) == names
    assert not list(folder.rglob("*.safetensors"))

    there = policy_file(names[1], folder)
    there.parent.mkdir()
    shutil.copyfile(stored, there)  # as the package has it, which knows no jobs
    since = there.stat().st_mtime_ns
    with background_run(tmp_path, steps=TINY.total_steps) as run:
        assert run.wait(timeout=300) == 0
    assert missing_runs(names, folder) == []
    assert there.stat().st_mtime_ns == since
    assert policy_file(NAME, folder).read_bytes() == stored.read_bytes()  # of the same run, not as a job
    before = policy_file(NAME, folder).stat().st_mtime_ns
    collect(names, TINY, folder)  # nothing is missing: nothing runs
    assert policy_file(NAME, folder).stat().st_mtime_ns == before


def test_a_run_of_other_settings_is_not_taken_for_the_one_that_is_asked_for(stored):
    folder = stored.parents[1]
    collect([NAME], TINY, folder)  # nothing is missing: nothing runs
    with pytest.raises(ValueError, match=r"test3\.safetensors was trained with gamma=0\.99: give another --folder"):
        collect([NAME], dataclasses.replace(TINY, gamma=0.9), folder)


def test_the_policies_are_the_last_file_of_a_run():
    job = run_job(NAME, TINY)
    assert job.outputs == ("Hopper/test3.csv", "Hopper/test3.safetensors")
    assert job.total == 256
    assert SACSettings(**job.arguments["settings"]) == TINY


def test_missing_policies_say_how_they_are_made(tmp_path):
    with pytest.raises(FileNotFoundError, match="dynagen collect Hopper test3"):
        load_policies(policy_file(NAME, tmp_path))


def test_without_the_extra_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)
    with pytest.raises(RuntimeError, match=r"pip install 'dynagen-bench\[collect\]'"):
        collect([NAME], TINY, tmp_path)


def test_no_policies_are_trained_in_a_nominal_robot(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda module: None)  # nothing is trained if this is not refused
    with pytest.raises(ValueError, match=r"^no data are made in the nominal robots: write train0 to train19"):
        collect([NAME, ids.make_id("Hopper", "nominal", 0)], TINY, tmp_path)


def test_another_file_is_refused(tmp_path):
    import safetensors.numpy

    path = tmp_path / "Hopper" / "test3.safetensors"
    path.parent.mkdir()
    safetensors.numpy.save_file({"00000128/hidden0/weight": np.zeros((2, 2), np.float16)}, path)
    with pytest.raises(ValueError, match="holds no behaviour policies"):
        load_policies(path)
    path.write_bytes(b"half a file")
    with pytest.raises(ValueError, match="holds no behaviour policies"):
        load_policies(path)
