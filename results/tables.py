"""Our counterparts of the paper's tables, in Markdown, with the paper's numbers in a line under ours.

What is here: a function a table. Called by the page. It must not read files.
"""

import dataclasses
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from agents.evaluate import COMPARED
from agents.run_folder import DATA, RunSettings, usual_config
from agents.summary.builder import final_text
from agents.summary.intervals import MeanEstimate, mean_estimate
from agents.summary.runs import Run, grouped
from dynagen_bench import ids
from dynagen_bench.markdown import table
from leaderboard.comparison import Comparison
from leaderboard.entries import Entry
from leaderboard.markdown import escape, iqm_text, score_text
from leaderboard.published import PUBLISHED, PUBLISHED_ERRORS, PUBLISHED_WEIGHTS, Score
from leaderboard.published import ROBOTS as PAPER_ROBOTS
from leaderboard.standings import TRACKS, Row, standings
from leaderboard.statistics import Scores
from results.claims import NAMES, PREDICTORS, SLUGS, Claim, replayed_scores
from results.kept import Errors

_NOT_THE_PAPERS: Final = ("–",) * (len(ids.ROBOTS) - len(PAPER_ROBOTS))
"""Cells of the robots that the paper has not."""

PAPER_STEPS: Final = 1_000_000
"""Gradient steps of a run (section 5.1)."""

PAPER_RUNS: Final = 5
"""On each robot."""

CLUSTER: Final = 25
"""Threads, of a cluster for example, that the runs of an agent keep busy, one each."""

WATTS: Final = 360 / 96
"""Rated power of one core: AMD's EPYC 9654, of the family that the runs were made on, has 96 at 360 W. No memory, no
cooling, no losses; the machine that trains shows no meter of its own."""


def scores(entries: Sequence[Entry], track: str) -> str:
    """Replayed scores of one track by robot, the last checkpoint's, ours and the paper's (its Tables 1, 2 and 7)."""
    rows: dict[str, Row] = {}
    for standing in standings(entries):
        if (standing.track, standing.checkpoint) == (track, "last"):
            rows = {row.entry.slug: row for row in standing.rows if row.entry.replayed}
    published = {row.agent: row.cells for one in PUBLISHED for row in one.rows if one.title.startswith(TRACKS[track])}
    lines = []
    for name, slug in SLUGS.items():
        own = rows.get(f"{slug}-{track}-last")
        if own is not None:
            cells = [own.cells.get(robot) for robot in ids.ROBOTS]
            lines.append([name, *(score_text(cell) for cell in cells)])
            lines.append(["interquartile mean [95 %]", *(iqm_text(cell) for cell in cells)])
        if name in published:
            told = [_published(cell, unknown="?") for cell in published[name]]
            lines.append([f"*{name}, the paper*", *told, *_NOT_THE_PAPERS])
    return table(["", *ids.ROBOTS], lines)


def errors(found: Sequence[Errors]) -> str:
    """Next-state errors by robot, ours and the paper's (its Table 3)."""
    lines = []
    for agent, name in PREDICTORS.items():
        own = {one.robot: one.values for one in found if one.agent == agent}
        if own:
            lines.append([name, *_final_texts(own)])
        if name in PUBLISHED_ERRORS:
            published = [f"{mean:.4f} ± {std:.4f}" for mean, std in PUBLISHED_ERRORS[name]]
            lines.append([f"*{name}, the paper*", *published, *_NOT_THE_PAPERS])
    unchanged = {one.robot: one.unchanged for one in found if one.unchanged is not None}
    if unchanged:
        cells = (f"{unchanged[robot]:.4g}" if robot in unchanged else "–" for robot in ids.ROBOTS)
        lines.append(["no change: the present state", *cells])
    return table(["", *ids.ROBOTS], lines)


def low_quality(low: Mapping[str, Scores], entries: Sequence[Entry]) -> str:
    """Scores of agents trained on low-quality data, by robot, and on all data under them (the paper's Figure 5)."""
    replayed = replayed_scores(entries)
    lines = []
    for agent, own in low.items():
        lines.append([NAMES.get(agent, escape(agent)), *_final_texts(own)])
        whole = replayed.get(f"{agent.replace('_', '-')}-zero-shot-last")
        if whole is not None:
            lines.append(["on all data", *_final_texts({robot: whole[robot] for robot in own if robot in whole})])
    return table(["", *ids.ROBOTS], lines)


def weights(found: Mapping[str, Scores]) -> str:
    """Scores of DADT by λ, on the robots that were run here, and over all in the paper (its Table 4)."""
    lines = [
        [value, *_final_texts(found.get(value, {})), _published(PUBLISHED_WEIGHTS.get(value))]
        for value in sorted({*found, *PUBLISHED_WEIGHTS}, key=float)
    ]
    return table(["λ", *ids.ROBOTS, "all robots, the paper"], lines)


