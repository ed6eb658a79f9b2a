"""A file or folder appears whole or not at all."""

import concurrent.futures
import contextlib
import multiprocessing
import os
import shutil
import signal
import threading
import time

import pytest

from dynagen_bench.whole import check_writable, exclusively, recover, stored_json, update_json, whole_file, whole_folder


def begin_and_stop(folder):
    with whole_folder(folder) as unfinished:
        (unfinished / "a").write_text("2")
        raise KeyboardInterrupt


def write_half(path):
    with whole_file(path) as unfinished:
        unfinished.write_text("half of the sec")
        raise OSError("disk full")


def test_nothing_is_seen_before_the_end_and_the_old_one_after_an_error(tmp_path):
    folder = tmp_path / "deep" / "data"
    with whole_folder(folder) as unfinished:
        (unfinished / "a").write_text("1")
        assert not folder.exists()
        assert unfinished.name.startswith(".")
    assert (folder / "a").read_text() == "1"

    with pytest.raises(KeyboardInterrupt):
        begin_and_stop(folder)
    assert (folder / "a").read_text() == "1"
    assert [path.name for path in folder.parent.iterdir()] == ["data"]


def test_the_new_folder_replaces_the_old_one_and_what_a_killed_process_left(tmp_path):
    folder = tmp_path / "data"
    for leftover in (folder, tmp_path / ".data.unfinished", tmp_path / ".data.replaced"):
        leftover.mkdir()
        (leftover / "old").touch()
    with whole_folder(folder) as unfinished:
        (unfinished / "new").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert [path.name for path in folder.iterdir()] == ["new"]


