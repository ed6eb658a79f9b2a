"""Aggregates, intervals and ranks, against values computed by hand, by SciPy and by going through every resample."""

import itertools

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from leaderboard.statistics import (
    RESAMPLES,
    THRESHOLDS,
    Rank,
    improvement,
    interquartile_mean,
    near_best,
    optimality_gap,
    profile,
    ranks,
)

BY_HAND = {"a": np.array([[10.0, 90.0], [20.0, 80.0]]), "b": np.array([[30.0, 120.0], [40.0, 60.0]])}
"""Eight scores: 10, 20, 30, 40, 60, 80, 90, 120."""


def some(seed: int, runs: int = 5, robots: tuple[str, ...] = ("a", "b"), dynamics: int = 5):
    """Scores of runs that differ, in dynamics that differ."""
    rng = np.random.default_rng(seed)
    return {robot: 50 + 10 * rng.normal(size=(runs, 1)) + 15 * rng.normal(size=(runs, dynamics)) for robot in robots}


def test_interquartile_mean_by_hand():
    assert interquartile_mean(BY_HAND).value == (30 + 40 + 60 + 80) / 4
    assert interquartile_mean({"a": np.array([[1.0, 2.0, 6.0]])}).value == 3.0  # a quarter of three is none
    assert interquartile_mean({"a": np.array([[0.0], [10.0], [20.0], [90.0]])}).value == 15.0


