"""Flat arrays: they hold the Minari episodes, are made once, and are never of other data than asked for."""

import dataclasses
import errno
import functools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import minari
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.collection.minari_files import build_dataset
from dynagen_bench.datasets import OfflineDataset, load_adaptation, load_dataset
from dynagen_bench.datasets.flat_files import cache_folder
from tests.tiny_data import SNAPSHOTS, three_step_episodes

NAMES = list(ids.dynamics_ids("Hopper", ("test",)))


@pytest.fixture
def own_data(tiny_policies):
    """Hopper's test data in this test's own Minari root, one episode a snapshot: to be changed."""
    return lambda **changes: [
        build_dataset(name, **{"policies_folder": tiny_policies, "episodes_per_snapshot": 1, **changes})
        for name in NAMES
    ]


def folders():
    """The finished folders in the cache."""
    return sorted(path for path in cache_folder().glob("flat-v1/[!.]*"))


def test_arrays_hold_the_episodes_in_the_documented_layout(tiny_data):
    flat = load_dataset("Hopper", "test")
    assert (flat.robot, flat.split, flat.state_size, flat.action_size) == ("Hopper", "test", 11, 3)
    number = row = 0
    for index in range(5):
        dataset = minari.load_dataset(f"dynagen/Hopper-RandDyn/test{index}-v0")
        about = dataset.storage.get_episode_metadata(range(12))
        for episode, metadata in zip(dataset, about, strict=True):
            length = len(episode.actions)
            assert flat.episode_starts[number] == row
            assert flat.episode_lengths[number] == length
            assert flat.episode_dynamics[number] == index
            assert flat.episode_seeds[number] == metadata["seed"]
            assert flat.episode_snapshots[number] == metadata["snapshot"]
            assert flat.episode_terminated[number] == episode.terminations[-1]
            assert flat.episode_returns[number] == episode.rewards.sum()
            rows = slice(row, row + length)
            np.testing.assert_array_equal(
                flat.observations[row : row + length + 1], episode.observations.astype(np.float32)
            )
            np.testing.assert_array_equal(flat.actions[rows], episode.actions)
            np.testing.assert_array_equal(flat.rewards[rows], episode.rewards.astype(np.float32))
            to_go = [episode.rewards[t:].sum() for t in range(length)]
            np.testing.assert_allclose(flat.returns_to_go[rows], to_go, rtol=1e-6, atol=1e-6)
            last = row + length
            assert not flat.actions[last].any()
            assert (flat.rewards[last], flat.returns_to_go[last]) == (0, 0)
            row, number = last + 1, number + 1
    assert (len(flat.observations), len(flat.episode_starts)) == (row, number)
    assert flat.num_steps == row - number
    assert set(flat.episode_snapshots) == set(SNAPSHOTS)


def test_types_are_the_documented_ones_and_rows_are_mapped(tiny_data):
    flat = load_dataset("Hopper")
    for field in ("observations", "actions", "rewards", "returns_to_go"):
        array = getattr(flat, field)
        assert array.dtype == np.float32
        assert isinstance(array, np.memmap)
        assert not array.flags.writeable
    dtypes = {f.name: getattr(flat, f.name).dtype for f in dataclasses.fields(flat) if f.name.startswith("episode_")}
    assert dtypes.pop("episode_returns") == np.float64
    assert dtypes.pop("episode_terminated") == np.bool_
    assert set(dtypes.values()) == {np.dtype(np.int64)}


def mapped_memory(file):
    """Kilobytes that this process has of a file's pages: all of them, its share of them, and those it has alone."""
    maps = Path("/proc/self/smaps").read_text().split(str(file))[1]
    return [int(re.search(rf"^{what}: +(\d+) kB$", maps, re.MULTILINE)[1]) for what in ("Rss", "Pss", "Private_Dirty")]


OTHER_READER = """
from dynagen_bench import load_dataset
data = load_dataset("Hopper", progress=False)
print(float(data.observations.sum()), flush=True)
input()
"""


@pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="this system does not tell whose a page is")
def test_two_processes_have_the_same_pages(tiny_data):
    data = load_dataset("Hopper")
    total = float(data.observations.sum())
    file = data.observations.filename
    alone, share, _ = mapped_memory(file)
    assert alone == share > 0
    command = [sys.executable, "-c", OTHER_READER]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert float(other.stdout.readline()) == total
        both, share, private = mapped_memory(file)
        other.communicate("\n")
    assert both == alone
    assert share == pytest.approx(both / 2, abs=4)  # half of each page is the other's
    assert private == 0


def test_train_is_the_default_and_has_no_test_episode(tiny_data):
    train, test = load_dataset("Hopper"), load_dataset("Hopper", "test")
    assert (train.split, test.split) == ("train", "test")
    assert set(train.episode_dynamics) == set(range(20))
    assert not set(train.episode_seeds) & set(test.episode_seeds)
    assert train.normalization().mean.shape == (11,)
    with pytest.raises(ValueError, match="this is split 'test': normalisation is of train data"):
        test.normalization()


def test_test_data_in_the_place_of_train_data_are_refused(tiny_data, tmp_path, monkeypatch):
    root = tmp_path / "mixed"
    shutil.copytree(tiny_data, root)
    place = root / "dynagen" / "Hopper-RandDyn" / "train2-v0"
    shutil.rmtree(place)
    shutil.copytree(root / "dynagen" / "Hopper-RandDyn" / "test3-v0", place)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    with pytest.raises(ValueError, match="holds data of Hopper-RandDyn-test3, every=1, not of Hopper-RandDyn-train2"):
        load_dataset("Hopper")


def test_some_dynamics_in_the_order_asked(tiny_data):
    some = load_dataset("Hopper", "train", indices=[7, 3])
    assert some.episode_dynamics.tolist() == [7] * 12 + [3] * 12
    whole = load_dataset("Hopper", "train")
    np.testing.assert_array_equal(some.episode_seeds[12:], whole.episode_seeds[whole.episode_dynamics == 3])


def test_arrays_are_made_once_and_again_when_the_data_change(own_data, tiny_policies):
    own_data()
    first = load_dataset("Hopper", "test")
    (folder,) = folders()
    made = folder.stat().st_mtime_ns
    load_dataset("Hopper", "test")
    assert folders() == [folder]
    assert folder.stat().st_mtime_ns == made
    own_data(episodes_per_snapshot=2)
    second = load_dataset("Hopper", "test")
    assert len(folders()) == 2
    assert len(second.episode_lengths) == 2 * len(first.episode_lengths)


def test_a_part_is_loaded_by_its_own_name(own_data):
    own_data(every=2)
    assert set(load_dataset("Hopper", "test", every=2).episode_snapshots) == {200, 400}
    with pytest.raises(
        FileNotFoundError, match=r"no data of Hopper-RandDyn-test0 at .*: make them with `dynagen data build"
    ):
        load_dataset("Hopper", "test")


def data_file(name, file="main_data.hdf5"):
    return dataset_folder(name.dataset_id) / "data" / file


def change_a_number(file):
    with h5py.File(file, "a") as opened:
        opened["episode_2/actions"][0, 0] += 2.0**-12


def lose_an_episode(file):
    with h5py.File(file, "a") as opened:
        del opened["episode_2"]


def lose_an_array(file):
    with h5py.File(file, "a") as opened:
        del opened["episode_2/rewards"]


def lose_a_row(file):
    with h5py.File(file, "a") as opened:
        rewards = opened["episode_2/rewards"][:-1]
        del opened["episode_2/rewards"]
        opened["episode_2/rewards"] = rewards


def cut(file):
    file.write_bytes(file.read_bytes()[:-2000])


