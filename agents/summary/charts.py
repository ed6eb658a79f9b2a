"""The geometry of the page's charts: steps and values → places in a drawing of 100 × 100, whatever its size.

What is here: scales, and the line and band of a group. Called by the builder and the reference results. It must not
know runs or HTML.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from agents.summary.intervals import MeanEstimate, mean_estimate

POINTS: Final = 200
"""Of a longer curve, neighbours are averaged until it has no more points than this."""

DASH: Final = 3.0
"""Half the width of what shows a single point."""

DECADES: Final = 20.0
"""An axis is logarithmic where the highest value is this many times the lowest."""


class Point(NamedTuple):
    """A group's value at a step."""

    step: int
    value: MeanEstimate


class Scale(NamedTuple):
    """What is at the low and at the high edge of a drawing."""

    low: float
    high: float
    logarithmic: bool = False

    def at(self, value: float) -> float:
        """The place of a value, 0 to 100; what is beyond an edge is at the edge."""
        low, high, value = (self._bent(number) for number in (self.low, self.high, value))
        return round(min(max(100 * (value - low) / (high - low), 0.0), 100.0), 2) + 0.0

    def _bent(self, value: float) -> float:
        return math.log10(max(value, 1e-300)) if self.logarithmic else value

    @property
    def ticks(self) -> list[float]:
        """Round numbers on the scale, two to eight of them."""
        if self.logarithmic:
            tens = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            factors = (1, 2, 5) if len(tens) < 4 else (1,)
            every = [factor * 10.0**ten for ten in tens for factor in factors]
            inside = [value for value in every if self.low <= value <= self.high]
            return inside[:: math.ceil(len(inside) / 8)]
        raw = (self.high - self.low) / 5
        size = 10.0 ** math.floor(math.log10(raw))
        step = next(size * factor for factor in (1, 2, 5, 10) if size * factor >= raw * (1 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [round(step * k, 12) + 0.0 for k in range(first, last + 1)]


def curve_of(curves: Sequence[Mapping[int, float]]) -> list[Point]:
    """Mean and interval over runs, at the steps that all of them have; longer curves in at most `POINTS` parts."""
    steps = list(curves[0])
    parts = [steps[len(steps) * i // POINTS : len(steps) * (i + 1) // POINTS] for i in range(POINTS)]
    if len(steps) <= POINTS:
        parts = [[step] for step in steps]
    return [
        Point(part[-1], mean_estimate([math.fsum(curve[step] for step in part) / len(part) for curve in curves]))
        for part in parts
    ]


def scale_of(curves: Iterable[Sequence[Point]], may_bend: bool) -> Scale:
    """A scale for values: with all means on it, and of intervals as much as does not flatten the lines.

    Args:
        curves: those of one drawing.
        may_bend: it is of errors, whose range may be of several powers of ten.
    """
    points = [point for curve in curves for point in curve]
    low, high = (end(point.value.mean for point in points) for end in (min, max))
    if may_bend and low > 0 and high >= DECADES * low:
        return Scale(low / 1.1, high * 1.1, logarithmic=True)
    room = high - low or abs(high) or 1.0
    ends = [end for point in points for end in point.value.interval or ()]
    low = max(min([low, *ends]), low - room / 2)
    high = min(max([high, *ends]), high + room / 2)
    margin = 0.04 * (high - low or room)
    return Scale(low - margin, high + margin)


def line(curve: Sequence[Point], x: Scale, y: Scale) -> str:
    """The means as the points of an SVG polyline, at its step of a single one a dash."""
    places = _places([x.at(point.step) for point in curve])
    means = [point.value.mean for point in curve] * (len(places) // len(curve))
    return " ".join(_at(place, mean, y) for place, mean in zip(places, means, strict=True))


def band(curve: Sequence[Point], x: Scale, y: Scale) -> str | None:
    """The intervals as the points of an SVG polygon: high ends from left to right, low ends back; a bar if it is one.

    None where there is no interval.
    """
    ends = [(point.step, point.value.interval) for point in curve if point.value.interval is not None]
    if not ends:
        return None
    places = _places([x.at(step) for step, _ in ends])
    shown = list(zip(places, [interval for _, interval in ends] * (len(places) // len(ends)), strict=True))
    highs = [_at(place, interval[1], y) for place, interval in shown]
    return " ".join([*highs, *(_at(place, interval[0], y) for place, interval in reversed(shown))])


def _places(places: Sequence[float]) -> list[float]:
    """The same, but for a single one, of which nothing would be drawn: its left and its right."""
    if len(places) > 1:
        return list(places)
    return [max(places[0] - DASH, 0.0), min(places[0] + DASH, 100.0)]


def _at(place: float, value: float, y: Scale) -> str:
    return f"{place:g},{round(100 - y.at(value), 2):g}"
