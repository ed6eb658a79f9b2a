"""What the page shows, and the page.

What is here: `site_page`. Called by the board. It must not know files, nor how the page looks.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import rich.console
import rich.progress

from dynagen_bench import ids
from dynagen_bench.datasets.scores import score_range
from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation import EPISODES
from dynagen_bench.html import look, render, style_and_script
from leaderboard.entries import LABELS, Entry
from leaderboard.markdown import number_text, rank_text
from leaderboard.published import PUBLISHED
from leaderboard.published import ROBOTS as PAPER_ROBOTS
from leaderboard.site.charts import HEAT_LEVELS, Curve, Mark, Scale, curve, heat_level, scale_of
from leaderboard.standings import (
    CHECKPOINTS,
    RUNS,
    TRACKS,
    Cell,
    Row,
    Table,
    balanced,
    data_scores,
    dynamics_scores,
    run_scores,
    standings,
    task_scores,
)
from leaderboard.statistics import RESAMPLES, Estimate, Scores, improvement, optimality_gap, profile

SITE: Final = "site/index.html"
"""Where the page lies in a board's folder."""

ALL: Final = "All robots"

KNOWLEDGE: Final = {
    "none": "the last observation",
    "own-history": "its own episode so far",
    "offline-context": "data of the test dynamics",
    "test-dynamics": "the test dynamics",
}
"""What `privileged` means, after the word “knows”."""


class Figure(NamedTuple):
    """An entry's scores in one column, a robot or all of them, as the table and the charts show them."""

    cell: Cell
    gap: Estimate
    mark: Mark
    profile: Curve


class Heat(NamedTuple):
    """An entry's scores on one robot: in each test dynamics, and of each run."""

    robot: str
    dynamics: list[tuple[str, float, int]]
    """(label, score on the scale of that dynamics' data, level of the shade)."""
    runs: list[tuple[float, float]]
    """(score, place on the scale)."""
    curves: list[str]
    """The points of each run's learning curve: steps to the right, score upwards; empty if none is given."""
    last_step: int


class Competitor(NamedTuple):
    """One entry of a table."""

    row: Row
    look: str
    figures: dict[str, Figure]
    """Column → what is shown there."""
    heats: list[Heat]


class Section(NamedTuple):
    """One table with its charts."""

    name: str
    title: str
    subtitle: str
    columns: list[str]
    competitors: list[Competitor]
    improvements: list[list[list[int] | None]]
    """[entry][over which entry] → per cent, low, high, number of robots; low and high −1 without an interval."""

    def ordered(self, column: str) -> list[Competitor]:
        """Who has a score in a column, the highest interquartile mean first."""
        own = [one for one in self.competitors if column in one.figures]
        return sorted(own, key=lambda one: -one.figures[column].cell.iqm.value)


def site_page(entries: Sequence[Entry]) -> str:
    """The whole page as HTML; the same bytes for the same entries and reference scores.

    Raises:
        ValueError: an entry is on a robot that has no reference scores.
    """
    tables = standings(entries)
    scale = _scale(tables)
    sections = [_section(table, scale) for table in tables]
    data = data_scores()
    return render(
        __package__,
        "index.html.jinja",
        {"score": score_text, "short": short_text, "rank": rank_text},
        sections=sections,
        labels=[label for label in LABELS if any(entry.label == label for entry in entries)],
        robots=[robot for robot in ids.ROBOTS if any(robot in section.columns for section in sections)],
        facts=_facts(entries),
        data=data,
        data_at={robot: scale.at(score) for robot, score in data.items()},
        scale=scale,
        published=PUBLISHED,
        published_robots=PAPER_ROBOTS,
        levels=HEAT_LEVELS,
        constants={"runs": RUNS, "episodes": EPISODES, "horizon": HORIZON, "resamples": f"{RESAMPLES:,}"},
        every_robot=ids.ROBOTS,
        all=ALL,
        knowledge=KNOWLEDGE,
        splits=ids.SPLIT_SIZES,
        **style_and_script(__package__),
    )


def score_text(value: float) -> str:
    """A score with two decimals and a true minus sign."""
    return number_text(value).replace("-", "−")


