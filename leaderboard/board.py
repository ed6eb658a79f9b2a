"""Changing a board: an entry in and the pages made anew, both or neither.

What is here: `submit`, `rerun`, `build`, `is_current`, `verify_entries` and `entry_of`. Called by the command line. It
must not know how tables look.
"""

import contextlib
import difflib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from dynagen_bench.evaluation.submission import FILE_NAME, Submission, trace_content
from dynagen_bench.whole import exclusively, recover, whole_folder, write_whole
from leaderboard.copies import check_copies
from leaderboard.entries import (
    FOLDER,
    LABELS,
    VERDICT,
    Entry,
    read_entries,
    read_official,
    slug_of,
    write_entry,
)
from leaderboard.joining import joined
from leaderboard.markdown import page
from leaderboard.site.builder import SITE, site_page
from leaderboard.standings import run_scores
from leaderboard.verify import RunCheck, label_of, verify

BOARD: Final = Path(__file__).parent
"""The project's own board, this folder."""

PAGE: Final = "LEADERBOARD.md"


def ignore(check: RunCheck) -> None:
    """Nobody is told how far a verification is."""


def submit(
    folder: Path,
    board: Path = BOARD,
    replace: bool = False,
    join: bool = False,
    done: Callable[[RunCheck], None] = ignore,
) -> Entry:
    """Verify the submission in `folder`, copy it into the board and make the pages anew; returns the entry.

    What is stored are the returns of the replay. Everything that can be wrong is found before anything is written, and
    what fails later is taken back. A kill after the entry is in leaves the pages behind it, which `is_current` sees and
    the next `submit` or `build` mends. Two at once wait for each other.

    Args:
        folder: holds `submission.json` and the traces that it names; nothing else in it is read or copied.
        board: the board's folder.
        replace: take the place of an entry of the same name, whose label may be broken; `folder` may be that entry's.
        join: add the runs to those of the entry of the same name.
        done: called with each run that has been verified.

    Raises:
        FileNotFoundError: there is no submission in `folder`, or no entry to join.
        FileExistsError: the board has an entry of this name, and neither `replace` nor `join` is given, or it is of
            another agent.
        ValueError: one line naming the file and the field that is wrong.
    """
    if replace and join:
        raise ValueError("give either --replace or --join: the new runs stand alone, or beside those of the entry")
    submission = read_official(folder)
    run_scores(submission)  # there have to be reference scores
    _check_name(board, submission, replace or join)
    if join:  # this and the next raise before the long replay
        joined(_entry(board, slug_of(submission)).submission, submission)
    elif board.is_dir():
        read_entries(board, but=slug_of(submission))
    entry = _verified(folder, submission, done)
    with _locked(board):
        _check_name(board, submission, replace or join)
        sources = [folder]
        if join:  # what the entry has is the entry's, whatever else lies in the given folder under the same name
            there = _entry(board, entry.slug)
            whole = joined(there.submission, entry.submission)
            entry = Entry(entry.slug, whole, min(there.label, entry.label, key=LABELS.index))
            sources.insert(0, board / FOLDER / entry.slug)
        check_copies(folder, entry.submission, read_entries(board, but=entry.slug))
        _put(board, entry, sources)
    return entry


def entry_of(name: str, board: Path = BOARD, done: Callable[[RunCheck], None] = ignore) -> Entry:
    """An entry of the board by its name; or what a folder's submission would be as one, verified by replay.

    Raises:
        FileNotFoundError: the board has no entry of this name, and there is no folder of it.
        ValueError: the folder's submission is not what it says.
    """
    folder = Path(name)
    if not folder.is_dir():
        return _entry(board, name)
    submission = read_official(folder)
    run_scores(submission)
    return _verified(folder, submission, done)


def _verified(folder: Path, submission: Submission, done: Callable[[RunCheck], None]) -> Entry:
    """A submission as an entry, with the returns of its replay; raises ValueError at the first fault."""
    checks = verify(folder, submission, done)
    faults = [fault for check in checks for fault in check.faults]
    if faults:
        more = f" (and {len(faults) - 1} more: `python -m leaderboard verify`)" if len(faults) > 1 else ""
        raise ValueError(faults[0] + more)
    return Entry(slug_of(submission), _with_returns(submission, checks), label_of(checks))


def _entry(board: Path, slug: str) -> Entry:
    """An entry of a board; raises FileNotFoundError if there is none of that name."""
    entries = {entry.slug: entry for entry in read_entries(board)}
    if slug not in entries:
        near = difflib.get_close_matches(slug, entries, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(entries) or 'none'}"
        raise FileNotFoundError(f"{board / FOLDER} has no entry {slug!r}: {hint}")
    return entries[slug]


