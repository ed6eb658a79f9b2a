"""A page a robot that says what is in its data, beside what the paper says of its own.

What is here: `data_card`, Markdown made from the flat data and what the datasets record of themselves, and
`write_data_card`, which puts it into a file with its charts beside it. Called by `dynagen data card`. It must not know
how the data were made.
"""

import csv
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.collection.policies import POLICY_FOLDER, policy_file
from dynagen_bench.datasets.charts import learning_curves, return_histograms
from dynagen_bench.datasets.flat import OfflineDataset, checked_record, load_dataset
from dynagen_bench.datasets.flat_files import ROW_ARRAYS
from dynagen_bench.datasets.manifest import read_manifest, standing
from dynagen_bench.datasets.scores import Reference
from dynagen_bench.datasets.subsets import ADAPTATION_EPISODES, spread_episodes, worst_episodes
from dynagen_bench.markdown import table
from dynagen_bench.whole import write_whole

LICENCE: Final = "MIT, as everything in the repository"

LOW_QUALITY: Final = 0.3
"""The paper's low-quality share (figure 5)."""

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


class Stored(NamedTuple):
    """One Minari dataset on this machine."""

    dataset_id: str
    episodes: int
    steps: int
    size: int
    """Bytes of its files."""
    sha256: str
    """Content hash that it records."""
    official: bool
    """The manifest has the same hash."""
    mujoco: str


def stored_datasets(robot: str) -> list[Stored]:
    """What the 25 datasets of a robot record of themselves, and their sizes.

    Raises:
        ValueError: an unknown robot, or a dataset of other dynamics than its place says.
        FileNotFoundError: a dataset is missing; the message has the command that makes it.
    """
    manifest, found = read_manifest(), []
    for name in ids.dynamics_ids(robot):
        record, entry = checked_record(name, every=1), manifest.get(name.dataset_id)
        size = sum(file.stat().st_size for file in dataset_folder(name.dataset_id).rglob("*") if file.is_file())
        official = standing(record, entry) == "official"
        found.append(
            Stored(name.dataset_id, record.episodes, record.steps, size, record.sha256, official, record.mujoco)
        )
    return found


def read_curves(robot: str, folder: Path = POLICY_FOLDER) -> dict[str, tuple[list[float], list[float]]]:
    """Learning curves of a robot's SAC runs: label → environment steps and mean returns of the last 100 episodes.

    Raises:
        FileNotFoundError: a run has none; the message has the command that makes it.
    """
    curves = {}
    for name in ids.dynamics_ids(robot):
        path = policy_file(name, folder).with_suffix(".csv")
        if not path.is_file():
            raise FileNotFoundError(f"no learning curve at {path}: train the policies with `dynagen collect {robot}`")
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if math.isfinite(float(row["mean_return"]))]
        curves[name.label] = [float(row["step"]) for row in rows], [float(row["mean_return"]) for row in rows]
    return curves


def write_data_card(robot: str, output: Path | None = None) -> None:
    """Print the page of a robot's data, or write it to a file and its two charts beside it.

    Raises:
        ValueError: an unknown robot, or data that are damaged.
        FileNotFoundError: data or learning curves are missing; the message has the command that makes them.
    """
    stored = stored_datasets(robot)
    splits = {split: load_dataset(robot, split) for split in ("train", "test")}
    card = data_card(robot, splits, stored)
    if output is None:
        sys.stdout.write(card)
        return
    returns = {split: (data.episode_returns, data.episode_snapshots) for split, data in splits.items()}
    texts = {
        chart_file(robot, "curves"): learning_curves(robot, read_curves(robot)),
        chart_file(robot, "returns"): return_histograms(robot, returns),
        output.name: card,
    }
    for name, text in texts.items():
        write_whole(output.with_name(name), text)


def chart_file(robot: str, chart: str) -> str:
    """Name of the file of a chart, `hopper-curves.svg`; `chart` is `curves` or `returns`."""
    return f"{robot.lower()}-{chart}.svg"


def data_card(robot: str, splits: Mapping[str, OfflineDataset], stored: Sequence[Stored]) -> str:
    """The page of a robot, Markdown; it shows two charts that lie beside it (`chart_file`).

    Args:
        robot: name of the robot.
        splits: `train` and `test` → that split's whole data.
        stored: the Minari datasets that the data are from.

    Raises:
        ValueError: data of another robot or split under these names.
    """
    for split, dataset in splits.items():
        if (dataset.robot, dataset.split) != (robot, split):
            raise ValueError(f"data of {dataset.robot} {dataset.split} given as {robot} {split}")
    return "\n".join(
        [
            f"# The data of {robot}",
            "",
            f"Made by `dynagen data card {robot}`. Every return is that of one stochastic episode of at most 200",
            "steps, undiscounted.",
            "",
            _facts(splits, stored),
            "",
            "## Learning curves",
            "",
            f"![Learning curves of {robot}'s 25 SAC runs]({chart_file(robot, 'curves')})",
            "",
            "## Returns by snapshot",
            "",
            f"![Histograms of returns by snapshot]({chart_file(robot, 'returns')})",
            "",
            "## Returns of the test dynamics, beside the paper's Table 5",
            "",
            "The paper's dynamics are other draws: the columns are not comparable one by one, their size is.",
            "",
            _paper_table(robot, splits["test"]),
            "",
            "## Returns of every dynamics",
            "",
            _return_table(splits),
            "",
            "## Mean return by snapshot",
            "",
            "Columns are environment steps of the SAC run, in thousands.",
            "",
            _snapshot_table(splits),
            "",
            "## Parts of the data",
            "",
            *_low_quality(splits["train"]),
            "",
            *_adaptation(splits["test"]),
            "",
            "## Datasets",
            "",
            "The first 16 digits of each content hash; `dynagen_bench/datasets/manifest.json` has all of them, and",
            f"`dynagen data verify {robot}` reads every episode again and compares. A MB is 10⁶ bytes.",
            "",
            _dataset_table(stored),
            "",
        ]
    )


