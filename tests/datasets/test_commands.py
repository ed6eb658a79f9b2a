"""`dynagen data`: all of a robot's datasets, resumable, held against the manifest."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import minari
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.contents import content_hash, dataset_folder, read_episodes, read_record
from dynagen_bench.datasets.commands import build, list_datasets, verify
from dynagen_bench.datasets.manifest import ManifestEntry, add_to_manifest, read_manifest
from dynagen_bench.datasets.scores import reference_scores
from tests.tiny_data import EPISODES_PER_SNAPSHOT, store_random_policies

HOPPERS = list(ids.dynamics_ids("Hopper"))
BUILD = """
import sys
from pathlib import Path
from dynagen_bench.datasets.commands import build
build(["Hopper"], policies_folder=Path(sys.argv[1]), episodes_per_snapshot=int(sys.argv[2]), records=Path(sys.argv[3]))
"""


@pytest.fixture
def rebuild(tiny_policies, tiny_records, tiny_dataset_root):
    """Build Hopper's tiny data in this test's own Minari root, checked against the manifest of `tiny_dataset_root`."""
    return lambda **changes: build(
        ["Hopper"],
        **{
            "policies_folder": tiny_policies,
            "episodes_per_snapshot": EPISODES_PER_SNAPSHOT,
            "records": tiny_records,
            **changes,
        },
    )


def test_all_25_are_made_and_official(rebuild, capsys):
    rebuild()
    assert set(minari.list_local_datasets()) == {name.dataset_id for name in HOPPERS}
    capsys.readouterr()
    list_datasets()
    assert capsys.readouterr().out.count("dynagen/Hopper-RandDyn/t") == 25


def test_a_killed_build_continues_and_ends_with_the_same_hashes(
    tiny_policies, tiny_records, tiny_dataset_root, tmp_path
):
    manifest = read_manifest(tiny_records)
    moments = random.Random(5)
    reached = [0]
    command = [sys.executable, "-c", BUILD, str(tiny_policies), str(EPISODES_PER_SNAPSHOT), str(tiny_records)]
    for _ in range(3):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        wanted = reached[-1] + moments.randint(1, 6)
        while len(finished()) < wanted and process.poll() is None:
            time.sleep(0.005)
        time.sleep(moments.uniform(0, 0.1))  # somewhere in the middle of the next one
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL, process.stderr.read()
        process.stderr.close()
        reached.append(len(finished()))
        for folder in finished():
            dataset_id = folder.relative_to(os.environ["MINARI_DATASETS_PATH"]).as_posix()
            assert content_hash(read_episodes(folder)) == manifest[dataset_id].sha256
            assert dataset_id in minari.list_local_datasets()
    assert sorted(set(reached)) == reached, "each build went on where the last one was"
    kept = {folder: (folder / "data" / "main_data.hdf5").stat().st_mtime_ns for folder in finished()}
    assert 3 <= len(kept) < 25

    ended = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert len(finished()) == 25
    for name in HOPPERS:
        folder = dataset_folder(name.dataset_id)
        assert content_hash(read_episodes(folder)) == manifest[name.dataset_id].sha256
        if folder in kept:
            assert (folder / "data" / "main_data.hdf5").stat().st_mtime_ns == kept[folder]
    leftovers = [path for path in dataset_folder("dynagen").rglob("*.unfinished")]
    assert not leftovers


def finished():
    """Folders of the finished Hopper datasets in Minari's root."""
    folder = dataset_folder("dynagen/Hopper-RandDyn")
    return sorted(path.parent for path in folder.glob("[!.]*/data")) if folder.is_dir() else []


def test_data_that_are_not_official_end_in_one_line(rebuild, tmp_path, tiny_records):
    entry = read_manifest(tiny_records)["dynagen/Hopper-RandDyn/train0-v0"]
    add_to_manifest({"dynagen/Hopper-RandDyn/train0-v0": ManifestEntry("0" * 64, 1, 2, entry.mujoco)}, tmp_path)
    with pytest.raises(
        ValueError, match=r"train0-v0 is not the official data: .* sha256 \w{12}, the manifest 1, 2, 0{12}"
    ):
        rebuild(records=tmp_path)
    add_to_manifest({"dynagen/Hopper-RandDyn/train0-v0": ManifestEntry("0" * 64, 1, 2, "3.3.7")}, tmp_path)
    with pytest.raises(ValueError, match=r"install mujoco==3.3.7 and build again \(it was built with 4.0.0\)"):
        rebuild(records=tmp_path)


def test_policies_of_ones_own_are_built_whatever_the_official_data_are(rebuild, tiny_records, tmp_path, capsys):
    rebuild()
    store_random_policies(tmp_path, HOPPERS, seed=1)
    for _ in range(2):  # and kept
        capsys.readouterr()
        build(["Hopper"], policies_folder=tmp_path, episodes_per_snapshot=EPISODES_PER_SNAPSHOT)
        shown = capsys.readouterr()
        assert (shown.out.count("differs"), shown.out.count("official")) == (25, 0)
        assert f"made from the policies in {tmp_path}, and not held against the manifest" in shown.err
        official = read_manifest(tiny_records)
        found = {name: read_record(dataset_folder(name)).sha256 for name in minari.list_local_datasets()}
        assert len(found) == 25
        assert all(sha256 != official[name].sha256 for name, sha256 in found.items())


