"""Publishing: a tree that any remote can be made of, and uploads that can be stopped and done again."""

import json
import os
import shutil

import minari
import pytest
from huggingface_hub import HfApi

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.collection.minari_files import build_dataset
from dynagen_bench.datasets.checks import check_dataset
from dynagen_bench.datasets.manifest import manifest_file, read_manifest
from dynagen_bench.datasets.remotes import connect
from tests.tiny_data import store_random_policies

TRAIN1, TRAIN10, TEST3 = (ids.parse_label("Hopper", label) for label in ("train1", "train10", "test3"))
NAMESPACE = "dynagen/Hopper-RandDyn"


def files_of(tree):
    return {path.relative_to(tree).as_posix(): path for path in tree.rglob("*") if path.is_file()}


def test_a_tree(publish, tmp_path, my_root, capsys):
    tree = tmp_path / "tree"
    publish("test3", output=tree)
    publish("train10", output=tree)  # beside what is there
    files = files_of(tree)
    assert sorted(files) == [
        "dynagen/Hopper-RandDyn/namespace_metadata.json",
        "dynagen/Hopper-RandDyn/test3-v0/data/main_data.hdf5",
        "dynagen/Hopper-RandDyn/test3-v0/data/metadata.json",
        "dynagen/Hopper-RandDyn/train10-v0/data/main_data.hdf5",
        "dynagen/Hopper-RandDyn/train10-v0/data/metadata.json",
        "dynagen/namespace_metadata.json",
    ]
    assert json.loads(files["dynagen/namespace_metadata.json"].read_text()) == {
        "datasets": [TEST3.dataset_id, TRAIN10.dataset_id],
        "namespaces": [NAMESPACE],
    }
    assert "20 train and 5 test" in files["dynagen/Hopper-RandDyn/namespace_metadata.json"].read_text()
    big = "dynagen/Hopper-RandDyn/test3-v0/data/main_data.hdf5"
    assert os.path.samefile(tree / big, my_root / big), "it takes no space"
    assert f"1 datasets are in {tree}" in capsys.readouterr().err


def test_other_data_in_a_tree_give_way_to_official_ones_alone(publish, tmp_path, tiny_records):
    tree = tmp_path / "tree"
    publish("test3", output=tree)
    listed = json.loads(manifest_file(tiny_records).read_text())
    other = {name: entry | {"sha256": "0" * 64} for name, entry in listed.items()}
    (tmp_path / "records").mkdir()
    manifest_file(tmp_path / "records").write_text(json.dumps(other))
    publish("test3", output=tree, unofficial=True, records=tmp_path / "records")  # the same data
    metadata = tree / TEST3.dataset_id / "data" / "metadata.json"
    changed = metadata.read_text().replace(listed[TEST3.dataset_id]["sha256"], "1" * 64)
    metadata.unlink()  # a link to the root's own file
    metadata.write_text(changed)
    with pytest.raises(ValueError, match=r"test3-v0 is another dataset, sha256 1{12}: only official data replace one"):
        publish("test3", output=tree, unofficial=True, records=tmp_path / "records")
    assert metadata.read_text() == changed
    publish("test3", output=tree)
    assert "1" * 64 not in metadata.read_text()


def test_a_tree_on_another_file_system_is_a_copy(publish, tmp_path, my_root, monkeypatch):
    def no_links(source, target):
        raise OSError("Invalid cross-device link")

    monkeypatch.setattr(os, "link", no_links)
    publish("test3", output=tmp_path / "tree")
    assert check_dataset(tmp_path / "tree" / TEST3.dataset_id, TEST3)


def test_a_tree_is_a_root_of_minaris(publish, tmp_path, monkeypatch):
    publish("test3", output=tmp_path / "tree")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "tree"))
    assert minari.load_dataset(TEST3.dataset_id).total_episodes == 12


def test_a_tree_can_be_copied_to_any_remote(remote, publish, tmp_path, tiny_records):
    tree = tmp_path / "tree"
    publish(output=tree)
    if remote.address.startswith("hf"):
        remote.server.repositories["someone/dynagen"] = {}
        HfApi().upload_folder(repo_id="someone/dynagen", folder_path=tree / "dynagen", repo_type="dataset")
        assert remote.server.commits["someone/dynagen"] == 1
    else:
        for name, path in files_of(tree).items():
            remote.put(name, path.read_bytes())
    minari.download_dataset(TRAIN1.dataset_id)  # Minari's own
    official = read_manifest(tiny_records)[TRAIN1.dataset_id]
    assert check_dataset(dataset_folder(TRAIN1.dataset_id), TRAIN1, official=official)
    assert connect().datasets(NAMESPACE) == {TRAIN1.dataset_id, TEST3.dataset_id}


def test_what_is_there_is_not_sent_again(remote, publish, capsys):
    publish("test3")
    publish()
    assert "1 datasets were sent" in capsys.readouterr().err
    before = remote.files()
    commits = remote.server.commits.copy() if remote.address.startswith("hf") else None
    publish()
    assert f"0 datasets were sent to {remote.address}, 2 were there" in capsys.readouterr().err
    assert remote.files() == before
    assert commits is None or remote.server.commits == commits


