"""A mean and how sure it is: the t interval of the mean over a few runs.

What is here: `MeanEstimate` and `mean_estimate`. Called by the builder, the charts and the reference results. It must
not know runs.
"""

import functools
import math
import statistics
from collections.abc import Sequence
from typing import Final, NamedTuple

CONFIDENCE: Final = 0.95


class MeanEstimate(NamedTuple):
    """The mean of some runs."""

    mean: float
    std: float | None
    """Sample standard deviation; None of a single run."""
    interval: tuple[float, float] | None
    """The ends of the 95 % t interval of the mean; None of a single run, which says nothing of how much runs differ."""


def mean_estimate(values: Sequence[float]) -> MeanEstimate:
    """Mean ± t · s / √n, of n values (at least one)."""
    mean = math.fsum(values) / len(values)
    if len(values) == 1:
        return MeanEstimate(mean, None, None)
    std = statistics.stdev(values, xbar=mean)
    half = t_quantile(len(values) - 1) * std / math.sqrt(len(values))
    return MeanEstimate(mean, std, (mean - half, mean + half))


@functools.cache
def t_quantile(freedom: int) -> float:
    """The t that a variable of Student's distribution is within ± of with probability 95 %, by bisection."""
    low, high = 1.0, 20.0  # 12.7 for one degree of freedom, 1.96 for very many
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _within(middle, freedom) < CONFIDENCE else (low, middle)
    return low


def _within(t: float, freedom: int) -> float:
    """Probability of |T| ≤ t (Abramowitz & Stegun, Handbook of Mathematical Functions, 26.7.3 and 26.7.4)."""
    angle = math.atan(t / math.sqrt(freedom))
    odd = freedom % 2 == 1
    if freedom == 1:
        return 2 * angle / math.pi
    term = total = math.cos(angle) if odd else 1.0
    for k in range(3 if odd else 2, freedom, 2):  # terms of the next power of cos² each
        term *= (k - 1) / k * math.cos(angle) ** 2
        total += term
    return 2 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
