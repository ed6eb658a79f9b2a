"""A download is whole and right, or changes nothing; what was interrupted continues."""

import os
import shutil
import signal
import subprocess
import sys

import minari
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.datasets import commands
from dynagen_bench.datasets.checks import check_dataset
from tests.datasets.test_checks import flip, place_of
from tests.datasets.test_remotes import DOWNLOAD

TRAIN1, TEST3 = (ids.parse_label("Hopper", label) for label in ("train1", "test3"))
BIG = f"{TEST3.dataset_id}/data/main_data.hdf5"
SENT = BIG.removeprefix("dynagen/")


def visible_files():
    """Path → content of what a listing of Minari's root sees."""
    root = dataset_folder("")
    paths = [path for path in root.rglob("*") if path.is_file()]
    shown = [path for path in paths if not any(part.startswith(".") for part in path.relative_to(root).parts)]
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in shown}


def test_what_is_here_is_not_asked_for(remote, publish, download, capsys):
    publish()
    download()
    remote.put(BIG, b"damaged since")
    remote.put(f"{TEST3.dataset_id}/data/metadata.json", b"{}")
    before = visible_files()
    capsys.readouterr()
    download()
    assert visible_files() == before
    assert capsys.readouterr().out.count("official") == 2


def test_damaged_data_here_are_replaced(bucket, publish, download, tiny_records):
    publish()
    download()
    before = visible_files()
    file = dataset_folder(TEST3.dataset_id) / "data" / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:-2000])
    download()
    assert visible_files() == before


def cut(content):
    return content[: len(content) // 2]


def change_a_byte(content):
    """The lowest bit of a reward."""
    return flip(content, place_of(content, "episode_3/rewards")[0], 1)


def empty(content):
    return b""


@pytest.mark.parametrize(
    ("remote", "damage", "here"),
    [
        ("hub", cut, "nothing"),
        ("hub", change_a_byte, "damaged"),
        ("bucket", cut, "damaged"),
        ("bucket", change_a_byte, "nothing"),
        ("bucket", empty, "nothing"),
    ],
    indirect=["remote"],
)
def test_damaged_data_there_are_refused(remote, publish, download, damage, here):
    publish()
    download("train1")
    if here == "damaged":
        folder = dataset_folder(TEST3.dataset_id) / "data"
        folder.mkdir(parents=True)
        (folder / "main_data.hdf5").write_bytes(b"what the user has, good or bad")
    whole = remote.files()[BIG]
    remote.put(BIG, damage(whole))
    before = visible_files()
    with pytest.raises(
        ValueError, match=r"^refused what .* sent, nothing here has changed: .*test3-v0 is damaged \([^\n]*$"
    ):
        download()
    assert visible_files() == before
    assert not list(dataset_folder("dynagen").rglob(".*.download"))

    remote.put(BIG, whole)
    download()
    assert check_dataset(dataset_folder(TEST3.dataset_id), TEST3)


def test_data_without_their_large_file(bucket, publish, download):
    publish("test3")
    bucket.server.bucket("someones-bucket").blob(BIG).delete()
    with pytest.raises(RuntimeError, match=r"gcp://someones-bucket sent .*test3-v0 without main_data.hdf5"):
        download("test3")
    assert not dataset_folder(TEST3.dataset_id).exists()


def test_data_that_are_not_official_are_not_even_sent(hub, publish, download, tiny_records, my_root, tiny_dataset_root):
    publish("test3", unofficial=True)
    metadata = f"{TEST3.dataset_id}/data/metadata.json"
    record = check_dataset(tiny_dataset_root / TEST3.dataset_id, TEST3)
    hub.put(metadata, hub.files()[metadata].replace(record.sha256.encode(), b"0" * 64))
    with pytest.raises(ValueError, match=r"^hf://someone: .*test3-v0 is not the official data: .* sha256 0{12}"):
        download("test3")
    assert hub.server.sent[SENT] == 0


def test_data_that_the_manifest_does_not_have(bucket, publish, download, tmp_path, capsys):
    publish(unofficial=True)
    download(records=tmp_path)
    shown = capsys.readouterr()
    assert shown.out.count("unlisted") == 2
    assert f"checked against what they record alone: {TRAIN1.dataset_id}, {TEST3.dataset_id}" in shown.err
    shutil.rmtree(dataset_folder(TEST3.dataset_id))
    bucket.put(BIG, change_a_byte(bucket.files()[BIG]))
    with pytest.raises(
        ValueError, match=r"refused what .*test3-v0 is damaged \(its episodes have sha256 \w{12}, not \w{12}"
    ):
        download(records=tmp_path)


def test_a_connection_that_is_lost_for_a_moment(hub, publish, download, patient):
    publish()
    hub.server.cut[SENT] = [50_000, 0, 1000]
    download()
    assert hub.server.sent[SENT] == 4, "each time the rest alone was asked for"
    assert check_dataset(dataset_folder(TEST3.dataset_id), TEST3)


def test_a_connection_that_is_lost_for_good(hub, publish, download, patient):
    publish()
    hub.server.cut[SENT] = [0] * 1000
    with pytest.raises(
        RuntimeError, match=r"^cannot download .*test3-v0 at hf://someone \([^\n]* same command again con"
    ):
        download()
    assert list(minari.list_local_datasets()) == [TRAIN1.dataset_id]
    hub.server.cut.clear()
    hub.server.sent.clear()
    download()
    assert set(minari.list_local_datasets()) == {TRAIN1.dataset_id, TEST3.dataset_id}
    fetched = {path for path in hub.server.sent if "/data/" in path}
    assert all(path.startswith("Hopper-RandDyn/test3-v0/") for path in fetched), "train1 was there"


def test_a_download_that_is_killed_continues(hub, publish, tiny_records, tmp_path, monkeypatch):
    publish()
    root = tmp_path / "killed"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    hub.server.held = SENT
    command = [sys.executable, "-c", DOWNLOAD, str(tiny_records), "train1", "test3"]
    process = subprocess.Popen(command, env=dict(os.environ), stderr=subprocess.PIPE, text=True)
    assert hub.server.hold.wait(60), process.stderr.read()
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stderr.close()
    assert list(minari.list_local_datasets()) == [TRAIN1.dataset_id]
    assert not dataset_folder(TEST3.dataset_id).exists()
    hub.server.held = ""
    hub.server.sent.clear()
    done = hub.run(*command[1:], root=root)
    assert done.returncode == 0, done.stderr
    assert check_dataset(dataset_folder(TEST3.dataset_id), TEST3)
    assert not any("train1-v0/data" in path for path in hub.server.sent)
    assert not list(root.rglob(".*.download"))
    assert not list(root.rglob("*.incomplete"))


def test_all_of_a_robot(bucket, download, tiny_records, tiny_dataset_root, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tiny_dataset_root))
        commands.publish(["Hopper"], records=tiny_records)
    commands.download(["Hopper"], records=tiny_records)
    capsys.readouterr()
    commands.verify(["Hopper"], records=tiny_records)
    assert capsys.readouterr().out.count("official") == 25