def rerun(slug: str, folder: Path, board: Path = BOARD) -> Entry:
    """Label an entry `re-run`, if the maintainers' own submission of the same agent did the same in every episode.

    Args:
        slug: the entry's name.
        folder: what the maintainers' runs of the policy wrote, with the entry's robots and seeds.
        board: the board's folder.

    Raises:
        FileNotFoundError: there is no submission in `folder`, or no such entry.
        ValueError: the entry has not been replayed exactly, or a run is missing in `folder` or did something else.
    """
    own = {(run.robot, run.seed): run for run in read_official(folder).runs}
    read_entries(board)  # before a lock would make the folder
    with _locked(board):
        entry = _entry(board, slug)
        if entry.label not in ("replayed", "re-run"):
            raise ValueError(f"{slug} is {entry.label}: only what was replayed exactly can be re-run")
        for run in entry.submission.runs:
            mine = own.get((run.robot, run.seed))
            if mine is None or mine.trace != run.trace:
                what = "is missing" if mine is None else "did something else"
                raise ValueError(f"{folder / FILE_NAME}: the run of {run.robot} with seed {run.seed} {what}")
            trace_content(folder, mine)  # the file is what its hash says
        entry = Entry(slug, entry.submission, "re-run")
        _put(board, entry, [board / FOLDER / slug])
    return entry


def verify_entries(board: Path = BOARD, done: Callable[[RunCheck], None] = ignore) -> dict[str, list[RunCheck]]:
    """Replay every entry of a board: slug → what was found of its runs.

    An entry whose label says more than its replay has a fault, too: what is exact only on the board's own machine is
    replayed within the tolerance elsewhere, and that is none. That maintainers have run a policy themselves (`re-run`)
    no replay can show: that label is the word of who committed it.

    Raises:
        FileNotFoundError, ValueError: as `read_entries` does; two agents have the same episodes.
    """
    found = {}
    entries = read_entries(board)
    for entry in entries:
        check_copies(board / FOLDER / entry.slug, entry.submission, entries)
        checks = verify(board / FOLDER / entry.slug, entry.submission, done)
        if entry.label != "self-reported" and any(check.label == "self-reported" for check in checks):
            line = (
                f"{board / FOLDER / entry.slug / VERDICT}: label: {entry.label!r}, but the replay does not bear it out"
            )
            checks[0] = checks[0]._replace(faults=(*checks[0].faults, line))
        found[entry.slug] = checks
    return found


def build(board: Path = BOARD) -> Path:
    """Make LEADERBOARD.md and site/index.html from the entries, and return the former's path.

    Raises as `read_entries` does; the old pages stay then.
    """
    read_entries(board)
    with _locked(board):
        _write_pages(board, _pages(read_entries(board)))
    return board / PAGE


def is_current(board: Path = BOARD) -> bool:
    """Whether every page is what `build` would write, byte for byte."""
    pages = _pages(read_entries(board))
    return all((board / name).is_file() and (board / name).read_bytes() == text for name, text in pages.items())


def _pages(entries: Sequence[Entry]) -> dict[str, bytes]:
    """What is made from the entries: name of the file in the board's folder → its bytes."""
    return {PAGE: page(entries).encode("utf-8"), SITE: site_page(entries).encode("utf-8")}


@contextlib.contextmanager
def _locked(board: Path) -> Iterator[None]:
    """Be the only one who changes the board, after what a killed one has left is put right."""
    with exclusively(board / FOLDER):
        recover(board / FOLDER)
        yield


def _check_name(board: Path, submission: Submission, replace: bool) -> None:
    """Raise FileExistsError if the entry's place is taken and not to be given up, or is another agent's."""
    slug = slug_of(submission)
    if not (board / FOLDER / slug).is_dir():
        return
    if not replace:
        raise FileExistsError(
            f"{board} has an entry {slug!r}: give --replace, --join to add runs to it, or another name to the agent"
        )
    there = read_official(board / FOLDER / slug).agent
    if _spelling(there) != _spelling(submission.agent):  # `DT` and `DT+` have one folder name
        raise FileExistsError(
            f"{board} has an entry {slug!r}, of {there!r} and not of {submission.agent!r}: give the agent another name"
        )


def _spelling(agent: str) -> str:
    """An agent's name without what may be mended of it: case, spaces, `-` and `_`."""
    return re.sub(r"[\s_-]", "", agent.casefold())


def _with_returns(submission: Submission, checks: Sequence[RunCheck]) -> Submission:
    """The submission with the returns that the replay gave, and whose they are: the board believes no other."""
    runs = []
    for check in checks:
        found = {"returns": check.returns.tolist(), "physics": check.physics}
        runs.append(check.run.model_copy(update={"evaluation": check.run.evaluation.model_copy(update=found)}))
    return submission.model_copy(update={"runs": runs})


def _put(board: Path, entry: Entry, sources: Sequence[Path]) -> None:
    """Entry and pages, both or neither."""
    entries = [*read_entries(board, but=entry.slug), entry]
    pages = _pages(sorted(entries, key=lambda entry: entry.slug))
    with whole_folder(board / FOLDER / entry.slug, then=lambda: _write_pages(board, pages)) as unfinished:
        write_entry(unfinished, entry, sources)


def _write_pages(board: Path, pages: Mapping[str, bytes]) -> None:
    """Write the pages; after an error they are what they were."""
    before = {name: (board / name).read_bytes() if (board / name).is_file() else None for name in pages}
    try:
        _write(board, pages)
    except BaseException:  # an interruption too
        _write(board, before)
        raise


def _write(board: Path, pages: Mapping[str, bytes | None]) -> None:
    for name, text in pages.items():
        path = board / name
        if text is None:
            path.unlink(missing_ok=True)
        elif not path.is_file() or path.read_bytes() != text:
            write_whole(path, text)
