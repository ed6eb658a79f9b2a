"""Whatever is wrong with a dataset is found, and said in one line."""

import io
import json
import random
import re
import shutil

import h5py
import numpy as np
import pytest
from minari.dataset.minari_storage import MinariStorage

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.datasets import commands
from dynagen_bench.datasets.checks import check_dataset, check_mujoco
from dynagen_bench.datasets.manifest import ManifestEntry, read_manifest

NAME = ids.parse_label("Hopper", "test3")
ARRAYS = ("observations", "actions", "rewards", "terminations", "truncations")


@pytest.fixture
def folder(tmp_path, tiny_dataset_root):
    """A copy of one tiny dataset, to be damaged."""
    return shutil.copytree(tiny_dataset_root / NAME.dataset_id, tmp_path / "dataset")


def place_of(content, array):
    """Where the first chunk of an array begins in an HDF5 file, and the bytes of the array in it."""
    with h5py.File(io.BytesIO(content), "r") as file:
        chunk = file[array].id.get_chunk_info(0)
        rows = min(file[array].chunks[0], len(file[array]))
        return chunk.byte_offset, rows * int(file[array][:1].nbytes)


def flip(content, place, bit):
    return content[:place] + bytes([content[place] ^ bit]) + content[place + 1 :]


def as_minari_reads_it(folder):
    """All that Minari gives of a dataset, as one text."""
    storage = MinariStorage.read(folder / "data")
    numbers = range(storage.total_episodes)
    episodes = [
        {field: value.tobytes() if isinstance(value, np.ndarray) else value for field, value in episode.items()}
        for episode in storage.get_episodes(numbers)
    ]
    return repr([sorted(episode.items()) for episode in episodes]) + repr(list(storage.get_episode_metadata(numbers)))


def test_a_dataset_that_is_right(folder, tiny_records):
    official = read_manifest(tiny_records)[NAME.dataset_id]
    assert ManifestEntry.of(check_dataset(folder, NAME, official=official)) == official


@pytest.mark.parametrize("array", ARRAYS)
def test_every_byte_of_every_array_counts(folder, array):
    file = folder / "data" / "main_data.hdf5"
    whole = file.read_bytes()
    random_places = random.Random(array)
    for _ in range(3):
        episode = random_places.randrange(8)
        first, size = place_of(whole, f"episode_{episode}/{array}")
        place = first + random_places.randrange(size)
        file.write_bytes(flip(whole, place, 1 << random_places.randrange(8)))
        with pytest.raises(ValueError, match=r"^dynagen/Hopper-RandDyn/test3-v0 is damaged \([^\n]+$"):
            check_dataset(folder, NAME)


def test_a_byte_anywhere_is_found_or_is_one_that_nobody_reads(folder):
    file = folder / "data" / "main_data.hdf5"
    whole = file.read_bytes()
    before = as_minari_reads_it(folder)
    used = np.flatnonzero(np.frombuffer(whole, dtype=np.uint8))  # most of a small HDF5 file is empty
    places = random.Random(0)
    found = 0
    for _ in range(60):
        file.write_bytes(flip(whole, int(places.choice(used)), 1 << places.randrange(8)))
        said = None
        try:
            check_dataset(folder, NAME)
        except ValueError as error:
            said = str(error)
        found += said is not None
        if said is None:
            assert as_minari_reads_it(folder) == before
        else:
            assert re.fullmatch(r"dynagen/Hopper-RandDyn/test3-v0 is damaged \(.+\)", said)
    assert found > 30


def lose_an_episode(file):
    del file["episode_3"]


def add_an_episode(file):
    file.copy("episode_3", "episode_12")


def lose_an_array(file):
    del file["episode_3"]["rewards"]


def exchange_two_episodes(file):
    file.move("episode_3", "other")
    file.move("episode_4", "episode_3")
    file.move("other", "episode_4")


def change_the_seed(file):
    file["episode_3"].attrs["seed"] += 1


def change_the_snapshot(file):
    file["episode_3"].attrs["snapshot"] = 100


@pytest.mark.parametrize(
    ("field", "value"), [("entry_point", "payload:make"), ("max_episode_steps", 1000), ("order_enforce", False)]
)
@pytest.mark.parametrize("spec", ["env_spec", "eval_env_spec"])
def test_an_environment_that_another_one_would_be_made_from(folder, spec, field, value):
    file = folder / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    metadata[spec] = json.dumps(json.loads(metadata[spec]) | {field: value})
    file.write_text(json.dumps(metadata))
    with pytest.raises(ValueError, match="its environment is not Hopper-RandDyn-test3"):
        check_dataset(folder, NAME)


def change_the_policy(file):
    file["episode_3"].attrs["policy_sha256"] = "0" * 64


def change_the_dynamics(file):
    file["episode_3"].attrs["dynamics"] = "Hopper-RandDyn-train3"


def change_the_number(file):
    file["episode_3"].attrs["id"] = 4


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lose_an_episode, "1 of its 12 episodes are missing, the first is episode_3"),
        (add_an_episode, "it has episode_12 beside its 12 episodes"),
        (lose_an_array, r"it cannot be read, KeyError: .*rewards"),
        (exchange_two_episodes, r"its episodes have sha256 \w{12}, not \w{12}, which it records"),
        (change_the_seed, "its episodes have sha256"),
        (change_the_snapshot, "its episodes have sha256"),
        (change_the_policy, "its episodes have sha256"),
        (change_the_dynamics, "flags or metadata of episode_3 do not fit its steps"),
        (change_the_number, "flags or metadata of episode_3 do not fit its steps"),
    ],
)
def test_damaged_episodes(folder, damage, message):
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        damage(file)
    with pytest.raises(ValueError, match=rf"^dynagen/Hopper-RandDyn/test3-v0 is damaged \({message}"):
        check_dataset(folder, NAME)


