"""Return distributions of a robot's data, as shapes to draw.

What is here: histograms of the episodes' returns by dynamics, on one scale a robot. Called by the gallery. It must not
know HTML or how data are made.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets import OfflineDataset, load_dataset
from dynagen_bench.svg import ticks

BINS: Final = 60

HEIGHT: Final = 10.0
"""Of the highest bin of each histogram; one bin is 1 wide."""


class Distribution(NamedTuple):
    """The returns of one dynamics' episodes."""

    label: str
    split: str
    path: str
    """SVG path of the histogram in a box of `BINS` × `HEIGHT`, its foot at y = `HEIGHT`."""
    median_at: float
    """Place of the median in that box, 0 to `BINS`."""
    median: str
    words: str


class Distributions(NamedTuple):
    """Those of a robot, on one scale."""

    rows: list[Distribution]
    ticks: list[tuple[float, str]]
    """Place in percent of the width, and the return there."""
    missing: list[str]
    """Splits without data on this machine."""


def load_returns(robot: str) -> dict[str, OfflineDataset]:
    """The data of a robot that are on this machine, split → data; they may be none.

    Raises:
        ValueError: data that are damaged or of other dynamics.
    """
    found = {}
    for split in ("train", "test"):
        try:
            found[split] = load_dataset(robot, split)
        except FileNotFoundError:
            continue
    return found


def distributions(datasets: Mapping[str, OfflineDataset]) -> Distributions:
    """Histograms of each dynamics in data of one robot, `train` before `test`."""
    rows: list[Distribution] = []
    labels: list[tuple[float, str]] = []
    if datasets:
        everything = np.concatenate([dataset.episode_returns for dataset in datasets.values()])
        marks = ticks(float(everything.min()), float(everything.max()))
        low, high = marks[0], marks[-1]
        for split, dataset in datasets.items():
            for index in np.unique(dataset.episode_dynamics).tolist():
                label = ids.make_id(dataset.robot, split, index).label
                returns = dataset.episode_returns[dataset.episode_dynamics == index]
                rows.append(_distribution(label, split, returns, low, high))
        labels = [(100 * (mark - low) / (high - low), f"{mark:g}".replace("-", "−")) for mark in marks]
    return Distributions(rows, labels, [split for split in ("train", "test") if split not in datasets])


def _distribution(label: str, split: str, returns: NDArray[np.float64], low: float, high: float) -> Distribution:
    counts, _ = np.histogram(returns, BINS, (low, high))
    heights = HEIGHT * (1.0 - counts / max(int(counts.max()), 1))
    steps = " ".join(f"V{height:.3g}h1" for height in heights)
    quantiles = np.quantile(returns, [0.0, 0.1, 0.5, 0.9, 1.0])
    numbers = [f"{quantile:.0f}".replace("-", "−") for quantile in quantiles]
    words = (
        f"{label}: {len(returns):,} episodes, median return {numbers[2]}, 10 % to 90 % from {numbers[1]} to "
        f"{numbers[3]}, all from {numbers[0]} to {numbers[4]}"
    )
    median_at = BINS * float(quantiles[2] - low) / (high - low)
    return Distribution(label, split, f"M0 {HEIGHT:g}{steps}V{HEIGHT:g}z", median_at, numbers[2], words)