@given(st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_interquartile_mean_is_scipys(seed, runs, dynamics):
    scores = some(seed, runs, dynamics=dynamics)
    pooled = np.concatenate([values.ravel() for values in scores.values()])
    assert interquartile_mean(scores).value == pytest.approx(scipy.stats.trim_mean(pooled, 0.25), rel=1e-12)


def test_optimality_gap_by_hand():
    # below 100 by 90, 80, 70, 60, 40, 20, 10, and 0 for the score of 120
    assert optimality_gap(BY_HAND).value == pytest.approx(370 / 8)


def test_profile_by_hand():
    found = dict(zip(THRESHOLDS, [estimate.value for estimate in profile(BY_HAND)], strict=True))
    assert found[0] == 1.0
    assert found[10] == 7 / 8  # above it, not at it
    assert found[58] == 4 / 8
    assert found[60] == 3 / 8
    assert found[100] == 1 / 8


def test_improvement_by_hand():
    other = {"a": np.array([[10.0, 100.0], [15.0, 70.0]]), "c": np.array([[0.0]])}
    # first dynamics: 10 against 10 and 15: a tie and a loss; 20: two wins → 2.5 of 4
    # second dynamics: 90 against 100 and 70: a loss and a win; 80: the same → 2 of 4
    found = improvement(BY_HAND, other)
    assert found is not None
    assert found.value == pytest.approx((2.5 / 4 + 2 / 4) / 2)
    assert improvement(BY_HAND, {"c": np.array([[0.0]])}) is None


@given(st.integers(0, 2**31), st.integers(1, 5), st.integers(1, 5))
@settings(max_examples=20, deadline=None)
def test_improvement_is_the_mann_whitney_statistic_and_its_own_mirror(seed, runs, others):
    first = {robot: values.round(-1) for robot, values in some(seed, runs, dynamics=2).items()}  # with ties
    second = {robot: values.round(-1) for robot, values in some(seed + 1, others, dynamics=2).items()}
    parts = [
        scipy.stats.mannwhitneyu(first[robot][:, place], second[robot][:, place]).statistic / (runs * others)
        for robot in first
        for place in range(2)
    ]
    found, mirrored = improvement(first, second), improvement(second, first)
    assert found is not None
    assert mirrored is not None
    assert found.value == pytest.approx(np.mean(parts))
    assert found.value + mirrored.value == pytest.approx(1)


def every_resample(scores, statistic):
    """The statistic of every way to draw as many runs of one robot as it has."""
    ((_, values),) = scores.items()
    drawn = itertools.product(range(len(values)), repeat=len(values))
    return np.array([statistic(values[list(runs)]) for runs in drawn])


@pytest.mark.parametrize(
    ("measure", "statistic"),
    [
        (interquartile_mean, lambda values: scipy.stats.trim_mean(values, 0.25, axis=None)),
        (optimality_gap, lambda values: 100 - np.minimum(values, 100).mean()),
        (lambda scores: profile(scores)[THRESHOLDS.index(50)], lambda values: (values > 50).mean()),
        (lambda scores: improvement(scores, {"a": np.full((2, 5), 50.0)}), lambda values: (values > 50).mean()),
    ],
)
def test_intervals_are_those_of_every_resample(measure, statistic):
    scores = some(3, robots=("a",))
    exact = every_resample(scores, statistic)
    low, high = measure(scores).interval
    # 5,000 of the 3,125 ways: the quantiles are met within a point of percentage
    assert np.quantile(exact, 0.015) - 1e-9 <= low <= np.quantile(exact, 0.035) + 1e-9
    assert np.quantile(exact, 0.965) - 1e-9 <= high <= np.quantile(exact, 0.985) + 1e-9


def test_the_two_sides_of_a_comparison_are_drawn_apart():
    first, second = (some(seed, runs=3, robots=("a",)) for seed in (3, 4))
    ways = [list(runs) for runs in itertools.product(range(3), repeat=3)]
    one, other = first["a"], second["a"]
    exact = [(one[x][:, None] > other[y][None]).mean() for x in ways for y in ways]
    low, high = improvement(first, second).interval
    assert np.quantile(exact, 0.015) - 1e-9 <= low <= np.quantile(exact, 0.035) + 1e-9
    assert np.quantile(exact, 0.965) - 1e-9 <= high <= np.quantile(exact, 0.985) + 1e-9
    # an agent beside itself: drawn together, its runs would always be as good as themselves
    low, high = improvement(first, first).interval
    assert low < 0.4 < 0.6 < high


def test_two_runs_by_hand():
    # both runs twice, or one of each: a quarter, a quarter, a half; the ends are reached
    assert interquartile_mean({"a": np.array([[40.0], [60.0]])}) == (50.0, (40.0, 60.0))
    # two robots: an end needs the same luck twice, one time in sixteen, which is over 2.5 %
    assert interquartile_mean({"a": np.array([[40.0], [60.0]]), "b": np.array([[40.0], [60.0]])}).interval == (40, 60)


def test_runs_are_drawn_whole():
    # in each run the dynamics cancel out: however runs are drawn, the gap is the same
    opposed = {"a": np.array([[40.0, 60.0], [30.0, 70.0], [10.0, 90.0]])}
    assert optimality_gap(opposed).interval == (50.0, 50.0)


def test_one_run_has_no_interval():
    single = {"a": np.array([[10.0, 20.0]]), "b": some(0, dynamics=2)["b"]}
    assert interquartile_mean(single).interval is None
    assert optimality_gap(single).interval is None
    assert {estimate.interval for estimate in profile(single)} == {None}
    for found in (improvement(single, BY_HAND), improvement(BY_HAND, single)):
        assert found is not None
        assert found.interval is None


def test_the_same_scores_give_the_same_numbers_and_robots_do_not_disturb_each_other():
    assert interquartile_mean(some(1)) == interquartile_mean(some(1))
    low, high = interquartile_mean(some(1)).interval
    # pinned: a change of the draws would change every published interval
    assert (round(low, 6), round(high, 6)) == (45.899382, 59.17551)
    reordered = dict(reversed(some(1).items()))
    assert interquartile_mean(reordered).interval == pytest.approx((low, high), rel=1e-12)
    assert RESAMPLES == 5000


@pytest.mark.parametrize("bad", [{}, {"a": np.empty((0, 5))}, {"a": np.zeros(3)}])
def test_no_scores_are_an_error(bad):
    for measure in (interquartile_mean, optimality_gap, profile):
        with pytest.raises(ValueError, match="give \\(runs, dynamics\\), at least one of each"):
            measure(bad)


def test_ranks_by_hand():
    # A and B overlap, B and C overlap, A lies above C; D has one run; E is below all
    intervals = [(50.0, 60.0), (40.0, 55.0), (30.0, 45.0), None, (0.0, 10.0)]
    assert ranks(intervals) == [Rank(1, 2), Rank(1, 3), Rank(2, 3), None, Rank(4, 4)]
    assert ranks([(1.0, 2.0), (2.0, 3.0)]) == [Rank(1, 2), Rank(1, 2)]  # touching is overlapping
    assert ranks([]) == []


interval_lists = st.lists(
    st.tuples(st.integers(0, 20), st.integers(0, 20)).map(lambda ends: (float(min(ends)), float(max(ends)))), max_size=8
)


@given(interval_lists)
def test_overlapping_intervals_share_ranks_and_others_keep_their_order(intervals):
    found = ranks(intervals)
    assert all(1 <= rank.best <= rank.worst <= len(intervals) for rank in found)
    for (one, first), (two, second) in itertools.permutations(zip(intervals, found, strict=True), 2):
        if one[0] > two[1]:
            assert first.best < second.best
            assert first.worst < second.worst
        elif two[0] <= one[1] and one[0] <= two[1]:
            assert min(first.worst, second.worst) - max(first.best, second.best) >= 1


def test_what_is_near_the_best_by_hand():
    assert near_best([(50.0, 9.0), (60.0, 4.0), (57.0, None)]) == 56.0
    assert near_best([(50.0, 9.0), (60.0, None)]) == 60.0  # of a single run nothing is known but itself
    assert near_best([]) == float("inf")
