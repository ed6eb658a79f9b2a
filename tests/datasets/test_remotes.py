"""Remotes of Minari's: unmodified Minari and ours against the same servers, in both directions; errors of one line."""

import shutil
import sys

import minari
import pytest
from minari import namespace

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.datasets.checks import check_dataset
from dynagen_bench.datasets.commands import download as download_command
from dynagen_bench.datasets.manifest import read_manifest
from dynagen_bench.datasets.remotes import connect, namespace_of, own_metadata

TRAIN1, TRAIN10, TEST3 = (ids.parse_label("Hopper", label) for label in ("train1", "train10", "test3"))
DOWNLOAD = """
import sys
from pathlib import Path
from dynagen_bench.datasets.commands import download
download(["Hopper"], sys.argv[2:], records=Path(sys.argv[1]))
"""


def test_what_minari_uploads_we_download(remote, my_root, tiny_records, tmp_path):
    uploaded = remote.run(
        "-m", "minari.cli", "upload", "--key-path", remote.key, TRAIN1.dataset_id, TRAIN10.dataset_id, root=my_root
    )
    assert uploaded.returncode == 0, uploaded.stderr
    listed = remote.run("-m", "minari.cli", "list", "remote", root=tmp_path / "nothing")
    assert TRAIN1.dataset_id in listed.stdout
    assert TRAIN10.dataset_id in listed.stdout

    ours = remote.run("-c", DOWNLOAD, str(tiny_records), "train1", root=tmp_path / "ours")
    assert ours.returncode == 0, ours.stderr
    assert ours.stdout.count("official") == 1
    assert "Downloading" not in ours.stdout, "Minari's own lines would break the bars"
    folder = tmp_path / "ours" / "dynagen" / "Hopper-RandDyn"
    assert sorted(path.name for path in folder.glob("[!.]*")) == ["namespace_metadata.json", "train1-v0"]
    assert not list(folder.glob(".*.download"))
    local = remote.run("-W", "error", "-m", "minari.cli", "list", "local", root=tmp_path / "ours")
    assert TRAIN1.dataset_id in local.stdout
    assert TRAIN10.dataset_id not in local.stdout


def test_what_we_publish_minari_downloads(remote, publish, tiny_records, tmp_path):
    publish("train1", "train10")
    theirs = tmp_path / "theirs"
    listed = remote.run("-m", "minari.cli", "list", "remote", "--prefix", "dynagen", root=theirs)
    assert TRAIN10.dataset_id in listed.stdout, listed.stderr
    done = remote.run("-m", "minari.cli", "download", TRAIN1.dataset_id, root=theirs, answer="y\n")
    assert done.returncode == 0, done.stderr
    official = read_manifest(tiny_records)[TRAIN1.dataset_id]
    assert check_dataset(theirs / TRAIN1.dataset_id, TRAIN1, official=official).sha256 == official.sha256
    assert not (theirs / TRAIN10.dataset_id).exists()


def test_namespaces_are_minaris_own_after_a_download(remote, publish, download, my_root):
    publish()
    download()
    assert namespace.list_local_namespaces() == ["dynagen", "dynagen/Hopper-RandDyn"]
    description = namespace.get_namespace_metadata("dynagen/Hopper-RandDyn")["description"]
    assert description == "Hopper: logged data of 20 train and 5 test dynamics."
    assert namespace.get_namespace_metadata("dynagen") == {}, "what one remote lists is not true here"
    assert minari.load_dataset(TEST3.dataset_id).total_episodes == 12


@pytest.mark.parametrize("address", ["someone/dynagen", "s3://bucket", "hf://", "hf://someone/dynagen", "gcp://a b"])
def test_an_address_is_of_one_form(address):
    with pytest.raises(ValueError, match=r"cannot read the remote .* write it as hf://NAME or gcp://BUCKET"):
        connect(address)


def test_no_address(monkeypatch):
    monkeypatch.delenv("MINARI_REMOTE", raising=False)
    with pytest.raises(
        ValueError, match="no remote given: use --remote hf://NAME or gcp://BUCKET, or set MINARI_REMOTE"
    ):
        download_command(["Hopper"])


@pytest.mark.parametrize(
    ("address", "library"), [("hf://someone", "huggingface_hub"), ("gcp://b", "google.cloud.storage")]
)
def test_without_the_extra(address, library, monkeypatch):
    for module in ("minari.storage.remotes.huggingface", "minari.storage.remotes.gcp"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(RuntimeError, match=r"^\w+://\w+ needs .*: pip install 'dynagen-bench\[remotes\]'$"):
        connect(address)


def test_credentials_that_are_none(monkeypatch, tmp_path):
    monkeypatch.setenv("GOOGLE_APPLICATION_CREDENTIALS", str(tmp_path / "missing.json"))
    with pytest.raises(ValueError, match=r"cannot use GOOGLE_APPLICATION_CREDENTIALS=.*missing.json: .*No such file"):
        connect("gcp://bucket")


def test_credentials_of_a_service_account(bucket, publish, monkeypatch):
    monkeypatch.setenv("GOOGLE_APPLICATION_CREDENTIALS", bucket.key)
    publish("test3")
    assert connect().datasets(namespace_of(TEST3.dataset_id)) == {TEST3.dataset_id}


def test_an_empty_remote(hub, download):
    with pytest.raises(
        ValueError, match=r"train1-v0 is not at hf://someone, which has 0 datasets in dynagen/Hopper-Ran"
    ):
        download()
    assert not dataset_folder(TRAIN1.dataset_id).exists()


def test_a_bucket_that_is_none(bucket, download):
    with pytest.raises(RuntimeError, match=r"^cannot list dynagen/Hopper-RandDyn at gcp://another \(NotFound: [^\n]*$"):
        download(remote="gcp://another")


def test_a_server_that_is_none(hub, download, patient):
    hub.server.shutdown()
    hub.server.server_close()
    with pytest.raises(
        RuntimeError, match=r"^cannot list .* at hf://someone \(Connect[^\n]* the same command again con"
    ):
        download()


def test_metadata_that_are_not_ours(remote, publish, download):
    publish("test3")
    remote.put(f"{TEST3.dataset_id}/data/metadata.json", b'{"minari_version": "0.5.3", "dataset_id": "another"}')
    with pytest.raises(ValueError, match=r"test3-v0 at \w+://[\w-]+ is no dataset of this benchmark"):
        download("test3")
    remote.put(f"{TEST3.dataset_id}/data/metadata.json", b"{")
    with pytest.raises(
        RuntimeError, match=r"^cannot read the metadata of .*test3-v0 at \w+://[\w-]+ \(JSONDecodeError"
    ):
        download("test3")


def test_names():
    assert namespace_of(TEST3.part_id(4)) == "dynagen/Hopper-RandDyn"
    assert own_metadata({"description": "d", "datasets": ["a"], "namespaces": []}) == {"description": "d"}


def test_the_whole_listing_is_not_taken_for_one_dataset(remote, publish, download, my_root, tmp_path):
    """A bucket lists by the beginning of a name: `train1` must not bring `train10`."""
    publish("train1", "train10")
    shutil.rmtree(my_root)
    download("train1")
    assert list(minari.list_local_datasets()) == [TRAIN1.dataset_id]
    download("train10")
    assert set(minari.list_local_datasets()) == {TRAIN1.dataset_id, TRAIN10.dataset_id}
