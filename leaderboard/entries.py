"""The entries of a board: submissions that passed every check, one folder each.

What is here: what the board accepts, and reading and storing entries. Called by `board`. It must not know tables.

    board/
      LEADERBOARD.md              made from the entries
      entries/
        dadt-zero-shot-last/
          submission.json         as `dynagen_bench.evaluation.submission` writes it
"""

import dataclasses
import hashlib
import os
import re
import shutil
import unicodedata
from pathlib import Path
from typing import Final

from dynagen_bench import ids
from dynagen_bench.evaluation import EPISODES, reset_seeds
from dynagen_bench.evaluation.submission import FILE_NAME, Run, Submission, read_submission, write_submission

FOLDER: Final = "entries"


@dataclasses.dataclass(frozen=True)
class Entry:
    """One submission on a board."""

    slug: str
    """Its folder's name."""
    submission: Submission


def slug_of(submission: Submission) -> str:
    """The folder's name of a submission, `dadt-zero-shot-last`: lower-case ASCII letters, digits and hyphens.

    An agent's name without any such letter is replaced by the start of its hash.
    """
    plain = unicodedata.normalize("NFKD", submission.agent).encode("ascii", "ignore").decode("ascii").lower()
    name = re.sub(r"[^a-z0-9]+", "-", plain)[:80].strip("-")
    name = name or hashlib.sha256(submission.agent.encode("utf-8")).hexdigest()[:12]
    return f"{name}-{submission.track}-{submission.checkpoint}"


def read_official(folder: Path) -> Submission:
    """Read a submission and check that its runs follow the official protocol; fewer robots or runs are allowed.

    Raises:
        FileNotFoundError: there is no submission in `folder`.
        ValueError: one line naming the file and the field.
    """
    submission = read_submission(folder)
    for number, run in enumerate(submission.runs):
        problem = _unofficial(run)
        if problem is not None:
            raise ValueError(f"{folder / FILE_NAME}: runs.{number}.evaluation.{problem}")
    return submission


def _unofficial(run: Run) -> str | None:
    """What is against the protocol in a run's evaluation, None if nothing is."""
    evaluation = run.evaluation
    every = list(range(ids.SPLIT_SIZES["test"]))
    if evaluation.split != "test":
        return f"split: it is {evaluation.split!r}, the board takes 'test'"
    if evaluation.indices != every:
        return f"indices: they are {evaluation.indices}, the board takes all test dynamics, {every}"
    episodes = len(evaluation.returns[0])
    if episodes != EPISODES:
        return f"returns: {episodes} episodes in each dynamics, the board takes {EPISODES}"
    if evaluation.seeds != reset_seeds(run.robot, "test", every).tolist():
        return "seeds: they are not the official reset seeds, evaluate with the default seed"
    return None


def read_entries(board: Path) -> list[Entry]:
    """Read every entry of a board, in order of slugs; what an interrupted submit left behind is passed over.

    Raises:
        FileNotFoundError: there is no such board, or an entry's folder is without its file.
        ValueError: one line naming the entry's file and the field that is wrong.
    """
    if not board.is_dir():
        raise FileNotFoundError(f"{board} is no folder: give the folder of a board, with {FOLDER}/ in it")
    folder = board / FOLDER
    places = sorted(path for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    entries = []
    for place in places:
        if place.name.startswith("."):
            continue
        submission = read_official(place)
        if slug_of(submission) != place.name:
            raise ValueError(
                f"{place / FILE_NAME}: belongs into the folder {slug_of(submission)!r}, not {place.name!r}"
            )
        entries.append(Entry(place.name, submission))
    return entries


def store_entry(board: Path, entry: Entry) -> None:
    """Put an entry into its folder, in place of the one that was there; a kill leaves the old state or the new one."""
    place = board / FOLDER / entry.slug
    if place.is_dir():
        write_submission(place, entry.submission)
        return
    unfinished = place.with_name(f".{entry.slug}.{os.getpid()}.unfinished")
    try:
        write_submission(unfinished, entry.submission)
        os.rename(unfinished, place)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def remove_entry(board: Path, slug: str) -> None:
    """Take an entry off the board; one that is not there is no error."""
    shutil.rmtree(board / FOLDER / slug, ignore_errors=True)
