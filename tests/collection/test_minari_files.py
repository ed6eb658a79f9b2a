"""One dynamics' Minari dataset: what it holds, that it can be made again, and what is kept of what is there."""

import contextlib
import dataclasses
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import warnings

import gymnasium
import h5py
import minari
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection import minari_files
from dynagen_bench.collection.contents import content_hash, dataset_folder, read_episodes, read_record
from dynagen_bench.collection.episodes import collect_episodes
from dynagen_bench.collection.minari_files import build_dataset, every_nth
from dynagen_bench.collection.policies import load_policies, policy_file
from tests.tiny_data import SNAPSHOTS, store_random_policies

NAME = ids.make_id("Hopper", "test", 3)
ID = "dynagen/Hopper-RandDyn/test3-v0"


@pytest.fixture
def build(tiny_policies):
    """Build NAME's tiny dataset, two episodes of each of four snapshots."""
    return lambda **changes: build_dataset(
        NAME, **{"policies_folder": tiny_policies, "episodes_per_snapshot": 2, **changes}
    )


def test_metadata_is_full(build):
    record = build(reference=(-1.0, 99.0))
    metadata = minari.load_dataset(ID).storage.metadata
    assert metadata["dataset_id"] == ID
    assert metadata["algorithm_name"] == "SAC"
    assert metadata["data_format"] == "hdf5"
    assert metadata["requirements"] == ["dynagen-bench==0.1.0", "mujoco==4.0.0", "gymnasium~=1.4.0"]
    assert all(metadata[field] for field in ("author", "algorithm_name", "requirements", "description"))
    assert (metadata["ref_min_score"], metadata["ref_max_score"]) == (-1.0, 99.0)
    assert metadata["total_episodes"] == record.episodes == 8
    assert metadata["total_steps"] == record.steps
    assert record.mujoco == "4.0.0"
    assert read_record(dataset_folder(ID)) == record


def test_reference_scores_are_the_datas_own_where_none_are_given(build):
    record = build()
    returns = [episode.rewards.sum() for episode in minari.load_dataset(ID)]
    assert record.returns == {"min": min(returns), "max": max(returns), "mean": np.mean(returns)}
    metadata = minari.load_dataset(ID).storage.metadata
    assert (metadata["ref_min_score"], metadata["ref_max_score"]) == (min(returns), max(returns))


def test_every_episode_says_where_it_is_from(build, tiny_policies):
    build()
    snapshots, _ = load_policies(policy_file(NAME, tiny_policies))
    metadata = list(minari.load_dataset(ID).storage.get_episode_metadata(range(8)))
    assert [about["snapshot"] for about in metadata] == [s for s in SNAPSHOTS for _ in range(2)]
    assert [about["policy_sha256"] for about in metadata] == [
        snapshots[about["snapshot"]].content_hash() for about in metadata
    ]
    assert {about["dynamics"] for about in metadata} == {"Hopper-RandDyn-test3"}
    assert len({about["seed"] for about in metadata}) == 8


def recover(dataset, **kwargs):
    with warnings.catch_warnings():
        # Minari looks for the requirement "dynagen-bench"; these tests also run from a checkout that is not installed
        warnings.filterwarnings("ignore", "Package dynagen-bench is not installed")
        return dataset.recover_environment(**kwargs)


def test_stored_episodes_replay_bit_for_bit_in_the_recovered_environment(build):
    build()
    dataset = minari.load_dataset(ID)
    env = recover(dataset)
    metadata = dataset.storage.get_episode_metadata(range(8))
    for episode, about in zip(dataset, metadata, strict=True):
        observation, _ = env.reset(seed=about["seed"])
        np.testing.assert_array_equal(observation, episode.observations[0])
        for t, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, _ = env.step(action)
            np.testing.assert_array_equal(observation, episode.observations[t + 1])
            assert (reward, terminated, truncated) == (
                episode.rewards[t],
                episode.terminations[t],
                episode.truncations[t],
            )
        assert terminated or truncated


def test_recovered_environment_has_the_same_dynamics(build):
    build()
    dataset = minari.load_dataset(ID)
    made = gymnasium.make("Hopper-RandDyn-test3")
    for eval_env in (False, True):
        recovered = recover(dataset, eval_env=eval_env)
        assert recovered.spec == made.spec
        for field in ("body_mass", "body_inertia", "dof_damping", "geom_friction", "body_subtreemass"):
            ours, theirs = (getattr(env.unwrapped.model, field) for env in (made, recovered))
            np.testing.assert_array_equal(ours, theirs)


def test_what_is_read_is_what_was_collected(build, tiny_policies):
    record = build()
    snapshots, _ = load_policies(policy_file(NAME, tiny_policies))
    collected = list(collect_episodes(NAME, snapshots, 2))
    stored = list(read_episodes(dataset_folder(ID)))
    for one, other in zip(collected, stored, strict=True):
        assert (one.seed, one.snapshot, one.policy_hash) == (other.seed, other.snapshot, other.policy_hash)
        for field in ("observations", "actions", "rewards"):
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
            assert getattr(one, field).dtype == getattr(other, field).dtype
    assert content_hash(collected) == content_hash(stored) == record.sha256


