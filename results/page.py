"""docs/results.md: what was run, at what budget, and what it says of the paper's tables, figures and claims.

What is here: `pages`, the text of the page and of its drawings. Called by the command line. It must not compute scores.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from agents.run_folder import ADAPTATION_CURVE, TARGET_CURVE
from agents.summary.runs import Run, grouped
from dynagen_bench import ids
from dynagen_bench.datasets.scores import reference_scores
from dynagen_bench.envs import HORIZON
from leaderboard.board import BOARD
from leaderboard.entries import Entry, read_entries
from results import tables
from results.claims import PREDICTORS, claims, final_scores
from results.figures import Drawing, error_bars, learning_curves
from results.kept import (
    FOLDER,
    REFERENCE,
    Errors,
    beside_reference,
    check_seeds,
    compute_times,
    held_out_curves,
    kept_errors,
    kept_learning,
    kept_runs,
    kept_scores,
)

PAGE: Final = "results.md"

DRAWINGS: Final = "results"
"""Folder of the page's drawings, beside it."""

CHOSEN: Final = {
    "learning-rate": "The learning rate of the transformers and its schedule",
    "adaptation": "The runs whose adaptation is measured below",
    "target-return": "The runs that are asked for several returns below, while they train for the paper's 3,000",
}
"""Group of kept runs that hold out train dynamics → what was chosen by them."""

EARLY: Final = "first-steps"
"""Group of kept runs of few steps, often evaluated."""

CURVES: Final = {
    ADAPTATION_CURVE: ("steps of fine-tuning on ten episodes", "steps"),
    TARGET_CURVE: ("the return that is asked for", "asked for"),
}
"""Curve in held-out train dynamics → what its points are at, in words and in the head of its table."""

VARIED: Final = {"low-quality": "agent", "next-state-weight": "next_state_weight"}
"""Group of kept runs, of the paper's Figure 5 and Table 4 → what differs in it."""

ACTS_AS_DT: Final = "dt_plus"
"""Acts by the frozen parameters of a DT: a curve of its own would be DT's, and a flat line on."""

TITLES: Final = {"low-quality": "On low-quality data", "next-state-weight": "By the weight of the next state's error"}
"""The same groups → what they are called in the list of what was run."""

INTRODUCTION: Final = """\
# Reference results

Made by `python -m results build` from the board's replayed entries ([LEADERBOARD.md](../leaderboard/LEADERBOARD.md);
others do not count here) and from the kept runs in [results/runs](../results/runs); changes by hand are lost.

Ours are means over runs ± their sample standard deviation, the paper's its own. The paper's dynamics are other draws,
its behaviour policies others, and its budget a million gradient steps: orderings can be compared, values cannot, and at
the small budgets here ([what was run](#what-was-run)) an ordering may still turn. Robots without a number have not been
run; a “?” is a number of the paper's that we could not read. Every number is of the last checkpoint; the paper reports
the best one on the test dynamics.
"""

CLAIMS: Final = """\
## The paper's claims

The number is the probability that a run of the one is better than a run of the other in the same test dynamics, with a
95 % interval over runs ([statistics.md](statistics.md)); where there are several robots, the number of each stands
behind. A claim *holds* if the interval lies above one half for all of its comparisons, and *does not hold* if it lies
below for one of them. It is *undecided* in between, if one of the two has fewer than three runs, or if the interval of
one robot alone lies on the other side of one half. Where all runs of the one are above all of the other in every
dynamics, the interval has no width: that says more of how few runs there are than of how sure it is. How often two
equal agents get a verdict: [statistics.md](statistics.md).

That λ hardly matters is a claim about several values at once, and has a rule of its own. Its number is the distance
between the best and the worst mean score. The claim *does not hold* if fewer than 5 % of random reassignments of the
runs to the values of λ give a distance at least as large. Otherwise it *holds* if the upper end of the distance's
interval is below 10 points; with fewer than three runs of a value it is *undecided*.

The last line is ours. That an agent may infer a body's dynamics from the episode so far is what the paper's agents and
this benchmark rest on: it compares two that clone the same data, one with the episode so far and one without. They
differ in the timestep and the net, too: a difference is a sign, and no proof, of what seeing the episode is worth.
"""

ZERO_SHOT: Final = """\
## Scores without adaptation

The counterpart of the paper's Tables 1, 2 and 7. FOCAL infers the dynamics from the episode so far; its authors give it
data of the test task, which here is adaptation. What the paper gave it is not said. MLP-BC is not the paper's: a
control that clones the data by the present state alone.
"""

ADAPTED: Final = """\
## Scores after adaptation

The counterpart of the paper's Tables 1 and 7. FOCAL takes no gradient step: it is given the episodes that the others
are fine-tuned on. The others' steps differ, as [LEADERBOARD.md](../leaderboard/LEADERBOARD.md) says of each entry, and
only DADT's were looked at in held-out dynamics, of Hopper: these are numbers of unequal effort.
"""