def error_estimates(found: Sequence[Errors], agent: str) -> dict[str, MeanEstimate]:
    """Robot → the mean over runs of an agent's errors, each the mean over its test dynamics."""
    return {one.robot: mean_estimate(one.values.mean(axis=1).tolist()) for one in found if one.agent == agent}


def verdicts(found: Iterable[Claim]) -> str:
    """The claims of the paper, and what they come to here."""
    lines = [
        [claim.text, claim.source, f"**{claim.verdict}**", "; ".join(_evidence(one) for one in claim.evidence)]
        for claim in found
    ]
    return table(["The paper claims", "where", "here", "probability [95 % interval]"], lines, numbers_from=None)


def training(runs: Sequence[Run]) -> str:
    """What the runs were trained with, a line for runs that differ in their seed alone, and what that took."""
    lines = []
    for group in grouped(runs):
        first, hours = group.runs[0], [run.hours for run in group.runs]
        config, seeds = first.about["config"], ", ".join(str(run.seed) for run in group.runs)
        rate = f"{config['learning_rate']:g}"
        if config.get("warmup_steps"):
            rate += f" after {config['warmup_steps']:,} steps of warm-up"
        if config.get("decay_steps"):
            rate += f", falling to 0 in the last {config['decay_steps']:,}"
        mean = sum(hours) / len(hours)
        took = [f"{60 * mean:.1f} min", f"{WATTS * mean:.2f} Wh"]
        commit = ", ".join(dict.fromkeys(f"`{run.about['commit'][:7]}`" for run in group.runs))
        cells = [escape(group.label), group.robot, seeds, f"{first.step:,}", f"{config['batch_size']}", rate]
        lines.append([*cells, escape(_other_settings(first)), *took, commit])
    header = ["agent", "robot", "seeds", "gradient steps", "batch", "learning rate", "else changed"]
    return table([*header, "wall clock", "energy", "commit"], lines, numbers_from=None)


TOLD: Final = ("steps", "batch_size", "learning_rate", "warmup_steps", "decay_steps", "precision")
"""What has columns of its own, and what a machine chooses."""


def _other_settings(run: Run) -> str:
    """What else of a run's config and data is not the default, by the options' names; – for nothing."""
    config = run.about["config"]
    usual = usual_config(run.about["agent"], run.facts["robot"], config["steps"])
    changed = {key: value for key, value in config.items() if key not in TOLD and value != usual.get(key, value)}
    settings, whole = run.about["settings"], dataclasses.asdict(RunSettings(run.facts["robot"]))
    changed |= {key: settings[key] for key in (*DATA, "patience") if settings.get(key, whole[key]) != whole[key]}
    return ", ".join(f"{key.replace('_', '-')} {value}" for key, value in changed.items()) or "–"


LAST_PHASE: Final = ", last phase"
"""What follows an agent's name where a gradient step of its last phase was timed (tests/benchmarks/test_compute.py)."""


def cost(times: Mapping[str, float]) -> str:
    """What the paper's budget would take by the seconds of a gradient step; an agent of two phases halves the steps."""
    lines = []
    for name, first in times.items():
        if name.endswith(LAST_PHASE):
            continue
        seconds = (first + times.get(name + LAST_PHASE, first)) / 2
        hours = PAPER_STEPS * seconds / 3600
        every = hours * PAPER_RUNS * len(PAPER_ROBOTS)
        energy = f"{WATTS * every / 1000:,.1f}"
        lines.append([name, f"{seconds:.3f}", f"{hours:,.0f}", f"{every:,.0f}", f"{every / CLUSTER:,.0f}", energy])
    of_one, of_many = "25 runs, hours on one thread", f"hours on {CLUSTER} threads"
    header = ["agent", "a step, s", "a run, hours", of_one, of_many, "25 runs, kWh"]
    return table(header, lines)


def held_out(runs: Sequence[Run]) -> str:
    """What was chosen by held-out train dynamics: the last validation return of each value tried."""
    lines = []
    for group in grouped(runs):
        ends = (group.ends(name) for name in ("validation_return", "validation_loss"))
        means = [mean_estimate(values) if values else None for values in ends]
        whole = [sum(curve.values()) / len(curve) for curve in group.curves("validation_return")]
        overall = mean_estimate(whole) if whole else None
        lines.append(
            [escape(group.label), group.robot, *(_estimate_text(one) for one in (means[0], overall, means[1]))]
        )
    header = ["agent", "robot", "return at the end", "return, mean over the curve", "loss at the end"]
    return table(header, lines)


