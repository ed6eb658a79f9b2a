"""The geometry of the page's charts: scores and fractions → places in a drawing of 100 × 100, whatever its size.

What is here: scales, marks of intervals, curves of profiles, levels of heat maps. Called by the builder. It must not
know entries or HTML.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from leaderboard.statistics import THRESHOLDS, Estimate

WIDEST: Final = (-50.0, 150.0)
"""Scores beyond are drawn at the edge; a policy that falls at once can be hundreds below 0."""

HEAT_LEVELS: Final = 10
"""Shades from a score of 0 to one of 100; below 0 there are four of another colour, the last for −100 and less."""


class Mark(NamedTuple):
    """Where an estimate is drawn, each 0 (left) to 100 (right)."""

    at: float
    low: float | None
    high: float | None


class Curve(NamedTuple):
    """A profile as the points of SVG polylines."""

    line: str
    band: str | None
    """Round the interval: the high ends from left to right, the low ends back."""


class Scale(NamedTuple):
    """The scores that are at the left and right edges."""

    low: float
    high: float

    def at(self, score: float) -> float:
        """The place of a score, 0 to 100; what is beyond an edge is at the edge."""
        place = 100.0 * (score - self.low) / (self.high - self.low)
        return round(min(max(place, 0.0), 100.0), 2) + 0.0

    def mark(self, estimate: Estimate) -> Mark:
        """The places of an estimate and its interval."""
        low, high = estimate.interval or (None, None)
        return Mark(self.at(estimate.value), *(None if end is None else self.at(end) for end in (low, high)))

    @property
    def ticks(self) -> list[tuple[float, int]]:
        """(place, score) of every 50."""
        first, last = math.ceil(self.low / 50), math.floor(self.high / 50)
        return [(self.at(50.0 * k), 50 * k) for k in range(first, last + 1)]


def scale_of(scores: Iterable[float]) -> Scale:
    """A scale of whole tens that has 0, 100 and the scores in it, as far as `WIDEST` goes."""
    every = [0.0, 100.0, *scores]
    return Scale(
        max(10.0 * math.floor(min(every) / 10), WIDEST[0]),
        min(10.0 * math.ceil(max(every) / 10), WIDEST[1]),
    )


def curve(profile: Sequence[Estimate]) -> Curve:
    """A performance profile, `THRESHOLDS` to the right and 100 % at the top."""
    intervals = [estimate.interval for estimate in profile if estimate.interval is not None]
    band = None
    if len(intervals) == len(profile):
        lows, highs = (
            [_point(*pair) for pair in zip(THRESHOLDS, ends, strict=True)] for ends in zip(*intervals, strict=True)
        )
        band = " ".join([*highs, *reversed(lows)])
    line = " ".join(_point(*pair) for pair in zip(THRESHOLDS, (estimate.value for estimate in profile), strict=True))
    return Curve(line, band)


def _point(threshold: float, fraction: float) -> str:
    return f"{threshold:g},{round(100.0 - 100.0 * fraction, 1) + 0.0:g}"


def heat_level(score: float) -> int:
    """The shade of a score: 0 to `HEAT_LEVELS` from 0 to 100, −1 to −4 below 0."""
    if score < 0:
        return max(math.floor(score / 25), -4)
    return min(math.floor(score / 100 * HEAT_LEVELS), HEAT_LEVELS)
