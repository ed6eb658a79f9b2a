"""What the paper claims, and whether it holds here: a line each, with the evidence.

What is here: `claims`. Called by the page. It must not know how a page looks.

A claim that methods are better than others is what comparisons of two say (`leaderboard.comparison`).

That λ makes no difference is the one claim of several methods at once. The best and the worst of them are chosen by the
scores that would then tell them apart: so the distance between their means is compared with those after dealing the
runs out to the values of λ at random, and its interval chooses best and worst anew in each resample.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from agents.summary.runs import Run
from dynagen_bench import ids
from leaderboard.comparison import FEWEST, Comparison, Verdict, compared
from leaderboard.entries import Entry
from leaderboard.standings import task_scores
from leaderboard.statistics import Estimate, Scores, draws
from results.kept import Errors

CLOSE: Final = 10.0
"""Methods are told to do the same where their means lie less than this many points of score apart, for sure."""

SIGNIFICANT: Final = 0.05
"""Level of the permutation test."""

PERMUTATIONS: Final = 10_000


class Claim(NamedTuple):
    """A sentence of the paper, and what it comes to here."""

    text: str
    source: str
    """Table or section of the paper."""
    verdict: Verdict
    evidence: tuple[Comparison, ...]


def claims(
    entries: Sequence[Entry], errors: Sequence[Errors], low: Mapping[str, Scores], weights: Mapping[str, Scores]
) -> list[Claim]:
    """All of them, in the paper's order, and what they take for granted.

    Args:
        entries: of the board; what was not replayed is no evidence.
        errors: next-state errors of kept runs.
        low: agent → scores by robot of those trained on low-quality data.
        weights: λ → scores of DADT by robot.
    """
    scores = replayed_scores(entries)
    zero = {name: scores.get(f"{slug}-zero-shot-last") for name, slug in SLUGS.items()}
    adapted = {name: scores.get(f"{slug}-adaptation-last") for name, slug in SLUGS.items()}
    poor = {name: low.get(agent) for agent, name in NAMES.items()}
    error = error_scores(errors)
    return [
        _all("DADT acts best without adaptation", "Tables 1, 7", *(_than(zero, "DADT", name) for name in _BASELINES)),
        _all(
            "DADT acts best after adaptation",
            "Tables 1, 7",
            *(_than(adapted, "DADT", name) for name in _BASELINES if name != "FOCAL"),  # the paper does not adapt it
        ),
        _all(
            "DADT without adaptation is above adapted baselines",
            "Section 5.2",
            compared("DADT > MerPO, adapted", zero["DADT"], adapted["MerPO"]),
        ),
        _all(
            "Fine-tuning DADT for a dynamics makes it act better there",
            "Table 1, but for SlimHumanoid",
            compared("DADT, adapted > DADT", adapted["DADT"], zero["DADT"]),
        ),
        _all("Predicting next states makes a Decision Transformer act better", "Table 2", _than(zero, "DADT", "DT")),
        _all(
            "Conditioning on returns acts better than cloning",
            "Table 2",
            _than(zero, "DT", "Transformer-BC"),
            _than(zero, "DADT", "Transformer-BC"),
        ),
        _all(
            "Joint training predicts next states better than a head on a frozen DT",
            "Table 3",
            _than(error, "DADT", "DT+"),
        ),
        _all(
            "A transformer predicts next states best",
            "Figure 4",
            *(_than(error, "DADT", name) for name in ("MLP", "LSTM", "CaDM")),
        ),
        _all(
            "On low-quality data, too, DADT acts better than DT and Transformer-BC",
            "after Figure 5",
            *(_than(poor, "DADT", name) for name in ("DT", "Transformer-BC")),
        ),
        _robust(weights),
        _all(
            "Cloning with the episode so far acts better than by the present state alone",
            "not the paper's: a control",
            _than(zero, "Transformer-BC", "MLP-BC"),
        ),
    ]


SLUGS: Final = {
    "FOCAL": "focal",
    "MerPO": "merpo",
    "Trajectory Transformer": "trajectory-transformer",
    "MLP-BC": "mlp-bc",
    "Transformer-BC": "transformer-bc",
    "DT": "dt",
    "DADT": "dadt",
}
"""Name in the paper → how the board calls our entry of it; the paper has no MLP-BC."""

NAMES: Final = {slug.replace("-", "_"): name for name, slug in SLUGS.items()}
"""Name in `AGENTS` → the same name."""

PREDICTORS: Final = {"dt_plus": "DT+", "dadt": "DADT", "mlp": "MLP", "lstm": "LSTM", "cadm": "CaDM"}
"""What predicts next states → its name in the paper."""

_BASELINES: Final = ("FOCAL", "MerPO", "Trajectory Transformer")


def replayed_scores(entries: Sequence[Entry]) -> dict[str, Scores]:
    """Name on the board → scores, of the entries that were replayed: others are no evidence."""
    return {entry.slug: task_scores(entry.submission) for entry in entries if entry.replayed}


def final_scores(runs: Sequence[Run], fact: str) -> dict[str, Scores]:
    """Value of a fact → the last test scores of the runs that have it, (R, 1) by robot."""
    found: dict[str, dict[str, list[float]]] = {}
    for run in runs:
        curve = run.curves.get("test_score")
        if curve and fact in run.facts:
            found.setdefault(str(run.facts[fact]), {}).setdefault(run.facts["robot"], []).append(curve[max(curve)])
    return {value: {robot: np.array(of)[:, None] for robot, of in robots.items()} for value, robots in found.items()}


def error_scores(errors: Sequence[Errors]) -> dict[str, Scores]:
    """Name in the paper → its errors by robot, negative: more is better."""
    return {
        name: {one.robot: -one.values for one in errors if one.agent == agent} for agent, name in PREDICTORS.items()
    }


def _than(scores: Mapping[str, Scores | None], name: str, other: str) -> Comparison:
    return compared(f"{name} > {other}", scores.get(name), scores.get(other))


def _all(text: str, source: str, *evidence: Comparison) -> Claim:
    """A claim that holds where all of its comparisons do, and does not where one does not."""
    found = {one.verdict for one in evidence}
    order: tuple[Verdict, ...] = ("does not hold", "not run", "undecided", "holds")
    return Claim(text, source, next(verdict for verdict in order if verdict in found), evidence)


def _robust(weights: Mapping[str, Scores]) -> Claim:
    """λ makes no difference: its values' means lie no further apart than by chance, and less than `CLOSE`."""
    text, source = "The weight of the next state's error hardly matters", "Table 4"
    robots = [robot for robot in ids.ROBOTS if weights and all(robot in scores for scores in weights.values())]
    shared = {value: {robot: scores[robot] for robot in robots} for value, scores in weights.items()}
    if len(shared) < 2 or not robots:
        return Claim(text, source, "not run", (Comparison("best λ − worst λ", None, (), (0, 0), ()),))
    means = {value: float(np.mean([of.mean() for of in scores.values()])) for value, scores in shared.items()}
    best, worst = (end(means, key=lambda value: means[value]) for end in (max, min))
    counts = [len(of) for scores in shared.values() for of in scores.values()]
    fewest, most = min(counts), max(counts)
    chance = spread_by_chance(shared)
    low, high = spread_interval(shared)
    interval = (low, high) if fewest > 1 else None  # of one run it is not known how far another would lie
    what = f"best − worst of {len(shared)} values of λ ({best}, {worst}), points"
    distance = Estimate(means[best] - means[worst], interval)
    spread = Comparison(what, distance, tuple(robots), (fewest, most), (), chance)
    verdict: Verdict = "undecided"
    if fewest >= FEWEST:
        verdict = "does not hold" if chance < SIGNIFICANT else "holds" if high < CLOSE else "undecided"
    return Claim(text, source, verdict, (spread,))


