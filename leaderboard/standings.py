"""From entries to ranked tables of scores, before anything is said about how they look.

What is here: `standings`, one table a track and checkpoint, and the scores in it. Called by the Markdown page, the
site, the terminal's tables, `board`, `export` and the reference results. It must not know files.
"""

import math
import statistics
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.scores import normalized_score
from dynagen_bench.evaluation import data_returns
from dynagen_bench.evaluation.submission import Submission
from leaderboard.entries import Entry
from leaderboard.statistics import Estimate, Rank, Scores, interquartile_mean, near_best, ranks

RUNS: Final = 5
"""Runs of a full entry on each robot (paper, section 5.1)."""

TRACKS: Final = {"zero-shot": "Zero-shot", "adaptation": "Adaptation"}

CHECKPOINTS: Final = {"last": "last checkpoint (official)", "best": "best checkpoint (the paper's way)"}
"""They are never in one table: the best checkpoint was chosen by its score in the test dynamics."""


REFERENCE: Final = "test-dynamics"
"""Who knew the test dynamics themselves is shown to compare with, and is neither marked nor ranked."""


class Cell(NamedTuple):
    """The score of one entry on one robot, or over all of them."""

    mean: float
    """Over the runs; over all robots, of the robots' means."""
    std: float | None
    """Sample standard deviation over the runs; None for a single one, and over all robots."""
    runs: int
    """Over all robots, on the robot with fewest."""
    bold: bool
    """Within one standard deviation of the table's best mean, its own (as the paper marks them); never over robots."""
    iqm: Estimate
    """Interquartile mean of the runs' scores in each dynamics."""
    rank: Rank | None = None
    """By the intervals of the interquartile means in this column of the table; None for a single run."""


class Row(NamedTuple):
    """One line of a table."""

    entry: Entry
    cells: dict[str, Cell]
    """Robot → score, of the robots that the entry has."""
    overall: Cell | None
    """Over all robots; None where one is missing."""

    @property
    def reference(self) -> bool:
        """Whether it knew the test dynamics themselves."""
        return self.entry.submission.privileged == REFERENCE

    @property
    def competes(self) -> bool:
        """Whether it is marked and ranked: neither a reference is, nor numbers that nobody has replayed."""
        return not self.reference and self.entry.replayed

    @property
    def partial(self) -> bool:
        """Whether robots are missing, or runs on some robot."""
        return len(self.cells) < len(ids.ROBOTS) or any(cell.runs < RUNS for cell in self.cells.values())


class Table(NamedTuple):
    """The entries of one track and one kind of checkpoint: the best first; last the not replayed, and references."""

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


def task_scores(submission: Submission) -> Scores:
    """Robot → (R, M) float64: each run's score in each test dynamics, on the robot's official scale; runs by seed.

    The mean of a row is the run's official score. Raises ValueError without reference scores.
    """
    scores: dict[str, NDArray[np.float64]] = {}
    for robot in ids.ROBOTS:
        own = sorted((run for run in submission.runs if run.robot == robot), key=lambda run: run.seed)
        if own:
            means = [run.evaluation.evaluation().returns.mean(axis=1) for run in own]
            scores[robot] = normalized_score(robot, np.stack(means))
    return scores


def balanced(scores: Scores) -> Scores:
    """As many runs of each robot as there are of the one with fewest, so that none weighs more than another."""
    runs = min(len(values) for values in scores.values())
    return {robot: values[:runs] for robot, values in scores.items()}


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
    """Rows of one table: who competes, then self-reported ones, then references; the higher sum over robots, by slug.

    A robot without runs adds nothing, as one on which the agent is no better than the worst of the data: who has run on
    one robot only stands above a random policy that has run on all, and below who does as well on two.
    """
    rows = [Row(entry, *_cells(entry.submission)) for entry in entries]
    competing = [row for row in rows if row.competes]
    for robot in ids.ROBOTS:
        column = _placed(_marked({row.entry.slug: row.cells[robot] for row in competing if robot in row.cells}))
        rows = [
            row._replace(cells=row.cells | {robot: column[row.entry.slug]}) if row.entry.slug in column else row
            for row in rows
        ]
    column = _placed({row.entry.slug: row.overall for row in competing if row.overall is not None})
    rows = [row._replace(overall=column.get(row.entry.slug, row.overall)) for row in rows]
    return sorted(
        rows,
        key=lambda row: (
            row.reference,
            not row.competes,
            -math.fsum(cell.mean for cell in row.cells.values()),
            row.entry.slug,
        ),
    )


def _cells(submission: Submission) -> tuple[dict[str, Cell], Cell | None]:
    """An entry's cell on each of its robots, and over all of them if it has all; neither marks nor ranks yet."""
    runs, tasks = run_scores(submission), task_scores(submission)
    # fmean and stdev are exactly rounded: the same bytes on every processor
    cells = {
        robot: Cell(
            statistics.fmean(scores),
            statistics.stdev(scores) if len(scores) > 1 else None,
            len(scores),
            bold=False,
            iqm=interquartile_mean({robot: tasks[robot]}),
        )
        for robot, scores in runs.items()
    }
    if len(cells) < len(ids.ROBOTS):
        return cells, None
    mean = statistics.fmean(cell.mean for cell in cells.values())
    fewest = min(cell.runs for cell in cells.values())
    return cells, Cell(mean, None, fewest, bold=False, iqm=interquartile_mean(balanced(tasks)))


def _marked(column: dict[str, Cell]) -> dict[str, Cell]:
    """Slug → cell of one robot, those near the best in bold."""
    line = near_best((cell.mean, cell.std) for cell in column.values())
    return {slug: cell._replace(bold=cell.mean >= line) for slug, cell in column.items()}


def _placed(column: dict[str, Cell]) -> dict[str, Cell]:
    """Slug → cell of one column, with their ranks."""
    found = ranks([cell.iqm.interval for cell in column.values()])
    return {slug: cell._replace(rank=rank) for (slug, cell), rank in zip(column.items(), found, strict=True)}


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
