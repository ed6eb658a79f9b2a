"""A page a robot that says what is in its data, beside what the paper says of its own.

What is here: `data_card`, Markdown made from the flat data. Called by `dynagen data card`. It must not know how the
data were made or where the page is put.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.flat import OfflineDataset
from dynagen_bench.datasets.scores import Reference

PAPER_RETURNS: Final[dict[str, tuple[Reference, ...]]] = {
    "Walker": (
        Reference(-15.56, 645.11, 519.47),
        Reference(123.40, 769.63, 548.16),
        Reference(-17.73, 674.81, 496.15),
        Reference(-13.32, 725.99, 514.39),
        Reference(52.18, 645.11, 519.47),
    ),
    "Hopper": (
        Reference(129.77, 678.26, 537.53),
        Reference(10.72, 754.62, 605.03),
        Reference(8.66, 710.44, 555.52),
        Reference(12.70, 668.36, 542.72),
        Reference(15.53, 682.38, 615.87),
    ),
    "HalfCheetah": (
        Reference(149.69, 1681.41, 1222.03),
        Reference(69.57, 2032.87, 1412.65),
        Reference(168.52, 1484.98, 1281.07),
        Reference(31.33, 1419.93, 1003.75),
        Reference(71.92, 2248.80, 1686.36),
    ),
    "SlimHumanoid": (
        Reference(148.34, 975.08, 444.97),
        Reference(147.26, 1061.81, 461.60),
        Reference(128.95, 1107.90, 495.55),
        Reference(106.63, 1261.80, 512.27),
        Reference(102.19, 1217.33, 537.16),
    ),
    "Ant": (
        Reference(-61.30, 786.27, math.nan),
        Reference(-29.38, 910.21, math.nan),
        Reference(-27.31, 968.01, math.nan),
        Reference(-60.95, 744.02, math.nan),
        Reference(-68.82, 1354.02, math.nan),
    ),
}
"""The paper's Table 5: returns of its data of dynamics 20 to 24, which are other draws than ours. Its means of Ant are
not legible in the copy that these were read from."""


def data_card(robot: str, splits: dict[str, OfflineDataset]) -> str:
    """The page of a robot, Markdown.

    Args:
        robot: name of the robot.
        splits: `train` and `test` → that split's whole data.

    Raises:
        ValueError: data of another robot or split under these names.
    """
    for split, dataset in splits.items():
        if (dataset.robot, dataset.split) != (robot, split):
            raise ValueError(f"data of {dataset.robot} {dataset.split} given as {robot} {split}")
    episodes = sum(len(dataset.episode_lengths) for dataset in splits.values())
    steps = sum(dataset.num_steps for dataset in splits.values())
    return "\n".join(
        [
            f"# The data of {robot}",
            "",
            f"Made by `dynagen data card {robot}`: {episodes:,} episodes, {steps:,} steps. Every return is that of one",
            "stochastic episode of at most 200 steps, undiscounted.",
            "",
            "## Returns of the test dynamics, beside the paper's Table 5",
            "",
            "The paper's dynamics are other draws: the columns are not comparable one by one, their size is.",
            "",
            *_paper_table(robot, splits["test"]),
            "",
            "## Returns of every dynamics",
            "",
            *_return_table(splits),
            "",
            "## Mean return by snapshot",
            "",
            "Columns are environment steps of the SAC run, in thousands.",
            "",
            *_snapshot_table(splits),
            "",
        ]
    )


def _returns(dataset: OfflineDataset, index: int) -> NDArray[np.float64]:
    returns: NDArray[np.float64] = dataset.episode_returns[dataset.episode_dynamics == index]
    return returns


def _table(header: list[str], rows: list[list[str]]) -> list[str]:
    rule = ["---", *["---:"] * (len(header) - 1)]
    return ["| " + " | ".join(row) + " |" for row in (header, rule, *rows)]


def _paper_table(robot: str, test: OfflineDataset) -> list[str]:
    paper = PAPER_RETURNS[robot]
    rows = []
    for name in ids.dynamics_ids(robot, ("test",)):
        returns = _returns(test, name.index)
        ours = [f"{returns.min():.2f}", f"{returns.max():.2f}", f"{returns.mean():.2f}"]
        theirs = ["–" if math.isnan(number) else f"{number:.2f}" for number in paper[name.index]]
        rows.append([name.label, *ours, f"dynamics {20 + name.index}", *theirs])
    return _table(["ours", "min", "max", "mean", "the paper's", "min", "max", "mean"], rows)


def _return_table(splits: dict[str, OfflineDataset]) -> list[str]:
    rows = []
    for split, dataset in splits.items():
        for index in np.unique(dataset.episode_dynamics):
            chosen = dataset.episode_dynamics == index
            returns, lengths = _returns(dataset, int(index)), dataset.episode_lengths[chosen]
            low, middle, high = np.quantile(returns, [0.1, 0.5, 0.9])
            numbers = [returns.min(), low, middle, high, returns.max(), returns.mean(), lengths.mean()]
            early = f"{100 * dataset.episode_terminated[chosen].mean():.0f} %"
            rows.append([f"{split}{index}", *[f"{number:.1f}" for number in numbers], early])
    return _table(["", "min", "10 %", "median", "90 %", "max", "mean", "mean length", "terminated"], rows)


def _snapshot_table(splits: dict[str, OfflineDataset]) -> list[str]:
    snapshots = np.unique(np.concatenate([dataset.episode_snapshots for dataset in splits.values()]))
    rows = []
    for split, dataset in splits.items():
        for index in np.unique(dataset.episode_dynamics):
            means = []
            for snapshot in snapshots:
                chosen = (dataset.episode_dynamics == index) & (dataset.episode_snapshots == snapshot)
                means.append(f"{dataset.episode_returns[chosen].mean():.0f}")
            rows.append([f"{split}{index}", *means])
    return _table(["", *[f"{snapshot // 1000}" for snapshot in snapshots]], rows)