def spread_interval(groups: Mapping[str, Scores]) -> tuple[float, float]:
    """The middle 95 % of the distance between the best and the worst mean, best and worst of each resample of runs.

    Args:
        groups: name → robot → (R, M) scores, of the same robots; R may differ.
    """
    means = []
    for number, scores in enumerate(groups.values()):
        resampled = [of.mean(axis=1)[draws(robot, len(of), number)].mean(axis=1) for robot, of in scores.items()]
        means.append(np.mean(resampled, axis=0))  # (RESAMPLES,)
    spread = np.max(means, axis=0) - np.min(means, axis=0)
    low, high = np.quantile(spread, (0.025, 0.975)).tolist()
    return low, high


def spread_by_chance(groups: Mapping[str, Scores]) -> float:
    """The p-value of a permutation test that all groups of runs score alike.

    Between the best and the worst group lies some distance even where nothing differs, and more of it the more groups
    there are. It is compared with what it is when the runs of each robot are dealt out to the groups anew: the part of
    `PERMUTATIONS` deals, the given one among them, with a distance as large.

    Args:
        groups: name → robot → (R, M) scores, of the same robots; R may differ.
    """
    robots = list(next(iter(groups.values())))
    deals = np.zeros((PERMUTATIONS, len(groups)))
    for robot in robots:
        sizes = [len(scores[robot]) for scores in groups.values()]
        runs = np.concatenate([scores[robot].mean(axis=1) for scores in groups.values()])
        raw = np.random.PCG64(np.random.SeedSequence([*robot.encode()])).random_raw(PERMUTATIONS * len(runs))
        order = raw.reshape(PERMUTATIONS, len(runs)).argsort(axis=1)
        order[0] = np.arange(len(runs))
        parts = np.split(runs[order], np.cumsum(sizes)[:-1], axis=1)
        deals += np.stack([part.mean(axis=1) for part in parts], axis=1) / len(robots)
    spread = deals.max(axis=1) - deals.min(axis=1)
    return float((spread >= spread[0] - 1e-9).mean())  # sums of the same runs in another order may differ in a bit