def test_policies_of_ones_own_make_no_official_data(tmp_path):
    store_random_policies(tmp_path, HOPPERS)
    with pytest.raises(ValueError, match="has not the package's own policies: their data cannot be the official ones"):
        build(["Hopper"], policies_folder=tmp_path, write_manifest=True)


def test_without_policies_nothing_is_built(rebuild, tmp_path):
    with pytest.raises(FileNotFoundError, match="`dynagen collect Hopper train0`"):
        rebuild(policies_folder=tmp_path)
    assert not minari.list_local_datasets()


def test_unknown_robot():
    with pytest.raises(ValueError, match=r"unknown robot 'hopper'.* did you mean 'Hopper'"):
        build(["hopper"])


def test_maintainers_write_manifest_and_reference_scores(rebuild, tmp_path):
    rebuild(every=2, write_manifest=True, records=tmp_path)
    part = read_manifest(tmp_path)
    assert list(part) == sorted(name.part_id(2) for name in HOPPERS)
    assert not (tmp_path / "reference_scores.json").exists()  # these are of whole data alone

    rebuild(write_manifest=True, records=tmp_path)
    manifest = read_manifest(tmp_path)
    assert set(manifest) == set(part) | {name.dataset_id for name in HOPPERS}
    text = (tmp_path / "manifest.json").read_text()
    assert list(json.loads(text)) == sorted(manifest)
    scores = reference_scores("Hopper", tmp_path / "reference_scores.json")
    assert list(scores) == [name.label for name in HOPPERS]
    returns = [episode.rewards.sum() for episode in minari.load_dataset("dynagen/Hopper-RandDyn/test4-v0")]
    assert scores["test4"] == pytest.approx((min(returns), max(returns), sum(returns) / len(returns)), abs=1e-6)

    # a part that is built now has the reference scores of the whole
    minari.delete_dataset("dynagen/Hopper-RandDyn/test4-every2-v0")
    rebuild(every=2, records=tmp_path)
    metadata = minari.load_dataset("dynagen/Hopper-RandDyn/test4-every2-v0").storage.metadata
    assert (metadata["ref_min_score"], metadata["ref_max_score"]) == (scores["test4"].min, scores["test4"].max)
    assert (tmp_path / "manifest.json").read_text() == text


def test_verify_reads_everything_again(rebuild, tiny_records, capsys):
    rebuild()
    verify(["Hopper"], records=tiny_records)
    assert capsys.readouterr().out.count("official") == 50  # once a build, once here
    for label in ("train3", "test1"):
        file = dataset_folder(ids.parse_label("Hopper", label).dataset_id) / "data" / "main_data.hdf5"
        file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(ValueError, match=r"train3-v0 is damaged .*; .*test1-v0 is damaged"):
        verify(["Hopper"], records=tiny_records)


def test_verify_without_data():
    with pytest.raises(FileNotFoundError, match=r"no data of Hopper-RandDyn-train0 .*dynagen data build Hopper"):
        verify(["Hopper"])


@pytest.mark.parametrize("command", [build, verify])
def test_no_robot_is_refused(command):
    with pytest.raises(ValueError, match=r"^no robot is given: name one or more of Walker, Hopper"):
        command([])


def test_list_of_nothing(capsys):
    list_datasets()
    assert "dynagen data build" in capsys.readouterr().out


def test_a_list_in_a_pipe_is_cut_nowhere(my_root, monkeypatch, tiny_records, capsys):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(my_root))
    monkeypatch.setenv("COLUMNS", "40")
    list_datasets(tiny_records)
    lines = capsys.readouterr().out.splitlines()
    wanted = {(name, "official") for name in minari.list_local_datasets()}
    assert {(words[0], words[-1]) for words in map(str.split, lines) if len(words) == 6} >= wanted


def test_a_damaged_record_is_named_and_hides_none(my_root, monkeypatch, tiny_records, capsys):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(my_root))
    file = dataset_folder(HOPPERS[1].dataset_id) / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    metadata["dynagen"]["returns"]["min"] = "a"
    file.write_text(json.dumps(metadata))
    list_datasets(tiny_records)
    shown = capsys.readouterr()
    assert f"{HOPPERS[1].dataset_id} is none of this benchmark's datasets, or damaged" in shown.err
    assert shown.out.count("official") == 2


def test_a_dataset_of_somebody_elses_hides_none(rebuild, tiny_records, capsys):
    rebuild()
    mine = shutil.copytree(dataset_folder(HOPPERS[0].dataset_id), dataset_folder("dynagen/mine/x-v0"))
    metadata = json.loads((mine / "data" / "metadata.json").read_text())
    del metadata["dynagen"]
    (mine / "data" / "metadata.json").write_text(json.dumps(metadata | {"dataset_id": "dynagen/mine/x-v0"}))
    capsys.readouterr()
    list_datasets(tiny_records)
    shown = capsys.readouterr()
    assert "dynagen/mine/x-v0 is none of this benchmark's datasets, or damaged" in shown.err
    assert HOPPERS[0].dataset_id in shown.out


def test_committed_records_are_of_the_benchmarks_own_datasets():
    known = {name.dataset_id for robot in ids.ROBOTS for name in ids.dynamics_ids(robot)}
    for dataset_id, entry in read_manifest().items():
        assert dataset_id.replace("-every4", "") in known
        assert len(entry.sha256) == 64
    package = Path(sys.modules["dynagen_bench"].__file__).parent
    assert set(json.loads((package / "datasets" / "reference_scores.json").read_text())) <= set(ids.ROBOTS)
