"""Files and folders that appear whole or not at all, whenever a process is killed.

What is here: the right to make a folder, making it, and putting right what a kill has left; making a file; adding to a
file of JSON. Called by everything that writes. It must not know what is in them.

Beside a folder `name` there may be, hidden so that no listing of datasets sees them:

    .name.lock            held (flock) by the process that makes or checks it; the kernel lets go when that process dies
    .name.PID.unfinished  what process PID is writing; thrown away by whoever makes the folder next
    .name.replaced        the one before, for a moment; put back by whoever makes the folder next if `name` is not there
"""

import contextlib
import fcntl
import glob
import json
import os
import shutil
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any


def check_writable(path: Path) -> None:
    """See that a file can be written at `path`; makes nothing. For who works long before there is something to write.

    Raises:
        ValueError: there is something at `path` that is no file, a folder or a device.
        OSError: the nearest folder on the way to it takes no files, or is none.
    """
    if path.exists() and not path.is_file():
        raise ValueError(f"{path} is no file and cannot be written as one: give the path of a new file or an old one")
    folder = next(folder for folder in path.resolve().parents if folder.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(f"{path} cannot be written: {folder} is no folder that you may write to, give a path elsewhere")


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a place beside `path` to write to; when the block ends well, it becomes `path`.

    After an error (a full disk) nothing is left, and `path` is what it was. A kill leaves `name.PID.THREAD.unfinished`
    behind, which nothing reads. A link stays one: the file that it names is replaced.

    Raises:
        ValueError, OSError: as `check_writable`; what is there is left alone.
    """
    check_writable(path)
    path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    # a name of this thread's own: two that write one file do not take each other's
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}.unfinished")
    try:
        unfinished.touch()
        mode = stat.S_IMODE(unfinished.stat().st_mode)  # what the user's umask leaves
        yield unfinished
        unfinished.chmod(mode)  # some writers keep a file to its owner
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, text in UTF-8, as `whole_file` does; raises as it."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextlib.contextmanager
def exclusively(folder: Path) -> Iterator[None]:
    """Be the only process that makes or checks `folder` (or a file); waits until no other one does."""
    lock = folder.parent / f".{folder.name}.lock"
    while True:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with lock.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if _is_at(lock, os.fstat(file.fileno())):  # else it was removed while this process waited: nobody's lock
                yield
                return


@contextlib.contextmanager
def whole_folder(folder: Path, then: Callable[[], None] = lambda: None) -> Iterator[Path]:
    """Yield an empty folder to fill; when the block ends well it becomes `folder`, in place of the one there was.

    The caller holds `exclusively(folder)`, or one lock for all folders beside it. After an error nothing is left, and
    `folder` is what it was.

    Args:
        folder: the one to make.
        then: what is made from it, elsewhere: called when `folder` is the new one. After an error there, too, `folder`
            is what it was; after a kill there it is the new one.
    """
    recover(folder.parent, glob.escape(folder.name))
    # a name of this process's own: where somebody has removed the lock, two may be here, and neither takes the other's
    unfinished = folder.with_name(f".{folder.name}.{os.getpid()}.unfinished")
    replaced = folder.with_name(f".{folder.name}.replaced")
    unfinished.mkdir(parents=True)
    made = os.open(unfinished, os.O_RDONLY)  # held, so that no other folder gets its number if somebody removes it
    try:
        yield unfinished
        if folder.exists():
            os.replace(folder, replaced)
        os.replace(unfinished, folder)
        then()
    except BaseException:  # an interruption too
        if _is_at(folder, os.fstat(made)):
            os.replace(folder, unfinished)  # away in one step: half of it would look whole after a kill
        _put_back(replaced, folder)
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    finally:
        os.close(made)
    shutil.rmtree(replaced, ignore_errors=True)


def recover(parent: Path, names: str = "*") -> None:
    """Finish or take back what killed processes have left of folders in `parent`; the caller holds their lock.

    Args:
        parent: the folder that they are in.
        names: which of them, as a pattern of `glob`.
    """
    for replaced in sorted(parent.glob(f".{names}.replaced")):
        _put_back(replaced, parent / replaced.name.removeprefix(".").removesuffix(".replaced"))
    for leftover in [*parent.glob(f".{names}.replaced"), *parent.glob(f".{names}.*unfinished")]:
        shutil.rmtree(leftover, ignore_errors=True)


def stored_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file, empty where there is no file.

    Raises:
        ValueError: the file holds no JSON.
        TypeError: it holds another value than an object.
    """
    if not path.is_file():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise TypeError("not a JSON object")
    return content


def update_json(path: Path, entries: Mapping[str, Any]) -> None:
    """Put entries into a JSON object in a file, sorted by key: the file is the old one or the new one at any moment.

    Raises:
        ValueError, TypeError: as `stored_json`; the file is left alone.
    """
    with exclusively(path):  # what another process adds meanwhile would be lost
        text = json.dumps(dict(sorted({**stored_json(path), **entries}.items())), indent=1) + "\n"
        write_whole(path, text)


def _is_at(path: Path, file: os.stat_result) -> bool:
    """Whether a path still names this file."""
    try:
        return os.path.samestat(path.stat(), file)
    except FileNotFoundError:
        return False


def _put_back(replaced: Path, folder: Path) -> None:
    """Undo the first of the two renames where the second one has not been: else nothing would be there."""
    if replaced.exists() and not folder.exists():
        os.replace(replaced, folder)