def short_text(value: float) -> str:
    """A score with one decimal and a true minus sign."""
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def _facts(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    runs = [run for entry in entries for run in entry.submission.runs]
    episodes = sum(len(row) for run in runs for row in run.evaluation.returns)
    mujoco = sorted({run.evaluation.mujoco for run in runs})
    return [
        ("entries", f"{len(entries):,}"),
        ("runs", f"{len(runs):,}"),
        ("episodes", f"{episodes:,}"),
        ("MuJoCo", ", ".join(mujoco) or "–"),
    ]


def _scale(tables: Sequence[Table]) -> Scale:
    """One scale for every chart of intervals, so that they can be compared."""
    cells = [cell for table in tables for row in table.rows for cell in (*row.cells.values(), row.overall) if cell]
    return scale_of(end for cell in cells for end in (cell.iqm.value, *(cell.iqm.interval or ())))


def _section(table: Table, scale: Scale) -> Section:
    columns = [robot for robot in ids.ROBOTS if any(robot in row.cells for row in table.rows)]
    if any(row.overall for row in table.rows):
        columns.append(ALL)
    scores = [task_scores(row.entry.submission) for row in table.rows]
    return Section(
        f"{table.track}-{table.checkpoint}",
        TRACKS[table.track],
        CHECKPOINTS[table.checkpoint],
        columns,
        [
            Competitor(row, look(place), _figures(row, own, scale), _heats(row.entry, scale))
            for place, (row, own) in enumerate(zip(table.rows, scores, strict=True))
        ],
        _improvements(scores),
    )


def _figures(row: Row, scores: Scores, scale: Scale) -> dict[str, Figure]:
    parts: dict[str, tuple[Cell, Scores]] = {robot: (cell, {robot: scores[robot]}) for robot, cell in row.cells.items()}
    if row.overall is not None:
        parts[ALL] = (row.overall, balanced(scores))
    return {
        column: Figure(cell, optimality_gap(own), scale.mark(cell.iqm), curve(profile(own)))
        for column, (cell, own) in parts.items()
    }


def _heats(entry: Entry, scale: Scale) -> list[Heat]:
    runs = run_scores(entry.submission)
    heats = []
    for robot, scores in dynamics_scores(entry.submission).items():
        curves, last_step = _learning(entry, robot)
        dynamics = [(label, score, heat_level(score)) for label, score in scores.items()]
        heats.append(Heat(robot, dynamics, [(score, scale.at(score)) for score in runs[robot]], curves, last_step))
    return heats


def _learning(entry: Entry, robot: str) -> tuple[list[str], int]:
    """The learning curves of a robot's runs in a drawing of 100 × 100, and the step at its right edge."""
    given = [run.curve for run in entry.submission.runs if run.robot == robot and run.curve]
    last = max((point.gradient_steps for points in given for point in points), default=0)
    low, high = score_range(robot)
    upwards, curves = Scale(0.0, 100.0), []
    for points in given:
        ordered = sorted(points, key=lambda point: point.gradient_steps)
        places = [
            (100 * point.gradient_steps / max(last, 1), upwards.at(100 * (point.mean_return - low) / (high - low)))
            for point in ordered
        ]
        curves.append(" ".join(f"{x:.2f},{100 - y:.2f}" for x, y in places))
    return curves, last


def _improvements(scores: Sequence[Scores]) -> list[list[list[int] | None]]:
    """What `improvement` says of every entry over every other, in whole per cent."""
    pairs = [(i, j) for i in range(len(scores)) for j in range(i)]
    table: list[list[list[int] | None]] = [[None] * len(scores) for _ in scores]
    console = rich.console.Console(stderr=True)
    few = len(pairs) < 200  # about two seconds
    for i, j in rich.progress.track(pairs, "comparing entries", console=console, transient=True, disable=few):
        found = improvement(scores[i], scores[j])
        if found is not None:
            robots = sum(robot in scores[j] for robot in scores[i])
            table[i][j] = [*_per_cent(found), robots]
            mirrored = found.interval and (1 - found.interval[1], 1 - found.interval[0])
            table[j][i] = [*_per_cent(Estimate(1 - found.value, mirrored)), robots]
    return table


def _per_cent(estimate: Estimate) -> list[int]:
    ends: tuple[Any, ...] = estimate.interval or (-0.01, -0.01)
    return [round(100 * number) for number in (estimate.value, *ends)]
