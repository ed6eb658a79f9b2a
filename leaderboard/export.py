"""The board for a paper: scores as CSV, to compute with, and tables as LaTeX, to print.

What is here: `scores_csv` and `latex`. Called by the command line. It must not compute scores.
"""

import csv
import io
from collections.abc import Sequence
from typing import Final

from dynagen_bench import ids
from leaderboard.entries import Entry
from leaderboard.markdown import number_text
from leaderboard.standings import CHECKPOINTS, RUNS, TRACKS, Cell, Row, Table, standings, task_scores

COLUMNS: Final = (
    "entry",
    "agent",
    "track",
    "checkpoint",
    "label",
    "robot",
    "seed",
    "gradient_steps",
    "dynamics",
    "mean_return",
    "score",
)
"""Of the CSV: `mean_return` over the episodes, `score` on the robot's official scale, so that the mean of a run's
scores over its dynamics is the score of the run."""

_LATEX: Final = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def scores_csv(entries: Sequence[Entry]) -> str:
    """A line for each run of each entry in each test dynamics, below the names of `COLUMNS`.

    Raises:
        ValueError: an entry is on a robot that has no reference scores.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for entry in entries:
        one = entry.submission
        about = (entry.slug, one.agent, one.track, one.checkpoint, entry.label)
        for robot, scores in task_scores(one).items():
            runs = sorted((run for run in one.runs if run.robot == robot), key=lambda run: run.seed)
            for run, own in zip(runs, scores, strict=True):
                found = run.evaluation.evaluation()
                means = zip(found.labels, found.returns.mean(axis=1), own, strict=True)
                for label, mean, score in means:
                    place = (robot, run.seed, run.gradient_steps, label)
                    writer.writerow((*about, *place, float(mean), float(score)))
    return text.getvalue()


def latex(entries: Sequence[Entry]) -> str:
    r"""The board's tables of scores, one `tabular` for each; needs `\usepackage{booktabs}`.

    Raises:
        ValueError: an entry is on a robot that has no reference scores.
    """
    return "\n".join(_tabular(table) for table in standings(entries))


def _tabular(table: Table) -> str:
    robots = [robot for robot in ids.ROBOTS if any(robot in row.cells for row in table.rows)]
    lines = [
        f"% {TRACKS[table.track]}, {CHECKPOINTS[table.checkpoint]}; mean over {RUNS} runs, or as many as are told, "
        "and their standard deviation",
        r"\begin{tabular}{l" + "r" * len(robots) + "}",
        r"\toprule",
        " & ".join(["Agent", *robots]) + r" \\",
        r"\midrule",
        *(_line(row, robots) for row in table.rows if not row.reference),
        *([r"\midrule"] if any(row.reference for row in table.rows) else []),
        *(_line(row, robots) for row in table.rows if row.reference),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _line(row: Row, robots: Sequence[str]) -> str:
    agent = row.entry.submission.agent.translate(_LATEX)
    note = "" if row.entry.replayed else f" ({row.entry.label})"
    return " & ".join([agent + note, *(_cell(row.cells.get(robot)) for robot in robots)]) + r" \\"


def _cell(cell: Cell | None) -> str:
    if cell is None:
        return "--"
    text = number_text(cell.mean)
    text = rf"\textbf{{{text}}}" if cell.bold else text
    if cell.std is not None:
        text += rf" $\pm$ {number_text(cell.std)}"
    return text if cell.runs == RUNS else f"{text} ({cell.runs})"
