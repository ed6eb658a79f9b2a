"""The entries of a board: submissions that passed every check, one folder each.

What is here: what the board accepts, and reading and storing entries. Called by everything of the leaderboard, and by
the reference results. It must not know tables, nor how a submission is verified.

    board/
      LEADERBOARD.md              made from the entries
      entries/
        dadt-zero-shot-last/
          submission.json         as `dynagen_bench.evaluation.submission` writes it, with the replay's returns
          traces/                 the traces it names
          verification.json       what the board found; not there if there is nothing to replay
"""

import dataclasses
import functools
import hashlib
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, get_args

import pydantic

from dynagen_bench import ids
from dynagen_bench.evaluation import EPISODES, reset_seeds
from dynagen_bench.evaluation.result import STRICT, first_error
from dynagen_bench.evaluation.sealed import read_inside
from dynagen_bench.evaluation.submission import (
    FILE_NAME,
    Run,
    Sha256,
    Submission,
    read_submission,
    submission_text,
    trace_content,
)
from dynagen_bench.whole import write_whole

FOLDER: Final = "entries"
VERDICT: Final = "verification.json"

Label = Literal["self-reported", "replayed (tolerance)", "replayed", "re-run"]
"""What is known of an entry's returns, from the least to the most: they were sent in; its actions give them, but for
rounding; its actions give them exactly; maintainers have run the policy itself, and it did the same."""

LABELS: Final[tuple[Label, ...]] = get_args(Label)


@dataclasses.dataclass(frozen=True)
class Entry:
    """One submission on a board."""

    slug: str
    """Its folder's name."""
    submission: Submission
    label: Label = "self-reported"

    @property
    def replayed(self) -> bool:
        """Whether its returns were found by stepping its episodes again; else they are only what was sent in."""
        return self.label != "self-reported"


class Verdict(pydantic.BaseModel):
    """What the board found when it verified an entry; it says so itself, no submission does."""

    model_config = STRICT

    label: Label
    submission: Sha256
    """SHA-256 of the `submission.json` that was verified, which names its traces by hash."""


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
    if evaluation.seeds != _official_seeds(run.robot):
        return "seeds: they are not the official reset seeds, evaluate with the default seed"
    return None


@functools.cache
def _official_seeds(robot: str) -> list[list[int]]:
    seeds: list[list[int]] = reset_seeds(robot, "test", range(ids.SPLIT_SIZES["test"])).tolist()
    return seeds


def read_entries(board: Path, but: str | None = None) -> list[Entry]:
    """Read every entry of a board, in order of slugs; what an interrupted submit left behind is passed over.

    Labels are those that the board has written down; nothing is replayed.

    Args:
        board: the board's folder.
        but: the name of an entry that is left out unread: it is to be replaced, and may be broken.

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
        if place.name.startswith(".") or place.name == but:
            continue
        submission = read_official(place)
        if slug_of(submission) != place.name:
            raise ValueError(
                f"{place / FILE_NAME}: belongs into the folder {slug_of(submission)!r}, not {place.name!r}"
            )
        entries.append(Entry(place.name, submission, _read_label(place, submission)))
    return entries


def _read_label(place: Path, submission: Submission) -> Label:
    path, mend = place / VERDICT, f"submit {place} with --replace, which verifies it anew"
    try:
        verdict = Verdict.model_validate_json(read_inside(place, VERDICT, 4096))
    except FileNotFoundError:
        return "self-reported"
    except pydantic.ValidationError as error:
        raise ValueError(f"{path}: {first_error(error)}: {mend}") from error
    if verdict.submission != _digest(submission):
        raise ValueError(f"{path}: submission: it was made for another {FILE_NAME}: {mend}")
    return verdict.label


def _digest(submission: Submission) -> str:
    return hashlib.sha256(submission_text(submission).encode("utf-8")).hexdigest()


def write_entry(folder: Path, entry: Entry, sources: Sequence[Path]) -> None:
    """Write an entry's files into an empty folder.

    Args:
        folder: what becomes the entry's.
        entry: what to store.
        sources: folders of submissions whose traces are copied, each from the first that has it; the folder of the
            entry that is replaced, too.

    Raises:
        FileNotFoundError, ValueError: a trace is missing, or is not the one that the entry names.
    """
    for run in entry.submission.runs:
        if run.trace is not None:  # one at a time in memory, and compared with its hash again
            source = next((source for source in sources if (source / run.trace_name).is_file()), sources[0])
            write_whole(folder / run.trace_name, trace_content(source, run))
    if entry.label != "self-reported":
        verdict = Verdict(label=entry.label, submission=_digest(entry.submission))
        write_whole(folder / VERDICT, verdict.model_dump_json(indent=1) + "\n")
    write_whole(folder / FILE_NAME, submission_text(entry.submission))