def noise(runs: Sequence[Run]) -> str:
    """How far test scores lie apart within a run, over its later evaluations, and between runs, at their ends.

    A line an agent, a column a robot: the mean over runs of the standard deviation over all evaluations of a run but
    its first, and behind it the standard deviation over the runs' last ones.
    """
    cells: dict[str, dict[str, str]] = {}
    for group in grouped(runs):
        curves, ends = group.curves("test_score"), group.ends("test_score")
        if len(ends) > 1 and len(curves[0]) >= LATER + 1:
            within = statistics.fmean(statistics.stdev([*curve.values()][1:]) for curve in curves)
            name = NAMES.get(group.runs[0].about["agent"], group.label)
            cells.setdefault(name, {})[group.robot] = f"{within:.1f} / {statistics.stdev(ends):.1f}"
    lines = [[escape(name), *(own.get(robot, "–") for robot in ids.ROBOTS)] for name, own in cells.items()]
    return table(["within a run / between runs", *ids.ROBOTS], lines) if lines else ""


LATER: Final = 4
"""Evaluations behind the first, at least, that a deviation within a run is taken of."""


def learning(records: Sequence[Mapping[str, Any]]) -> str:
    """Mean returns in train dynamics over runs, beside those of the untrained agents and of random actions."""
    groups: dict[tuple[str, str, int, int], list[Mapping[str, Any]]] = {}
    for record in records:
        key = record["agent"], record["robot"], record["gradient_steps"], len(record["dynamics"])
        groups.setdefault(key, []).append(record)
    lines = []
    for (agent, robot, steps, dynamics), own in groups.items():
        means = [mean_estimate([statistics.fmean(record[what]) for record in own]) for what in COMPARED]
        runs = [f"{len(own)}", f"{steps:,}", f"{dynamics}"]
        lines.append([NAMES.get(agent, escape(agent)), robot, *runs, *(_estimate_text(one) for one in means)])
    return table(["agent", "robot", "runs", "gradient steps", "train dynamics", *COMPARED], lines)


def mean_curves(runs: Sequence[Run], name: str) -> dict[str, dict[float, float]]:
    """Label of a group, with its robot where there are several → steps → the mean over its runs of one curve."""
    found: dict[str, dict[float, float]] = {}
    groups = grouped(runs)
    several = len({group.robot for group in groups}) > 1
    for group in groups:
        if curves := group.curves(name):
            label = f"{group.robot}, {group.label}" if several else group.label
            found[label] = {step: statistics.fmean(curve[step] for curve in curves) for step in curves[0]}
    return found


def by_steps(curves: Mapping[str, Mapping[float, float]], form: str = ".1f", of: str = "steps") -> str:
    """Curves, a line each, a column for each number `of` steps, or of something else, that one of them has."""
    steps = sorted({step for curve in curves.values() for step in curve})
    lines = [
        [escape(name), *(f"{curve[step]:{form}}" if step in curve else "–" for step in steps)]
        for name, curve in curves.items()
    ]
    return table([of, *(f"{step:,.12g}" for step in steps)], lines)


def compute(times: Mapping[str, float], published: str) -> str:
    """Seconds of each agent, and beside DADT's."""
    lines = [[name, f"{value:.3f}", f"{value / times['dadt']:.2f}"] for name, value in times.items()]
    return table(["agent", published, "beside DADT's"], lines)


def _final_texts(found: Scores) -> list[str]:
    """A cell for each robot: the mean over runs of their means over dynamics, and how many runs."""
    cells = []
    for robot in ids.ROBOTS:
        own = found[robot].mean(axis=1).tolist() if robot in found else []
        cells.append(f"{final_text(mean_estimate(own))} ({len(own)} run{'s' * (len(own) != 1)})" if own else "–")
    return cells


def _published(score: Score | None, unknown: str = "–") -> str:
    if score is None:
        return unknown
    return f"{score.mean:.2f} ± {score.std:.2f}"


def _estimate_text(value: MeanEstimate | None) -> str:
    return "–" if value is None else final_text(value)


def _evidence(one: Comparison) -> str:
    if one.estimate is None:
        return f"{one.what}: not run"
    text = f"{one.what}: {one.estimate.value:.2f}"
    if one.estimate.interval is not None:
        text += " [{:.2f}, {:.2f}]".format(*one.estimate.interval)
    robots, at_least = ", ".join(one.robots), ""
    if len(one.each) > 1:
        robots = ", ".join(f"{robot} {own.value:.2f}" for robot, own in zip(one.robots, one.each, strict=True))
        at_least = "at least "  # it is the number on the robot with fewest
    runs = f"{one.runs[0]} {'and' if one.chance is None else 'to'} {one.runs[1]} runs"
    if one.runs[0] == one.runs[1]:
        runs = f"{one.runs[0]} run{'s' * (one.runs[0] != 1)} each"
    if one.chance is not None:
        text += f", as wide by chance p {f'= {one.chance:.3f}' if one.chance >= 0.001 else '< 0.001'}"
    return f"{text} ({robots}; {at_least}{runs})"