def record_other_numbers(file, **numbers):
    metadata = json.loads(file.with_name("metadata.json").read_text())
    metadata["dynagen"].update(numbers)
    file.with_name("metadata.json").write_text(json.dumps(metadata))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change_a_number, "its episodes are not those it records"),
        (lose_an_episode, "its episodes cannot be read, KeyError"),
        (lose_an_array, "its episodes cannot be read, KeyError"),
        (lose_a_row, "its episodes are not those it records"),
        (cut, "its episodes cannot be read, OSError"),
        (os.unlink, "it has no main_data.hdf5"),
        (functools.partial(record_other_numbers, steps=3), "its episodes are not those it records"),
        (functools.partial(record_other_numbers, episodes=900), "its episodes are not those it records"),
    ],
)
def test_damaged_data_are_refused_and_leave_no_arrays(own_data, damage, message):
    own_data()
    load_dataset("Hopper", "test")
    before = folders()
    damage(data_file(NAMES[3]))
    shutil.rmtree(before[0])  # a record that alone has changed does not make arrays again
    with pytest.raises(
        ValueError, match=rf"test3-v0 is damaged: {message}; build it again with `dynagen data build Hopper`$"
    ):
        load_dataset("Hopper", "test")
    assert folders() == []
    own_data()
    assert len(load_dataset("Hopper", "test").rewards)


def test_a_record_without_its_recipe_is_refused(own_data):
    own_data()
    record_other_numbers(data_file(NAMES[3]), recipe={})
    with pytest.raises(ValueError, match=r"test3-v0 holds no dataset of this benchmark .*its recipe lack dynamics"):
        load_dataset("Hopper", "test")


@pytest.mark.parametrize("name", ["observations", "rewards", "episode_starts"])
@pytest.mark.parametrize("left", [None, 0, -1])
def test_a_cache_that_is_emptied_in_part_is_made_again(own_data, name, left):
    own_data()
    rewards = np.array(load_dataset("Hopper", "test").rewards)
    file = folders()[0] / f"{name}.npy"
    if left is None:
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:left])
    for _ in range(2):
        np.testing.assert_array_equal(load_dataset("Hopper", "test").rewards, rewards)
    assert len(folders()) == 1


def test_a_full_disk_ends_in_one_line_and_leaves_nothing(own_data, monkeypatch):
    own_data()

    def full(file, offset, length):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.posix_fallocate", full)
        with pytest.raises(OSError, match=r"^no room for 0 MB in .*cache \(No space left on device\): make"):
            load_dataset("Hopper", "test")
    assert not [path for path in cache_folder().rglob("*") if path.suffix != ".lock" and path.name != "flat-v1"]
    assert len(load_dataset("Hopper", "test").rewards)


def test_arrays_are_made_where_no_space_can_be_reserved(own_data, monkeypatch):
    own_data()

    def unsupported(file, offset, length):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr("os.posix_fallocate", unsupported)
    assert len(load_dataset("Hopper", "test").rewards)


def test_data_of_another_mujoco_are_said_to_be(own_data, monkeypatch):
    own_data()
    monkeypatch.setattr("dynagen_bench.datasets.flat.version", lambda package: "9.9.9")
    with pytest.warns(UserWarning, match=r"data of Hopper were made with MuJoCo 4\.0\.0, here is 9\.9\.9"):
        load_dataset("Hopper", "test")