def _facts(splits: Mapping[str, OfflineDataset], stored: Sequence[Stored]) -> str:
    episodes = sum(len(dataset.episode_lengths) for dataset in splits.values())
    steps = sum(dataset.num_steps for dataset in splits.values())
    flat = sum(getattr(dataset, name).nbytes for dataset in splits.values() for name in ROW_ARRAYS)
    on_disk = sum(dataset.size for dataset in stored)
    versions = ", ".join(sorted({dataset.mujoco for dataset in stored}))
    rows = [
        ["content", f"{episodes:,} episodes, {steps:,} steps"],
        [
            "size",
            f"{on_disk / 1e6:.0f} MB as {len(stored)} Minari datasets, {flat / 1e6:.0f} MB as flat float32 arrays",
        ],
        ["physics", f"MuJoCo {versions}"],
        ["official", f"{sum(dataset.official for dataset in stored)} of {len(stored)} have the manifest's hash"],
        ["licence", LICENCE],
    ]
    return table(["", ""], rows, numbers_from=None)


def _low_quality(train: OfflineDataset) -> list[str]:
    part = train.select(worst_episodes(train.episode_returns, LOW_QUALITY))
    present, counts = np.unique(part.episode_dynamics, return_counts=True)
    absent = len(np.unique(train.episode_dynamics)) - len(present)
    missing = f"{absent} dynamics have none" if absent else "each dynamics has some"
    return [
        f"`load_dataset(..., quality={LOW_QUALITY})`, the paper's low-quality data (figure 5):",
        f"{len(part.episode_lengths):,} episodes, {part.num_steps:,} steps, the worst of all train dynamics together.",
        f"None returns more than {part.episode_returns.max():.1f}; {missing}:",
        "",
        table(["", *[f"train{index}" for index in present]], [["episodes", *[f"{count}" for count in counts]]]),
    ]


def _adaptation(test: OfflineDataset) -> list[str]:
    rows = []
    for index in np.unique(test.episode_dynamics):
        returns = _returns(test, int(index))
        chosen = spread_episodes(returns, min(ADAPTATION_EPISODES, len(returns)))
        rows.append([f"test{index}", *[f"{value:.0f}" for value in np.sort(returns[chosen])]])
    return [
        f"`load_adaptation(robot, index)`: {ADAPTATION_EPISODES} episodes of one test dynamics, spread evenly over the "
        "ranks of their returns:",
        "",
        table(["", *[f"{number}" for number in range(1, len(rows[0]))]], rows),
    ]


def _dataset_table(stored: Sequence[Stored]) -> str:
    rows = [
        [
            f"`{dataset.dataset_id}`",
            f"{dataset.episodes:,}",
            f"{dataset.steps:,}",
            f"{dataset.size / 1e6:.1f}",
            f"`{dataset.sha256[:16]}`",
            "yes" if dataset.official else "no",
        ]
        for dataset in stored
    ]
    return table(["dataset", "episodes", "steps", "MB", "sha256", "official"], rows)


def _returns(dataset: OfflineDataset, index: int) -> NDArray[np.float64]:
    returns: NDArray[np.float64] = dataset.episode_returns[dataset.episode_dynamics == index]
    return returns


def _paper_table(robot: str, test: OfflineDataset) -> str:
    unknown = Reference(math.nan, math.nan, math.nan)  # of a robot that the paper does not have
    paper = PAPER_RETURNS.get(robot, (unknown,) * ids.SPLIT_SIZES["test"])
    rows = []
    for name in ids.dynamics_ids(robot, ("test",)):
        returns = _returns(test, name.index)
        ours = [f"{returns.min():.2f}", f"{returns.max():.2f}", f"{returns.mean():.2f}"]
        theirs = ["–" if math.isnan(number) else f"{number:.2f}" for number in paper[name.index]]
        rows.append([name.label, *ours, f"dynamics {20 + name.index}", *theirs])
    return table(["ours", "min", "max", "mean", "the paper's", "min", "max", "mean"], rows)


def _return_table(splits: Mapping[str, OfflineDataset]) -> str:
    rows = []
    for split, dataset in splits.items():
        for index in np.unique(dataset.episode_dynamics):
            chosen = dataset.episode_dynamics == index
            returns, lengths = _returns(dataset, int(index)), dataset.episode_lengths[chosen]
            low, middle, high = np.quantile(returns, [0.1, 0.5, 0.9])
            numbers = [returns.min(), low, middle, high, returns.max(), returns.mean(), lengths.mean()]
            early = f"{100 * dataset.episode_terminated[chosen].mean():.0f} %"
            rows.append([f"{split}{index}", *[f"{number:.1f}" for number in numbers], early])
    return table(["", "min", "10 %", "median", "90 %", "max", "mean", "mean length", "terminated"], rows)


def _snapshot_table(splits: Mapping[str, OfflineDataset]) -> str:
    snapshots = np.unique(np.concatenate([dataset.episode_snapshots for dataset in splits.values()]))
    rows = []
    for split, dataset in splits.items():
        for index in np.unique(dataset.episode_dynamics):
            means = []
            for snapshot in snapshots:
                chosen = (dataset.episode_dynamics == index) & (dataset.episode_snapshots == snapshot)
                means.append(f"{dataset.episode_returns[chosen].mean():.0f}")
            rows.append([f"{split}{index}", *means])
    return table(["", *[f"{snapshot // 1000}" for snapshot in snapshots]], rows)
