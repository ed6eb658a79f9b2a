"""Whether one method is better than another, and how sure that is.

What is here: `Comparison`, `compared`, and when a comparison decides something. Called by the command line, for two
entries, and by the results page, for the paper's claims. It must not know entries, files or how numbers look.

Two methods are compared by the probability that a run of the one is better than a run of the other in the same test
dynamics (Agarwal et al., 2021; docs/statistics.md). The one is better where the 95 % interval lies above one half, the
other where it lies below, and nothing is decided in between, where a side has fewer runs than `FEWEST`, and where one
robot alone would say the opposite: a mean over robots hides that. Of few runs such an interval is too narrow: it says
the least that is unknown.
"""

from typing import Final, Literal, NamedTuple

from dynagen_bench import ids
from leaderboard.statistics import Estimate, Scores, improvement

Verdict = Literal["holds", "does not hold", "undecided", "not run"]

FEWEST: Final = 3
"""Runs of each side that a verdict takes: of two, equal methods are told apart in 29 of 100 cases, of three in 19
(docs/statistics.md)."""


class Comparison(NamedTuple):
    """What is known of a sentence like `DADT > DT`."""

    what: str
    estimate: Estimate | None
    """The probability; None where one of the two has not been run."""
    robots: tuple[str, ...]
    """That both have been run on."""
    runs: tuple[int, int]
    """Of the one and of the other, each on the robot where it has fewest; of λ the fewest and the most of any value."""
    each: tuple[Estimate, ...]
    """The probability on each of these robots alone."""
    chance: float | None = None
    """The p-value of a permutation test, where there is one."""

    @property
    def verdict(self) -> Verdict:
        """Of this comparison alone."""
        if self.estimate is None:
            return "not run"
        if self.estimate.interval is None or min(self.runs) < FEWEST:
            return "undecided"
        side = _side(self.estimate)
        if side == 0 or -side in map(_side, self.each):
            return "undecided"
        return "holds" if side > 0 else "does not hold"


def compared(what: str, scores: Scores | None, others: Scores | None) -> Comparison:
    """Compare the runs of two methods, on the robots that both have been run on; None is a method that was not run."""
    shared = tuple(robot for robot in ids.ROBOTS if robot in (scores or {}) and robot in (others or {}))
    if scores is None or others is None or not shared:
        return Comparison(what, None, (), (0, 0), ())
    one, other = (min(len(side[robot]) for robot in shared) for side in (scores, others))
    each = (improvement({robot: scores[robot]}, others) for robot in shared)
    told = tuple(estimate for estimate in each if estimate is not None)
    return Comparison(what, improvement(scores, others), shared, (one, other), told)


def _side(probability: Estimate) -> int:
    """1 where its interval lies above one half, -1 where it lies below, 0 where neither is sure."""
    if probability.interval is None:
        return 0
    low, high = probability.interval
    return int(low > 0.5) - int(high < 0.5)