def test_the_hash_is_of_order_seeds_and_every_number(build):
    build()
    episodes = list(read_episodes(dataset_folder(ID)))
    whole = content_hash(episodes)
    assert content_hash(episodes[::-1]) != whole
    assert content_hash(episodes[:-1]) != whole
    for field in ("observations", "actions", "rewards"):
        changed = list(read_episodes(dataset_folder(ID)))
        array = getattr(changed[3], field)
        array[-1] = np.nextafter(array[-1], np.inf)
        assert content_hash(changed) != whole
    for field, value in (
        ("seed", 1),
        ("snapshot", 1),
        ("policy_hash", "0"),
        ("terminated", not episodes[3].terminated),
    ):
        other = [*episodes[:3], dataclasses.replace(episodes[3], **{field: value}), *episodes[4:]]
        assert content_hash(other) != whole


def test_two_builds_have_one_hash_and_the_first_is_kept(build, monkeypatch, tmp_path):
    first = build()
    file = dataset_folder(ID) / "data" / "main_data.hdf5"
    changed = file.stat().st_mtime_ns
    assert build() == first
    assert file.stat().st_mtime_ns == changed
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "another"))
    assert build() == first


def damage_a_number():
    with h5py.File(dataset_folder(ID) / "data" / "main_data.hdf5", "a") as file:
        file["episode_3/rewards"][0] += 1.0


def damage_the_file():
    file = dataset_folder(ID) / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:3000])


def lose_the_metadata():
    (dataset_folder(ID) / "data" / "metadata.json").write_text("{")


def lose_an_episode():
    with h5py.File(dataset_folder(ID) / "data" / "main_data.hdf5", "a") as file:
        del file["episode_3"]


def change_one_byte(old, new):
    file = dataset_folder(ID) / "data" / "main_data.hdf5"
    content = file.read_bytes()
    assert old in content
    file.write_bytes(content.replace(old, new, 1))


def damage_a_name():
    change_one_byte(b"\x00total_steps", b"\x00tot\xfel_steps")
    with pytest.raises(TypeError):
        list(read_episodes(dataset_folder(ID)))


def damage_a_size():
    change_one_byte(b"\x08\x00total_steps", b"\x08\xfftotal_steps")
    with pytest.raises(RuntimeError):
        list(read_episodes(dataset_folder(ID)))


def change_the_record(**changes):
    file = dataset_folder(ID) / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    file.write_text(json.dumps({**metadata, "dynagen": {**metadata["dynagen"], **changes}}))


@pytest.mark.parametrize(
    "damage",
    [
        damage_a_number,
        damage_the_file,
        damage_a_name,
        damage_a_size,
        lose_the_metadata,
        lose_an_episode,
        functools.partial(change_the_record, steps=12),
        functools.partial(change_the_record, episodes=7),
        functools.partial(change_the_record, returns={"min": 0, "mean": 0, "max": 0}),
        functools.partial(change_the_record, recipe={}),
    ],
)
def test_a_damaged_dataset_is_made_again(build, damage):
    first = build()
    damage()
    assert build(expected_sha256=first.sha256) == first
    assert content_hash(read_episodes(dataset_folder(ID))) == first.sha256
    assert list(minari.list_local_datasets()) == [ID]


def test_data_of_other_policies_are_made_again_unless_they_are_the_official_ones(build, tmp_path):
    first = build()
    store_random_policies(tmp_path, [NAME], seed=1)
    assert build(policies_folder=tmp_path, expected_sha256=first.sha256) == first
    assert build(policies_folder=tmp_path).sha256 != first.sha256
    assert build(expected_sha256=first.sha256) == first


def test_progress_ends_at_all_episodes(build):
    calls = []
    build(progress=lambda done, total: calls.append((done, total)))
    assert calls == [(done, 8) for done in range(9)]


def test_a_part_is_another_dataset_beside_the_whole(build):
    build()
    part = build(every=2)
    assert set(minari.list_local_datasets()) == {"dynagen/Hopper-RandDyn/test3-every2-v0", ID}
    dataset = minari.load_dataset("dynagen/Hopper-RandDyn/test3-every2-v0")
    assert {about["snapshot"] for about in dataset.storage.get_episode_metadata(range(4))} == {200, 400}
    assert "This is a part, one snapshot in 2" in dataset.storage.metadata["description"]
    assert part.recipe["every"] == 2
    assert build(every=np.int64(2)) == part
    assert dataset.id not in {name.dataset_id for name in ids.dynamics_ids("Hopper")}
    assert NAME.part_id(1) == NAME.dataset_id == ID


def test_a_part_takes_the_last_of_every_n():
    assert list(every_nth(dict.fromkeys(range(50_000, 1_000_001, 50_000)), 4)) == [200_000 * i for i in range(1, 6)]


