"""Reading inside a folder, and nowhere else."""

import os

import pytest

from dynagen_bench.evaluation.sealed import read_inside


@pytest.fixture
def folder(tmp_path):
    """A folder with a file in a folder, beside a secret."""
    (tmp_path / "mine" / "sub").mkdir(parents=True)
    (tmp_path / "mine" / "sub" / "file").write_bytes(b"content")
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "file").write_bytes(b"secret")
    return tmp_path / "mine"


def test_a_file_is_read_up_to_its_limit(folder):
    assert read_inside(folder, "sub/file", 7) == b"content"
    with pytest.raises(ValueError, match="sub/file: larger than 6 bytes, the most that is read"):
        read_inside(folder, "sub/file", 6)


def test_the_folder_itself_may_be_a_link(folder, tmp_path):
    (tmp_path / "link").symlink_to(folder)
    assert read_inside(tmp_path / "link", "sub/file", 100) == b"content"


@pytest.mark.parametrize("kind", ["file link", "folder link", "fifo", "folder", "missing", "no folder"])
def test_what_is_no_file_of_the_folder_is_not_opened(folder, kind):
    file = folder / "sub" / "file"
    if kind == "folder link":
        file.unlink()
        file.parent.rmdir()
        file.parent.symlink_to(folder.parent / "secret")
    elif kind == "no folder":
        folder = file
    else:
        file.unlink()
        if kind == "file link":
            file.symlink_to(folder.parent / "secret" / "file")
        elif kind == "fifo":
            os.mkfifo(file)
        elif kind == "folder":
            file.mkdir()
    with pytest.raises(FileNotFoundError, match="sub/file is no file: a link or a pipe is none"):
        read_inside(folder, "sub/file", 100)


def test_nothing_of_a_huge_file_is_read_and_no_descriptor_is_left(folder):
    with (folder / "sub" / "file").open("wb") as file:
        file.truncate(10**13)  # sparse: takes no room
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with pytest.raises(ValueError, match="larger than 1000 bytes"):
            read_inside(folder, "sub/file", 1000)
    assert len(os.listdir("/proc/self/fd")) == before