def test_the_old_folder_comes_back_when_its_maker_died_between_the_two_renames(tmp_path):
    folder = tmp_path / "data"
    for leftover in (".data.replaced", ".data.unfinished"):
        (tmp_path / leftover).mkdir()
    (tmp_path / ".data.replaced" / "old").touch()
    with pytest.raises(KeyboardInterrupt):
        begin_and_stop(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert [path.name for path in folder.iterdir()] == ["old"]


def test_the_old_folder_comes_back_when_the_new_one_cannot_have_its_name(tmp_path, monkeypatch):
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "old").touch()
    replace = os.replace

    def failing(source, target):
        if source.name.endswith(".unfinished"):
            raise OSError("no rename")
        replace(source, target)

    monkeypatch.setattr("os.replace", failing)
    with pytest.raises(OSError, match="no rename"), whole_folder(folder) as unfinished:
        (unfinished / "new").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert [path.name for path in folder.iterdir()] == ["old"]


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("killed", [True, False])
def test_the_old_folder_comes_back_when_what_follows_fails(tmp_path, monkeypatch, there, killed):
    folder = tmp_path / "data"
    if there:
        folder.mkdir()
        (folder / "old").touch()

    def fail():
        assert [path.name for path in folder.iterdir()] == ["new"]
        if killed:  # before anything can be deleted
            monkeypatch.setattr(shutil, "rmtree", lambda *_, **__: None)
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"), whole_folder(folder, then=fail) as unfinished:
        (unfinished / "new").touch()
    monkeypatch.undo()
    recover(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == (["data", "data/old"] if there else [])


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def make_and_die(folder):
    with whole_folder(folder, then=die) as unfinished:
        (unfinished / "new").touch()


def test_after_a_kill_in_what_follows_the_folder_is_the_new_one(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "old").touch()
    child = multiprocessing.get_context("fork").Process(target=make_and_die, args=(tmp_path / "data",))
    child.start()
    child.join(10)
    assert child.exitcode == -signal.SIGKILL
    recover(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["data", "data/new"]


def test_what_killed_processes_left_of_every_folder_is_put_right(tmp_path):
    for name in ("one", ".one.replaced", ".two.replaced", ".two.7.unfinished", ".three.7.unfinished"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "from").write_text(name)
    recover(tmp_path, "t*")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".one.replaced", "one", "two"]
    recover(tmp_path)
    assert {path.name: (path / "from").read_text() for path in tmp_path.iterdir()} == {
        "one": "one",
        "two": ".two.replaced",
    }


def test_another_s_folder_is_left_alone_by_one_whose_own_was_removed(tmp_path):
    folder = tmp_path / "data"

    def robbed():
        with whole_folder(folder) as unfinished:
            unfinished.rmdir()
            folder.mkdir()
            (folder / "theirs").touch()

    with pytest.raises(FileNotFoundError):
        robbed()
    assert [path.name for path in folder.iterdir()] == ["theirs"]


def test_two_that_a_removed_lock_no_longer_parts_take_nothing_of_each_other(tmp_path):
    folder = tmp_path / "cache" / "data"
    pipe, theirs = multiprocessing.Pipe()

    def slowly():
        with exclusively(folder), contextlib.suppress(FileNotFoundError), whole_folder(folder) as unfinished:
            (unfinished / "first half").touch()
            theirs.send("begun")
            theirs.recv()
            (unfinished / "second half").touch()

    child = multiprocessing.get_context("fork").Process(target=slowly)
    child.start()
    assert pipe.recv() == "begun"
    shutil.rmtree(tmp_path / "cache")  # as a user empties a cache
    with exclusively(folder), whole_folder(folder) as unfinished:
        for half in ("first half", "second half"):
            (unfinished / half).touch()
            pipe.send("go on")
            child.join(10)
    assert sorted(path.name for path in folder.iterdir()) == ["first half", "second half"]


def test_who_waits_for_a_lock_that_is_removed_takes_the_new_one(tmp_path):
    folder, inside = tmp_path / "data", []

    def enter():
        with exclusively(folder):
            inside.append(len(inside))

    with exclusively(folder):
        waiting = threading.Thread(target=enter)
        waiting.start()
        time.sleep(0.2)
        (tmp_path / ".data.lock").unlink()
        (tmp_path / ".data.lock").touch()
        assert inside == []
    waiting.join(10)
    assert inside == [0]


def test_only_one_makes_a_folder_at_a_time(tmp_path):
    folder = tmp_path / "data"
    made = []

    def make(who):
        with exclusively(folder):
            if not folder.exists():
                with whole_folder(folder) as unfinished:
                    (unfinished / who).touch()
                    made.append(who)

    threads = [threading.Thread(target=make, args=(f"{i}",)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
    assert [path.name for path in folder.iterdir()] == made


def test_a_file_is_the_old_one_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "new" / "file.txt"
    with whole_file(path) as unfinished:
        unfinished.write_text("first")
        assert not path.exists()
    with pytest.raises(OSError, match="disk full"):
        write_half(path)
    assert path.read_text() == "first"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_file_is_for_those_whom_the_users_umask_lets_in(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        with whole_file(tmp_path / "file") as unfinished:
            unfinished.touch()
            unfinished.chmod(0o600)  # as safetensors leaves it
    finally:
        os.umask(before)
    assert (tmp_path / "file").stat().st_mode & 0o777 == mode


def test_two_threads_that_write_one_file_take_nothing_of_each_other(tmp_path):
    both = threading.Barrier(2)

    def write(word):
        with whole_file(tmp_path / "file") as unfinished:
            both.wait(10)
            unfinished.write_text(word)
            both.wait(10)
            return unfinished.read_text()

    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        assert list(threads.map(write, ("one", "two"))) == ["one", "two"]
    assert (tmp_path / "file").read_text() in ("one", "two")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_is_no_file_is_not_replaced_by_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # as /dev/null, which only root could replace
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", tmp_path / "link"):
        with pytest.raises(
            ValueError, match=f"^{path} is no file and cannot be written as one: give the path of a new"
        ):
            write_half(path)
    assert (tmp_path / "pipe").is_fifo()


def test_whether_a_file_can_be_written_is_seen_without_making_anything(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "new", tmp_path / "deep" / "folder" / "new"):
        check_writable(path)
    with pytest.raises(ValueError, match=f"^{tmp_path} is no file and cannot be written as one"):
        check_writable(tmp_path)
    with pytest.raises(OSError, match=f"^{tmp_path}/file/new cannot be written: {tmp_path}/file is no folder that you"):
        check_writable(tmp_path / "file" / "new")
    monkeypatch.setattr(os, "access", lambda *_: False)  # as in another one's folder; root may write to all
    with pytest.raises(OSError, match=f"^{tmp_path}/deep/new cannot be written: {tmp_path} is no folder that you may"):
        check_writable(tmp_path / "deep" / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("there", [True, False])
def test_the_file_that_a_link_names_is_written(tmp_path, there):
    target, link = tmp_path / "target", tmp_path / "elsewhere" / "link"
    link.parent.mkdir()
    link.symlink_to(target)
    if there:
        target.touch()
    with whole_file(link) as unfinished:
        unfinished.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_entries_join_a_json_file_sorted_and_what_is_no_object_is_left_alone(tmp_path):
    file = tmp_path / "deep" / "scores.json"
    assert stored_json(file) == {}
    for entries in ({"b": 1, "c": 2}, {"a": 0, "c": [3]}):
        update_json(file, entries)
    assert list(stored_json(file).items()) == [("a", 0), ("b", 1), ("c", [3])]
    for text, error in (("[]", TypeError), ("{", ValueError)):
        file.write_text(text)
        with pytest.raises(error):
            update_json(file, {"a": 1})
        assert file.read_text() == text