def edit(folder, *path, value):
    """Change one field of the metadata."""
    file = folder / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    place = metadata
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    file.write_text(json.dumps(metadata))


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["dataset_id"], "dynagen/Hopper-RandDyn/test2-v0", "its metadata say dataset_id .*test2-v0', not .*test3-v0'"),
        (["total_episodes"], 7, "its metadata say total_episodes 7, not 12"),
        (["total_steps"], 1, r"its metadata say total_steps 1, not \d+"),
        (["data_format"], "arrow", "it cannot be read|its metadata say"),
        (["env_spec"], '{"id": "Hopper-v5", "kwargs": {}}', "its environment is not Hopper-RandDyn-test3|it cannot be"),
        (["env_spec"], "{", r"it cannot be read, JSONDecodeError"),
        (["dynagen", "recipe", "dynamics"], "Hopper-RandDyn-test2", "its metadata say dynamics 'Hopper-RandDyn-test2'"),
        (["dynagen", "recipe", "every"], 2, "its metadata say every 2, not 1"),
        (["dynagen", "recipe", "policies", "200"], "0" * 64, "flags or metadata of episode_3 do not fit"),
        (["dynagen", "sha256"], "0" * 64, r"its episodes have sha256 \w{12}, not 0{12}"),
        (["dynagen", "returns", "max"], 1000.0, "its returns or number of steps are not those that it records"),
        (["ref_max_score"], 1e6, "its reference scores are not the lowest and the highest of its returns"),
    ],
)
def test_damaged_metadata(folder, path, value, message):
    edit(folder, *path, value=value)
    with pytest.raises(ValueError, match=rf"^dynagen/Hopper-RandDyn/test3-v0 is damaged \(({message})"):
        check_dataset(folder, NAME)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dataset_id", "dynagen/Hopper-RandDyn/test2-v0"),
        ("total_episodes", 7),
        ("total_steps", 1),
        ("data_format", "arrow"),
        ("env_spec", '{"entry_point": "payload:make"}'),
        ("eval_env_spec", '{"entry_point": "payload:make"}'),
    ],
)
def test_a_recipe_does_not_answer_for_minaris_fields(folder, field, value):
    right = json.loads((folder / "data" / "metadata.json").read_text())[field]
    edit(folder, field, value=value)
    edit(folder, "dynagen", "recipe", field, value=right)
    with pytest.raises(ValueError, match=r"^dynagen/Hopper-RandDyn/test3-v0 is damaged"):
        check_dataset(folder, NAME)


def test_spaces_of_another_robot(folder):
    file = folder / "data" / "metadata.json"
    edit(folder, "action_space", value=json.loads(file.read_text())["observation_space"])
    with pytest.raises(ValueError, match="its spaces are not those of Hopper-RandDyn-test3"):
        check_dataset(folder, NAME)


def test_texts_may_change(folder):
    edit(folder, "description", value="My copy.")
    assert check_dataset(folder, NAME).episodes == 12


def test_another_mujoco(folder, tiny_records):
    official = read_manifest(tiny_records)[NAME.dataset_id]
    edit(folder, "dynagen", "recipe", "mujoco", value="3.3.7")
    record = check_dataset(folder, NAME)
    with pytest.raises(ValueError, match=r"test3-v0 records MuJoCo 3.3.7, the manifest 4.0.0, for the same episodes"):
        check_dataset(folder, NAME, official=official)
    with pytest.raises(ValueError, match=r"test3-v0 was made with MuJoCo 3.3.7, here is 4.0.0: install mujoco==3.3.7"):
        check_mujoco(NAME.dataset_id, record)


def test_no_dataset(tmp_path):
    with pytest.raises(FileNotFoundError, match="no dataset at"):
        check_dataset(tmp_path, NAME)


def test_verify_names_everything_that_is_wrong(tiny_dataset_root, tiny_records, tmp_path, monkeypatch, capsys):
    shutil.copytree(tiny_dataset_root, tmp_path / "root")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "root"))
    changed, shorter, older = (
        dataset_folder(f"dynagen/Hopper-RandDyn/{label}-v0") for label in ("train1", "train2", "test0")
    )
    file = changed / "data" / "main_data.hdf5"
    file.write_bytes(flip(file.read_bytes(), place_of(file.read_bytes(), "episode_5/observations")[0], 1))
    with h5py.File(shorter / "data" / "main_data.hdf5", "a") as file:
        lose_an_episode(file)
    edit(older, "dynagen", "recipe", "mujoco", value="3.3.7")
    with pytest.raises(ValueError, match="train1-v0 is damaged") as error:
        commands.verify(["Hopper"], records=tiny_records)
    for part in (
        r"train1-v0 is damaged \(its episodes have sha256 \w{12}, not \w{12}, which it records\); ",
        r"train2-v0 is damaged \(1 of its 12 episodes are missing, the first is episode_3\); ",
        r"test0-v0 was made with MuJoCo 3.3.7, here is 4.0.0: install mujoco==3.3.7, or build the data again",
    ):
        assert re.search(part, str(error.value))
    assert str(error.value).count("dynagen/") == 3
    assert "\n" not in str(error.value)