TARGETS: Final = """\
DADT and DT are asked for a return: the paper's Table 6 has 1,000, and 3,000 for HalfCheetah, which no episode of our
data returns; there it was [chosen anew](#how-hyperparameters-were-chosen). The targets of the runs here, and in
brackets the highest return of an episode in our data"""

LOW_QUALITY: Final = """\
## Low-quality data

The counterpart of the paper's Figure 5, which gives no numbers, and has FOCAL and MerPO beside DADT, and scores after
adaptation too: here are scores without adaptation, at the last checkpoint, of the transformers trained on the worst
30 % of the episodes.
"""

WEIGHTS: Final = """\
## The weight of the next state's error

The counterpart of the paper's Table 4: scores of DADT without adaptation at the last checkpoint, by λ. The runs at
0.05, the default, are the reference runs.
"""

ERRORS: Final = """\
## Next-state errors

The counterpart of the paper's Table 3 and Figure 4: mean square error of the normalised next state, one step ahead, in
windows of K steps that tile 200 episodes of each test dynamics; the mean over its elements, steps and dynamics. The
paper names neither its units nor its horizon. MLP, LSTM and CaDM predict the change of the state, as CaDM's own code
does; DADT and DT+ the next state itself, as the paper says.
"""

LEARNING: Final = """\
## What is learned at this budget

Mean return of the last checkpoints in train dynamics, of the same agents before their first step, and of random
actions, in the same ten episodes of each (`python -m agents.evaluate`).
"""

NOISE: Final = """\
## How far a score moves within a run

A run goes on moving after its losses have settled, and its last checkpoint is one point on that way. Here is the
standard deviation of the test score over a run's later evaluations, the mean over runs, and behind the stroke that of
the last checkpoints between runs, which is what stands behind ± above. Where the two are alike, ± tells how single
checkpoints scatter, and hardly how seeds differ: the score of one run may be another a thousand steps later.
"""

FIRST_STEPS: Final = """\
## The first thousand steps

Agents as those of the board, but of one run each, and trained in 16 of the 20 train dynamics. The choice of 5,000 steps
below looked at no fewer than 1,000, and these runs were made after it. The mean score of the three on Hopper is 52
after 200 steps, above what the board's have at 5,000 (39 to 45), and in the dynamics that were held out the return is
no higher later either; on Ant it is 33 after 100 and 35 after 1,000 (37 to 40); on SlimHumanoid 31 after 600 (31 to
34); on Walker 43 after 600 (49 to 54); on HalfCheetah it keeps rising, 24 after 1,000 (30 to 36). So much of a score at
this budget is there after a few hundred steps, and who compares agents here should show their curves from the first
steps.
"""

CHOICES: Final = """\
## How hyperparameters were chosen

By train dynamics that the runs held out (`--hold-out 4`), never by test dynamics, and on Hopper alone but for the
target return: the other robots have what was chosen there. DADT, DT and Transformer-BC have the learning rate 0.001,
constant as in the paper, and 5,000 steps: beyond some 3,000 the loss in held-out dynamics rises again at that rate, and
the return there does not. That on Hopper it is as high after a few hundred steps was seen
[later](#the-first-thousand-steps). MLP-BC has the same, for which nothing was tried. On HalfCheetah DADT and DT are
asked for 1,500, at which the mean of the two is highest: 443, and 300 at the paper's 3,000. These are one run each, so
that neighbours differ by chance too. Half of the train dynamics have an episode that returns as much.
"""

COMPUTE: Final = """\
## Compute

The counterpart of the paper's Figure 3, from one run of `python -m pytest tests/benchmarks/test_compute.py
--benchmark-only` on one thread of a processor, with each agent's own defaults; the paper's is of a GPU and says “about
6x less time” of DADT beside FOCAL and MerPO.
"""


COST: Final = """\
A million gradient steps, the paper's budget, five runs on each of the five robots, would take by these times what
follows; MerPO has half of the steps in each of its phases. The 25 runs of an agent are independent jobs
([sweeps.md](sweeps.md)). On one GPU, an RTX 2080 Ti, the paper's authors report at most 8 hours for a run of DADT,
which is 200 for 25, and 50 kWh at its rated 250 W. Energy here is that of the processor alone, one core
at its share of the rated power (360 W for 96 cores): an estimate, no measurement.
"""


RUN: Final = """\
## What was run

Means over the seeds of a line. The wall clock is that of one thread on a machine that did other things too; the energy
is estimated from it as above.
"""


