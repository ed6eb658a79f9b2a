"""From entries to ranked tables of scores, before anything is said about how they look.

What is here: `standings`, one table a track and checkpoint. Called by the Markdown page and the terminal's table. It
must not know files.
"""

import statistics
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from dynagen_bench import ids
from dynagen_bench.datasets.scores import normalized_score
from dynagen_bench.evaluation import data_returns
from dynagen_bench.evaluation.submission import Submission
from leaderboard.entries import Entry

RUNS: Final = 5
"""Runs of a full entry on each robot (paper, section 5.1)."""

TRACKS: Final = {"zero-shot": "Zero-shot", "adaptation": "Adaptation"}

CHECKPOINTS: Final = {"last": "last checkpoint (official)", "best": "best checkpoint (the paper's way)"}
"""They are never in one table: the best checkpoint was chosen by its score in the test dynamics."""


class Cell(NamedTuple):
    """The score of one entry on one robot."""

    mean: float
    """Over the runs."""
    std: float | None
    """Sample standard deviation over the runs; None for a single one."""
    runs: int
    bold: bool
    """Within one standard deviation of the table's best mean, its own (as the paper marks them)."""


class Row(NamedTuple):
    """One line of a table."""

    entry: Entry
    cells: dict[str, Cell]
    """Robot → score, of the robots that the entry has."""

    @property
    def partial(self) -> bool:
        """Whether robots are missing, or runs on some robot."""
        return len(self.cells) < len(ids.ROBOTS) or any(cell.runs < RUNS for cell in self.cells.values())


class Table(NamedTuple):
    """The entries of one track and one kind of checkpoint, the best first."""

    track: str
    checkpoint: str
    rows: list[Row]


def run_scores(submission: Submission) -> dict[str, list[float]]:
    """Robot → official score of each run, computed from the returns; raises ValueError without reference scores."""
    scores: dict[str, list[float]] = {}
    for robot in ids.ROBOTS:
        own = [run.evaluation.evaluation().score for run in submission.runs if run.robot == robot]
        if own:
            scores[robot] = own
    return scores


def dynamics_scores(submission: Submission) -> dict[str, dict[str, float]]:
    """Robot → label → score in that dynamics on its own scale, mean over the runs."""
    means: dict[str, dict[str, float]] = {}
    for robot in ids.ROBOTS:
        runs = [run.evaluation.evaluation().dynamics_scores for run in submission.runs if run.robot == robot]
        if runs:
            means[robot] = {label: statistics.fmean(run[label] for run in runs) for label in runs[0]}
    return means


def standings(entries: Sequence[Entry]) -> list[Table]:
    """The tables that have an entry: zero-shot before adaptation, the last checkpoint before the best."""
    tables = []
    for track in TRACKS:
        for checkpoint in CHECKPOINTS:
            own = [e for e in entries if e.submission.track == track and e.submission.checkpoint == checkpoint]
            if own:
                tables.append(Table(track, checkpoint, _ranked(own)))
    return tables


def _ranked(entries: Sequence[Entry]) -> list[Row]:
    """Rows of one table: more robots first, then the higher mean over robots, then by slug."""
    plain = {entry.slug: {r: _cell(s) for r, s in run_scores(entry.submission).items()} for entry in entries}
    rows = [Row(entry, _marked(plain[entry.slug], plain.values())) for entry in entries]
    return sorted(
        rows,
        key=lambda row: (-len(row.cells), -statistics.fmean(c.mean for c in row.cells.values()), row.entry.slug),
    )


def _cell(scores: Sequence[float]) -> Cell:
    # fmean and stdev are exactly rounded: the same bytes on every processor
    std = statistics.stdev(scores) if len(scores) > 1 else None
    return Cell(statistics.fmean(scores), std, len(scores), bold=False)


def _marked(cells: dict[str, Cell], everyone: Iterable[dict[str, Cell]]) -> dict[str, Cell]:
    marked = {}
    for robot, cell in cells.items():
        best = max((other[robot] for other in everyone if robot in other), key=lambda other: other.mean)
        marked[robot] = cell._replace(bold=cell.mean >= best.mean - (best.std or 0.0))
    return marked


def data_scores() -> dict[str, float]:
    """Robot → score of the test data's own mean return; robots whose data have not been made are left out."""
    scores = {}
    for robot in ids.ROBOTS:
        try:
            returns = data_returns(robot)
        except ValueError:  # no reference scores yet
            continue
        scores[robot] = float(normalized_score(robot, statistics.fmean(returns.values())))
    return scores
