"""Changing a board: an entry in and the page made anew, both or neither.

What is here: `submit`, `build` and `is_current`. Called by the command line and the demo. It must not know how tables
look.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from leaderboard.entries import Entry, read_entries, read_official, remove_entry, slug_of, store_entry
from leaderboard.markdown import page

BOARD: Final = Path(__file__).parent
"""The project's own board, this folder."""

PAGE: Final = "LEADERBOARD.md"


def submit(folder: Path, board: Path = BOARD, replace: bool = False) -> Entry:
    """Check the submission in `folder`, copy it into the board and make the page anew; returns the entry.

    Everything that can be wrong is found before anything is written, and what fails later is taken back. A kill between
    the last two renames leaves the entry in and the page behind it, which `is_current` sees and `build` mends.

    Args:
        folder: holds `submission.json`; nothing else in it is read or copied.
        board: the board's folder.
        replace: take the place of an entry of the same name.

    Raises:
        FileNotFoundError: there is no submission in `folder`.
        FileExistsError: the board has an entry of this name, and `replace` is not given.
        ValueError: one line naming the file and the field that is wrong.
    """
    submission = read_official(folder)
    entry = Entry(slug_of(submission), submission)
    entries = {other.slug: other for other in read_entries(board)} if board.is_dir() else {}
    previous = entries.get(entry.slug)
    if previous is not None and not replace:
        raise FileExistsError(f"{board} has an entry {entry.slug!r}: give --replace, or another name to the agent")
    entries[entry.slug] = entry
    with _page_aside(board, page([entries[slug] for slug in sorted(entries)])) as unfinished:
        try:
            store_entry(board, entry)
            os.replace(unfinished, board / PAGE)
        except BaseException:  # an interruption too: the board is put back as it was
            if previous is not None:
                store_entry(board, previous)
            else:
                remove_entry(board, entry.slug)
            raise
    return entry


def build(board: Path = BOARD) -> Path:
    """Make the page from the entries and return its path; raises as `read_entries` does, the old page stays then."""
    with _page_aside(board, page(read_entries(board))) as unfinished:
        os.replace(unfinished, board / PAGE)
    return board / PAGE


def is_current(board: Path = BOARD) -> bool:
    """Whether the page is what `build` would write, byte for byte."""
    path = board / PAGE
    return path.is_file() and path.read_bytes() == page(read_entries(board)).encode("utf-8")


@contextlib.contextmanager
def _page_aside(board: Path, text: str) -> Iterator[Path]:
    """The page's text in a file beside it, which is gone afterwards, renamed or not."""
    board.mkdir(parents=True, exist_ok=True)
    unfinished = board / f"{PAGE}.{os.getpid()}.unfinished"
    try:
        unfinished.write_bytes(text.encode("utf-8"))
        yield unfinished
    finally:
        unfinished.unlink(missing_ok=True)