def pages(board: Path = BOARD, folder: Path = FOLDER) -> dict[str, str]:
    """Name of a file in docs/ → its text; the same for the same entries and kept runs.

    Raises:
        FileNotFoundError: there is no board.
        ValueError: an entry, or a kept run, is not what was written.
    """
    entries, errors, runs = read_entries(board), kept_errors(folder=folder), kept_runs(REFERENCE, folder)
    own = {group: kept_runs(group, folder) for group in VARIED}
    varied = {group: beside_reference(own[group], runs, fact) for group, fact in VARIED.items()}
    for group, of, fact in ((REFERENCE, runs, "agent"), *((group, varied[group], VARIED[group]) for group in VARIED)):
        check_seeds(group, of, fact)
    low, weights = kept_scores("low-quality", folder), final_scores(varied["next-state-weight"], "next_state_weight")
    figures = {name: one for robot in ids.ROBOTS for name, one in _figures(robot, runs, errors).items()}
    parts = [
        INTRODUCTION,
        CLAIMS,
        tables.verdicts(claims(entries, errors, low, weights)),
        *_scores(entries, runs),
        *_pictures(figures, "curves"),
        *([LOW_QUALITY, tables.low_quality(low, entries)] if low else []),
        *([WEIGHTS, tables.weights(weights)] if weights else []),
        ERRORS,
        tables.errors(errors),
        *_pictures(figures, "errors"),
        *([NOISE, noise] if (noise := tables.noise(runs)) else []),
        *_learning(folder),
        *_first_steps(folder),
        *_choices(folder),
        *_compute(folder),
        RUN,
        tables.training(runs),
        *(part for group, of in own.items() if of for part in (f"{TITLES[group]}:", tables.training(of))),
    ]
    text = "\n\n".join(part.strip("\n") for part in parts) + "\n"
    return {PAGE: text, **{name: drawing.svg for name, drawing in figures.items()}}


def _scores(entries: Sequence[Entry], runs: Sequence[Run]) -> list[str]:
    return [
        ZERO_SHOT,
        *_targets(runs),
        tables.scores(entries, "zero-shot"),
        ADAPTED,
        tables.scores(entries, "adaptation"),
    ]


def _targets(runs: Sequence[Run]) -> list[str]:
    """What the runs are asked for, those that are, beside what the data have shown."""
    asked = {(run.facts["robot"], run.facts["target_return"]) for run in runs if "target_return" in run.facts}
    told = []
    for robot in ids.ROBOTS:
        if own := sorted(target for other, target in asked if other == robot):
            best = max(one.max for one in reference_scores(robot).values())
            told.append(f"{robot} {' and '.join(f'{target:,.0f}' for target in own)} ({best:,.0f})")
    return [f"{TARGETS}: {', '.join(told)}.\n"] if told else []


def _learning(folder: Path) -> list[str]:
    records = kept_learning(folder=folder)
    return [LEARNING, tables.learning(records)] if records else []


def _figures(robot: str, runs: Sequence[Run], errors: Sequence[Errors]) -> dict[str, Drawing]:
    """File → drawing, of a robot that there are runs of."""
    found = {}
    groups = [group for group in grouped(runs) if group.robot == robot and group.runs[0].about["agent"] != ACTS_AS_DT]
    curves = {group.label: scores for group in groups if (scores := group.curves("test_score"))}
    if curves:
        found[f"{DRAWINGS}/{robot.lower()}-curves.svg"] = learning_curves(robot, curves)
    own = {name: tables.error_estimates(errors, agent).get(robot) for agent, name in PREDICTORS.items()}
    measured = {name: value for name, value in own.items() if value is not None}
    if measured:
        unchanged = next((one.unchanged for one in errors if one.robot == robot and one.unchanged is not None), None)
        found[f"{DRAWINGS}/{robot.lower()}-errors.svg"] = error_bars(robot, measured, unchanged)
    return found


def _pictures(figures: Mapping[str, Drawing], kind: str) -> list[str]:
    return [f"![{one.title}]({name})\n" for name, one in figures.items() if name.endswith(f"-{kind}.svg")]


def _first_steps(folder: Path) -> list[str]:
    runs = kept_runs(EARLY, folder)
    if not runs:
        return []
    parts = [FIRST_STEPS]
    for words, name in (("Return in held-out train dynamics", "validation_return"), ("Score", "test_score")):
        parts += [f"{words} by gradient steps:\n", tables.by_steps(tables.mean_curves(runs, name))]
    return parts


def _choices(folder: Path) -> list[str]:
    parts = []
    for group, what in CHOSEN.items():
        runs = kept_runs(group, folder)
        if runs:
            parts += [f"{what}:\n", tables.held_out(runs)]
            parts += ["Return by gradient steps, mean over seeds:\n"]
            parts += [tables.by_steps(tables.mean_curves(runs, "validation_return"))]
            parts += ["Loss by gradient steps, mean over seeds:\n"]
            parts += [tables.by_steps(tables.mean_curves(runs, "validation_loss"), ".4f")]
        for name, (words, of) in CURVES.items():
            if curves := held_out_curves(group, name, folder):
                parts += [f"Mean return by {words}:\n", tables.by_steps(curves, of=of)]
    return [CHOICES, *parts] if parts else []


def _compute(folder: Path) -> list[str]:
    times = compute_times(folder)
    if not times:
        return []
    step, acting = times["test_gradient_steps"], times["test_acting_in_ten_episodes"]
    whole = {name: HORIZON * seconds for name, seconds in acting.items()}
    found = [tables.compute(step, "a gradient step, s"), tables.compute(whole, f"{HORIZON} steps of 10 episodes, s")]
    return [COMPUTE, *found, COST, tables.cost(step)]