def test_an_upload_to_a_bucket_that_was_stopped_between_two_files(bucket, publish, my_root, capsys):
    publish()
    big = f"{TEST3.dataset_id}/data/main_data.hdf5"
    whole = bucket.files()[big]
    for half in (None, b"that of older data"):
        if half is None:
            bucket.server.bucket("someones-bucket").blob(big).delete()
        else:
            bucket.put(big, half)
        publish()
        assert bucket.files()[big] == whole


def test_an_upload_to_the_hub_that_was_stopped_before_it_was_listed(hub, publish, download, patient):
    publish("train1")
    hub.server.refused_uploads = {"namespace_metadata.json"}
    with pytest.raises(RuntimeError, match=r"^cannot upload dynagen/Hopper-RandDyn/test3-v0 at hf://someone \([^\n]*$"):
        publish()
    hub.server.refused_uploads = set()
    with pytest.raises(ValueError, match="test3-v0 is not at hf://someone, which has 1 datasets"):
        download()
    publish()
    download()
    assert set(minari.list_local_datasets()) == {TRAIN1.dataset_id, TEST3.dataset_id}


def test_lists_of_another_remote_are_not_published(hub, publish, my_root):
    """Minari's own download brings the lists of the remote that it was from; they would be wrong in this one."""
    listing = {"description": "ours", "datasets": ["dynagen/Else/where-v0"], "namespaces": ["dynagen/Else"]}
    (my_root / "dynagen" / "namespace_metadata.json").write_text(json.dumps(listing))
    publish("test3")
    assert json.loads(hub.files()["dynagen/namespace_metadata.json"]) == {
        "description": "ours",
        "datasets": [TEST3.dataset_id],
        "namespaces": [NAMESPACE],
    }


@pytest.fixture
def other_data(my_root, tmp_path, monkeypatch):
    """Test3's data by other policies than the official ones, in `my_root`."""
    store_random_policies(tmp_path / "others", [TEST3], seed=1)
    with monkeypatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(my_root))
        return build_dataset(TEST3, policies_folder=tmp_path / "others", episodes_per_snapshot=2)


def test_data_that_are_not_official_are_refused(bucket, publish, other_data, tmp_path):
    for target in ({}, {"output": tmp_path / "tree"}):
        with pytest.raises(ValueError, match="test3-v0 is not the official data"):
            publish(**target)
        with pytest.raises(ValueError, match=r"train1-v0 is not in the manifest: .* with --unofficial"):
            publish(records=tmp_path, **target)
    assert bucket.files() == {}
    assert not (tmp_path / "tree").exists()
    publish(unofficial=True)
    assert connect().record(TEST3.dataset_id).sha256 == other_data.sha256


def test_official_data_replace_others_and_not_the_other_way(
    remote, publish, other_data, download, my_root, tiny_dataset_root, tiny_records
):
    publish("test3", unofficial=True)
    with pytest.raises(ValueError, match=r"\w+://[\w-]+: .*test3-v0 is not the official data"):
        download("test3")
    data = my_root / TEST3.dataset_id / "data"
    others = data.rename(my_root / "others")
    shutil.copytree(tiny_dataset_root / TEST3.dataset_id / "data", data)
    publish("test3")
    official = read_manifest(tiny_records)[TEST3.dataset_id].sha256
    assert connect().record(TEST3.dataset_id).sha256 == official
    shutil.rmtree(data)
    others.rename(data)
    with pytest.raises(
        ValueError, match=rf"has another .*test3-v0, sha256 {official[:12]}: only official data replace"
    ):
        publish("test3", unofficial=True)
    assert connect().record(TEST3.dataset_id).sha256 == official
    download("test3")


def test_damaged_data_are_refused(bucket, publish, my_root):
    file = my_root / TEST3.dataset_id / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(ValueError, match="test3-v0 is damaged"):
        publish(unofficial=True)
    assert bucket.files() == {}


def test_a_damaged_description_of_a_namespace_is_named(publish, my_root, tmp_path):
    (my_root / "dynagen" / "Hopper-RandDyn" / "namespace_metadata.json").write_text("")
    with pytest.raises(ValueError, match=r"namespace_metadata\.json is damaged .*`dynagen data build` mends it"):
        publish(output=tmp_path / "tree", unofficial=True)


def test_a_tree_is_no_file(publish, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"file is no folder: give --output"):
        publish(output=tmp_path / "file", unofficial=True)


def test_missing_data_and_two_targets(bucket, publish, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no data of Hopper-RandDyn-train4 .*dynagen data build Hopper"):
        publish("test3", "train4")
    with pytest.raises(ValueError, match=r"both --output .* and --remote gcp://b are given"):
        publish(output=tmp_path, remote="gcp://b")
    with pytest.raises(ValueError, match="there are no data of the nominal robots"):
        publish("nominal")
    assert bucket.files() == {}
