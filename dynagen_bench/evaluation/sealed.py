"""Reading files of a folder that somebody else has written, and nothing outside it.

What is here: `read_inside`. Called by submissions and the leaderboard. It must not know what is in the files.
"""

import os
import stat
from pathlib import Path


def read_inside(folder: Path, name: str, limit: int) -> bytes:
    """The bytes of the file `name` (with `/` for a folder in between) in `folder`.

    Every part of the name is opened in the one before it and is not followed if it is a link, so that the file lies in
    the folder even if somebody changes the folder meanwhile; pipes and devices are not waited for. `folder` itself may
    be reached by links.

    Args:
        folder: the folder.
        name: of this project's own making, never taken from a file.
        limit: largest size that is read, bytes; of a larger file nothing is read.

    Raises:
        FileNotFoundError: there is no such file; a link, a pipe or a folder is none.
        ValueError: the file is larger than `limit`.
    """
    path = folder / name
    *parents, last = name.split("/")
    opened: list[int] = []
    try:
        opened.append(os.open(folder, os.O_RDONLY | os.O_DIRECTORY))
        for part in parents:
            opened.append(os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=opened[-1]))
        opened.append(os.open(last, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=opened[-1]))
        if not stat.S_ISREG(os.fstat(opened[-1]).st_mode):
            raise FileNotFoundError
        with os.fdopen(opened.pop(), "rb") as file:
            size = os.fstat(file.fileno()).st_size
            content = b"" if size > limit else file.read(limit + 1)
    except PermissionError:
        raise
    except OSError:  # not there, a link (ELOOP), no folder (ENOTDIR), a pipe or a socket (ENXIO)
        raise FileNotFoundError(f"{path} is no file: a link or a pipe is none") from None
    finally:
        for descriptor in opened:
            os.close(descriptor)
    if size > limit or len(content) > limit:
        raise ValueError(f"{path}: larger than {limit} bytes, the most that is read")
    return content
