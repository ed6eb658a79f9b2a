"""What the scores of a few runs say, and how sure that is: aggregates with intervals, and ranks that share.

What is here: interquartile mean, optimality gap, probability of improvement and performance profile, each with a
bootstrap interval, `ranks`, `near_best`, and the bootstrap's `draws`. Called by `standings`, `comparison`, `published`,
the site and the reference results. It must not know entries, files or how numbers look.

The measures are those of Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice* (2021).
A score is a number of one run in one dynamics. `Scores` holds them by robot, as (R, M) float64 arrays: R runs, M test
dynamics, on the robot's official scale.

The bootstrap is stratified: runs are drawn with replacement in each robot by itself. What is drawn is a whole run, with
its M dynamics: they were one training and rise and fall together, and drawn apart they would make the interval too
narrow (docs/statistics.md has the measured coverage). With M = 1 it is the paper's bootstrap.

The same scores give the same bytes: the draws come from the raw stream of PCG64, which NumPy keeps the same in every
release, with a fixed seed; and sums are either of whole numbers or in a fixed order.
"""

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Scores: TypeAlias = Mapping[str, NDArray[np.float64]]
"""Robot → (R, M) scores; R may differ between robots."""

RESAMPLES: Final = 5000
"""An end of an interval is then known to about a thirtieth of the interval's width."""

CONFIDENCE: Final = 0.95

GOAL: Final = 100.0
"""The score that the optimality gap is measured from: the best return of the test dynamics' data."""

THRESHOLDS: Final = tuple(range(0, 101, 2))
"""The scores at which a performance profile is taken."""

_TAILS: Final = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)

_SEED: Final = 20220