def test_missing_data_name_the_command():
    with pytest.raises(FileNotFoundError, match=r"no data of Hopper-RandDyn-train0 .* `dynagen data build Hopper`$"):
        load_dataset("Hopper")
    with pytest.raises(FileNotFoundError, match=r"`dynagen data build Hopper --every 4`$"):
        load_dataset("Hopper", every=4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": "Hoper"}, "did you mean 'Hopper'"),
        ({"robot": "Hopper", "split": "nominal"}, "no data of split 'nominal': choose 'train' or 'test'"),
        ({"robot": "Hopper", "split": "test", "indices": [5]}, "choose a whole number from 0 to 4"),
        ({"robot": "Hopper", "indices": [1, 1]}, "give at least one, and none twice"),
        ({"robot": "Hopper", "indices": []}, "give at least one, and none twice"),
        ({"robot": "Hopper", "every": "20"}, "every is '20': give a whole number from 1 on"),
        ({"robot": "Hopper", "every": 0}, "every is 0: give a whole number from 1 on"),
        ({"robot": "Hopper", "every": 4.0}, "every is 4.0: give a whole number from 1 on"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        load_dataset(**arguments)


@pytest.mark.usefixtures("tiny_data")
def test_what_is_no_share_and_no_number_is_refused_before_arrays_are_made(monkeypatch):
    monkeypatch.setattr("dynagen_bench.datasets.flat.map_arrays", lambda *_: pytest.fail("arrays are made"))
    with pytest.raises(ValueError, match="quality is 30: give a share of the episodes"):
        load_dataset("Hopper", quality=30)
    with pytest.raises(ValueError, match="episodes is 0: give a whole number from 1 on"):
        load_adaptation("Hopper", 3, episodes=0)


def test_a_share_may_be_one_of_numpys(tiny_data):
    shares = (0.5, np.float32(0.5))
    plain, numpys = (load_dataset("Hopper", quality=share, progress=False).episode_seeds for share in shares)
    np.testing.assert_array_equal(plain, numpys)


def test_arrays_that_do_not_fit_together_are_refused():
    with pytest.raises(ValueError, match="actions has 6 rows: observations has 7"):
        dataclasses.replace(three_step_episodes(), actions=np.zeros((6, 1), dtype=np.float32))
    with pytest.raises(ValueError, match="episode_seeds has 1 rows: episode_lengths has 2"):
        dataclasses.replace(three_step_episodes(), episode_seeds=np.array([1]))


@pytest.mark.parametrize(("name", "kind"), [("actions", "float64"), ("episode_lengths", "int32")])
def test_arrays_of_another_type_are_refused(name, kind):
    data = three_step_episodes()
    wanted = getattr(data, name).dtype
    with pytest.raises(ValueError, match=f"^{name} is of {kind}: give {wanted}$"):
        dataclasses.replace(data, **{name: getattr(data, name).astype(kind)})


def test_two_processes_make_the_arrays_once(own_data):
    own_data()
    code = "from dynagen_bench.datasets import load_dataset; print(load_dataset('Hopper', 'test').rewards.sum())"
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=dict(os.environ))
        for _ in range(2)
    ]
    outputs = {process.communicate(timeout=120)[0] for process in processes}
    assert len(outputs) == 1
    assert float(outputs.pop()) == pytest.approx(load_dataset("Hopper", "test").rewards.sum(), rel=1e-5)
    assert len(folders()) == 1


def test_normalization_is_of_states_that_were_acted_in():
    normalization = three_step_episodes().normalization()
    acted_in = np.array([[0, 0], [10, -1], [20, -2], [40, -4], [50, -5]], dtype=np.float64)
    np.testing.assert_allclose(normalization.mean, acted_in.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(normalization.std, acted_in.std(axis=0), rtol=1e-6)


def test_an_offline_dataset_needs_no_files():
    assert isinstance(three_step_episodes(), OfflineDataset)
    assert three_step_episodes().num_steps == 5


def test_plain_minari_reads_the_episodes(tiny_data):
    flat = load_dataset("Hopper", "test")
    dataset = minari.load_dataset("dynagen/Hopper-RandDyn/test1-v0")
    episodes = list(dataset.iterate_episodes())
    assert len(episodes) == dataset.total_episodes == 12
    for episode, number in zip(episodes, np.flatnonzero(flat.episode_dynamics == 1), strict=True):
        rows = slice(flat.episode_starts[number], flat.episode_starts[number] + flat.episode_lengths[number])
        np.testing.assert_array_equal(episode.actions, flat.actions[rows])
        np.testing.assert_array_equal(episode.observations[:-1].astype(np.float32), flat.observations[rows])
        assert len(episode.observations) == len(episode.actions) + 1
        ended = episode.terminations | episode.truncations
        assert ended.tolist() == [False] * (len(ended) - 1) + [True]
    sampled = dataset.sample_episodes(3)
    assert {episode.actions.dtype for episode in sampled} == {np.dtype(np.float32)}
