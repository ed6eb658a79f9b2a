"""What the page shows, and the page.

What is here: `write_summary`, and how a number is written. Called by the command lines of `summary` and `sweep`, and by
the reference results for the numbers. It must not know how runs are made, nor how the page looks.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from agents.summary.charts import Point, Scale, band, curve_of, line, scale_of
from agents.summary.intervals import MeanEstimate, mean_estimate
from agents.summary.runs import Group, Run, grouped, read_runs
from dynagen_bench import ids
from dynagen_bench.html import look, render, style_and_script
from dynagen_bench.whole import write_whole


class Metric(NamedTuple):
    """A curve of runs that the page shows."""

    column: str
    title: str
    note: str
    is_result: bool
    """Has a column in the table of final results."""
    is_error: bool


METRICS: Final = (
    Metric("test_return", "Return", "mean over the episodes in the test dynamics", True, False),
    Metric("test_score", "Score", "0 at the lowest, 100 at the highest return of the test dynamics’ data", True, False),
    Metric("test_error", "Prediction error", "mean square of normalised next states, test dynamics", True, True),
    Metric("validation_return", "Validation return", "in train dynamics that were held out", True, False),
    Metric("validation_loss", "Validation loss", "on data of the held-out train dynamics", False, True),
    Metric("loss", "Loss", "in training", False, True),
    Metric("action_loss", "Action loss", "mean square error of actions, in training", False, True),
    Metric("next_state_loss", "Next-state loss", "mean square of normalised next states, in training", False, True),
)


class Drawn(NamedTuple):
    """A group in one chart."""

    group: "Shown"
    line: str
    band: str | None
    readings: list[tuple[float, str, str]]
    """(place, mean, interval) of each point, for who points at it."""


class Panel(NamedTuple):
    """One chart."""

    metric: Metric
    y: Scale
    drawn: list[Drawn]


class Shown(NamedTuple):
    """A group, and how it looks."""

    group: Group
    slug: str
    look: str
    finals: dict[str, MeanEstimate]
    """Column → its last values over runs."""
    config: str
    """What the runs have in common, as JSON."""


class Section(NamedTuple):
    """One robot."""

    robot: str
    x: Scale
    panels: list[Panel]
    shown: list[Shown]
    results: list[Metric]


def write_summary(runs: Path, output: Path) -> Path:
    """Write the page of the runs in a folder, whole or not at all; the same bytes for the same runs.

    Raises:
        ValueError: a run folder holds what training does not write.
    """
    page = summary_page(read_runs(runs))
    write_whole(output, page)
    return output


def summary_page(runs: Sequence[Run]) -> str:
    """The whole page as HTML."""
    sections = _sections(grouped(runs))
    facts = [
        ("runs", len(runs)),
        ("groups", sum(len(section.shown) for section in sections)),
        ("robots", len(sections)),
        ("hours of training", number_text(sum(run.hours for run in runs))),
    ]
    return render(
        __package__,
        "page.html.jinja",
        {"number": number_text, "steps": steps_text, "final": final_text},
        sections=sections,
        facts=facts,
        **style_and_script(__package__),
    )


def number_text(value: float) -> str:
    """Four digits, or all before the point, with a true minus sign."""
    text = f"{value:,.1f}" if abs(value) >= 1000 else f"{value:.4g}"
    return text.replace("-", "−")


def steps_text(steps: float) -> str:
    """`500`, `20K`, `1M`."""
    return f"{steps / 1e6:g}M" if steps >= 1e6 else f"{steps / 1e3:g}K" if steps >= 1e3 else f"{steps:g}"


def final_text(value: MeanEstimate) -> str:
    """`mean ± std`, both to the third digit of the deviation."""
    if not value.std:
        return number_text(value.mean) + ("" if value.std is None else " ± 0")
    digits = min(max(2 - math.floor(math.log10(value.std)), 0), 8)
    return f"{value.mean:,.{digits}f} ± {value.std:,.{digits}f}".replace("-", "−")


def interval_text(value: MeanEstimate) -> str:
    """`[low, high]`, or nothing of a single run."""
    return "" if value.interval is None else f"[{', '.join(map(number_text, value.interval))}]"


def _sections(groups: Sequence[Group]) -> list[Section]:
    labels = list(dict.fromkeys(group.label for group in sorted(groups, key=lambda group: group.order[1:])))
    robots = sorted({group.robot for group in groups}, key=_place_of)
    slugs = {id(group): f"group-{number}" for number, group in enumerate(groups)}
    sections = []
    for robot in robots:
        own = [group for group in groups if group.robot == robot]
        sections.append(_section(robot, [_shown(group, slugs[id(group)], labels.index(group.label)) for group in own]))
    return sections


def _place_of(robot: str) -> tuple[int, str]:
    return (ids.ROBOTS.index(robot) if robot in ids.ROBOTS else len(ids.ROBOTS), robot)


def _section(robot: str, shown: list[Shown]) -> Section:
    x = Scale(0.0, float(max(1, *(run.step for one in shown for run in one.group.runs))))
    panels = []
    for metric in METRICS:
        curves = [(one, curve_of(found)) for one in shown if (found := one.group.curves(metric.column))]
        if curves:
            y = scale_of((curve for _, curve in curves), metric.is_error)
            panels.append(Panel(metric, y, [_drawn(one, curve, x, y) for one, curve in curves]))
    results = [metric for metric in METRICS if metric.is_result and any(metric.column in one.finals for one in shown)]
    return Section(robot, x, panels, shown, results)


def _shown(group: Group, slug: str, place: int) -> Shown:
    finals = {}
    for metric in METRICS:
        last = group.ends(metric.column)
        if last:
            finals[metric.column] = mean_estimate(last)
    about = group.runs[0].about
    common = {"agent": about["agent"], "config": about["config"], "data": about.get("data", {})}
    settings = {key: value for key, value in about["settings"].items() if key in group.runs[0].facts}
    config = json.dumps(common | {"settings": settings}, indent=1, ensure_ascii=False)
    return Shown(group, slug, look(place), finals, config)


def _drawn(one: Shown, curve: Sequence[Point], x: Scale, y: Scale) -> Drawn:
    readings = [(x.at(step), number_text(value.mean), interval_text(value)) for step, value in curve]
    return Drawn(one, line(curve, x, y), band(curve, x, y), readings)