class Estimate(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    interval: tuple[float, float] | None
    """Low and high; None where some robot has a single run, which says nothing of how much runs differ."""


class Rank(NamedTuple):
    """The ranks that an entry may have, given the intervals of all."""

    best: int
    """1 + the number of entries whose interval lies wholly above."""
    worst: int
    """The number of ranked entries − those whose interval lies wholly below."""


def interquartile_mean(scores: Scores) -> Estimate:
    """The mean of the middle half of all scores; of n, ⌊n/4⌋ are left out at either end, as by `scipy.stats.trim_mean`.

    Raises:
        ValueError: no scores.
    """
    pooled = np.concatenate([values.ravel() for values in _checked(scores).values()])
    samples: NDArray[np.float64] | None = None
    if _enough(scores):
        drawn = [values[draws(robot, len(values))] for robot, values in scores.items()]
        samples = _middle_mean(np.concatenate([values.reshape(RESAMPLES, -1) for values in drawn], axis=1))
    return _estimate(float(_middle_mean(pooled[None])[0]), samples)


def optimality_gap(scores: Scores) -> Estimate:
    """How far scores stay below `GOAL` in the mean; what is above it counts as `GOAL`. Less is better.

    Raises:
        ValueError: no scores.
    """
    count = sum(values.size for values in _checked(scores).values())
    below = {robot: _ordered_sum(GOAL - np.minimum(values, GOAL).T) for robot, values in scores.items()}  # (R,)
    samples = None
    if _enough(scores):
        samples = _ordered_sum(
            column for robot, values in below.items() for column in values[draws(robot, len(values))].T
        )
        samples /= count
    return _estimate(float(_ordered_sum(value for values in below.values() for value in values)) / count, samples)


def profile(scores: Scores) -> list[Estimate]:
    """For each of `THRESHOLDS`, the fraction of scores above it; intervals are pointwise.

    Raises:
        ValueError: no scores.
    """
    count = sum(values.size for values in _checked(scores).values())
    levels = np.array(THRESHOLDS, dtype=np.float64)
    above = {robot: (values[:, :, None] > levels).sum(axis=1, dtype=np.float64) for robot, values in scores.items()}
    found = np.asarray(sum(values.sum(axis=0) for values in above.values())) / count
    if not _enough(scores):
        return [Estimate(value, None) for value in found.tolist()]
    # products of whole numbers: exact in any order; for such small ones BLAS's threads cost more than they give
    samples = (
        sum(np.einsum("nr,rt->nt", _counts(robot, len(values)), values) for robot, values in above.items()) / count
    )
    ends = np.quantile(samples, _TAILS, axis=0).T.tolist()
    return [Estimate(value, (low, high)) for value, (low, high) in zip(found.tolist(), ends, strict=True)]


def improvement(scores: Scores, other: Scores) -> Estimate | None:
    """The probability that a run of `scores` is better than one of `other`, in a dynamics that both have.

    In each dynamics it is the part of all pairs of runs in which the first is higher, a tie counting one half (the
    Mann-Whitney U over the number of pairs); the mean over the dynamics of the robots that both have. None where they
    have no robot in common.
    """
    robots = [robot for robot in scores if robot in other]
    if not robots:
        return None
    shared, others = ({robot: side[robot] for robot in robots} for side in (scores, other))
    tasks = sum(values.shape[1] for values in shared.values())
    value = 0.0
    samples = np.zeros(RESAMPLES)
    sure = _enough(shared) and _enough(others)
    for robot in robots:
        first, second = shared[robot], others[robot]
        wins = _wins(first, second)  # (R, R'), whole and half numbers: exact in any order
        pairs = len(first) * len(second) * tasks
        value += float(wins.sum()) / pairs
        if sure:
            drawn = np.einsum("nr,rs->ns", _counts(robot, len(first)), wins)
            samples += np.einsum("ns,ns->n", drawn, _counts(robot, len(second), side=1)) / pairs
    return _estimate(value, samples if sure else None)


def ranks(intervals: Sequence[tuple[float, float] | None]) -> list[Rank | None]:
    """The ranks of entries by their intervals, the highest first; None for an entry without one.

    Overlap is no equivalence (A may overlap B, and B overlap C, where A lies above C), so an entry gets a range of
    ranks: from 1 + the entries wholly above it, to all − the entries wholly below it. Then, for any two entries:
    intervals that overlap or touch share at least two ranks; of intervals that do not, the upper has both the better
    best and the better worst rank.
    """
    ranked = [interval for interval in intervals if interval is not None]
    found: list[Rank | None] = []
    for interval in intervals:
        if interval is None:
            found.append(None)
            continue
        above = sum(low > interval[1] for low, _ in ranked)
        below = sum(high < interval[0] for _, high in ranked)
        found.append(Rank(1 + above, len(ranked) - below))
    return found


def near_best(column: Iterable[tuple[float, float | None]]) -> float:
    """The least mean of a column that is near its best: within one standard deviation, the best one's own.

    It is the paper's rule of what is bold.

    Args:
        column: (mean, standard deviation) of each; the latter None of a single run, near which nothing else is. Of an
            empty column it is infinity.
    """
    mean, std = max(column, key=lambda one: one[0], default=(math.inf, None))
    return mean - (std or 0.0)


def _checked(scores: Scores) -> Scores:
    if not scores or any(values.ndim != 2 or values.size == 0 for values in scores.values()):
        shapes = {robot: values.shape for robot, values in scores.items()}
        raise ValueError(f"scores have the shapes {shapes}: give (runs, dynamics), at least one of each, of some robot")
    return scores


def _enough(scores: Scores) -> bool:
    """Whether every robot has runs to compare."""
    return all(len(values) > 1 for values in scores.values())


def _estimate(value: float, samples: NDArray[np.float64] | None) -> Estimate:
    """A value with the middle 95 % of its resamples."""
    if samples is None:
        return Estimate(value, None)
    low, high = np.quantile(samples, _TAILS).tolist()
    return Estimate(value, (low, high))


@functools.lru_cache(maxsize=64)
def draws(robot: str, runs: int, side: int = 0) -> NDArray[np.intp]:
    """(RESAMPLES, runs) numbers of runs, drawn with replacement; another stream for each robot and side."""
    stream = np.random.PCG64(np.random.SeedSequence([_SEED, side, *robot.encode()]))
    raw = stream.random_raw(RESAMPLES * runs).reshape(RESAMPLES, runs)
    return np.asarray(((raw >> np.uint64(32)) * np.uint64(runs)) >> np.uint64(32), dtype=np.intp)


@functools.lru_cache(maxsize=64)
def _counts(robot: str, runs: int, side: int = 0) -> NDArray[np.float64]:
    """(RESAMPLES, runs): how often each run was drawn, whole numbers."""
    drawn = draws(robot, runs, side)
    return np.stack([(drawn == run).sum(axis=1, dtype=np.float64) for run in range(runs)], axis=1)


def _wins(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """(R, R'): in how many dynamics each run of the first is above each of the second, ties counting one half."""
    one, two = first[:, None], second[None]
    return np.asarray((one > two).sum(axis=2) + 0.5 * (one == two).sum(axis=2))


def _middle_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Over the last axis of (N, n): the mean without the ⌊n/4⌋ lowest and highest."""
    n = values.shape[1]
    middle = np.sort(values, axis=1)[:, n // 4 : n - n // 4]
    return np.asarray(_ordered_sum(middle.T) / middle.shape[1])


def _ordered_sum(values: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """One after the other, so that every processor rounds alike; NumPy's own sum takes an order of its own."""
    total, *rest = values
    total = total.copy()
    for value in rest:
        total = total + value
    return np.asarray(total)