def test_bad_input_is_one_line(build, tmp_path, tiny_policies):
    with pytest.raises(ValueError, match=r"every is 5: give a whole number from 1 to 4"):
        build(every=5)
    for given in (0, 1.5, True):
        with pytest.raises(ValueError, match=f"episodes_per_snapshot is {given}: give a whole number from 1 on"):
            build(episodes_per_snapshot=given)
    with pytest.raises(FileNotFoundError, match=r"no behaviour policies at .* `dynagen collect Hopper test3`"):
        build(policies_folder=tmp_path)
    other = policy_file(NAME, tmp_path)
    other.parent.mkdir()
    other.write_bytes(policy_file(ids.make_id("Hopper", "train", 0), tiny_policies).read_bytes())
    with pytest.raises(ValueError, match="holds policies of Hopper-RandDyn-train0, not of Hopper-RandDyn-test3"):
        build(policies_folder=tmp_path)
    assert not minari.list_local_datasets()


def test_a_disk_without_room_is_told_before_anything_is_written(build, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**12, 10**12 - 300_000, 300_000))
    with pytest.raises(
        OSError, match=r"^no room for 0\.4 MB in .*/dynagen: make some there, or let MINARI_DATASETS_PA"
    ):
        build()
    assert {path.name for path in dataset_folder(ID).parent.iterdir()} == {".test3-v0.lock", "namespace_metadata.json"}


@pytest.mark.parametrize("robot", ["HalfCheetah", "SlimHumanoid"])  # all of their episodes are as long as can be
def test_no_build_begins_in_less_room_than_it_takes(robot, tmp_path, monkeypatch):
    name = ids.make_id(robot, "test", 3)
    store_random_policies(tmp_path, [name])
    build_dataset(name, policies_folder=tmp_path, episodes_per_snapshot=2)
    folder = dataset_folder(name.dataset_id)
    taken = sum(file.stat().st_size for file in (folder / "data").iterdir())
    shutil.rmtree(folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(taken, 0, taken))
    with pytest.raises(OSError, match="no room for"):
        build_dataset(name, policies_folder=tmp_path, episodes_per_snapshot=2)


@pytest.mark.parametrize(("moment", "kept"), [(3, 0), (8, 1)])  # in the middle; in the last episode, when all is there
def test_ctrl_c_is_never_lost_and_leaves_no_thread(build, monkeypatch, moment, kept):
    buffers, threads, as_ever = [], threading.active_count(), minari_files._buffer

    def drop_it(episode):
        buffers.append(as_ever(episode))
        if len(buffers) == moment:
            for _ in range(2):
                with contextlib.suppress(KeyboardInterrupt):  # as a callback in h5py does
                    signal.raise_signal(signal.SIGINT)
        return buffers[-1]

    monkeypatch.setattr(minari_files, "_buffer", drop_it)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # in a shell's background it is ignored
    try:
        with pytest.raises(KeyboardInterrupt):
            build()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert threading.active_count() == threads
    assert len(minari.list_local_datasets()) == kept


def test_no_dataset_and_no_dataset_of_ours(tmp_path):
    with pytest.raises(FileNotFoundError, match="no dataset at"):
        read_record(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "metadata.json").write_text(json.dumps({"dataset_id": "else/where-v0"}))
    with pytest.raises(ValueError, match="holds no dataset of this benchmark"):
        read_record(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"recipe": {}}, "its recipe lack dynamics, every, mujoco, policies"),
        ({"returns": {"min": 1.0}}, "its returns lack mean, max"),
        ({"steps": "many"}, "it counts 8 episodes and 'many' steps"),
        ({"recipe": None}, "its recipe are no mapping but None"),
        ({"returns": ["min", "mean", "max"]}, "its returns are no mapping but"),
        ({"returns": {"min": "a", "mean": 1.0, "max": 2.0}}, "its returns are no finite numbers but"),
        ({"returns": {"min": 1.0, "mean": float("nan"), "max": 2.0}}, "its returns are no finite numbers but"),
        ({"returns": {"min": 1.0, "mean": 1.5, "max": 10**400}}, "its returns are no finite numbers but"),
        ({"sha256": 5}, "its sha256 is 5"),
    ],
)
def test_a_record_that_lacks_something_is_none_of_ours(build, changes, message):
    build()
    change_the_record(**changes)
    with pytest.raises(
        ValueError, match=f"holds no dataset of this benchmark .*{message}.*: remove it and build again"
    ):
        read_record(dataset_folder(ID))


def test_minaris_command_lists_and_shows_it(build):
    build()
    listed = _minari("list", "local", "--prefix", "dynagen")
    assert ID in listed
    shown = _minari("show", ID)
    assert "Hopper-RandDyn-test3" in shown
    assert "DynaGen Bench contributors" in shown


def _minari(*arguments):
    command = [sys.executable, "-W", "error::UserWarning", "-m", "minari.cli", *arguments]
    wide = {**os.environ, "COLUMNS": "200"}  # its tables cut what does not fit
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, env=wide)
    assert result.returncode == 0, result.stderr
    return result.stdout
