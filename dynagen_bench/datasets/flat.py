"""The offline data of a robot as flat float32 arrays, memory-mapped.

What is here: `OfflineDataset`, its layout, `load_dataset` and `load_adaptation`. Called by training, fine-tuning,
evaluation of data, and users. It must not know windows, agents or scores, nor how the arrays are cached.

Each episode takes T + 1 rows: its T steps, and one last row with the final observation, no action and no reward. Two
episodes of 3 and 2 steps:

    row               0    1    2    3  |  4    5    6
    observations      s0   s1   s2   s3 |  s0'  s1'  s2'
    actions           a0   a1   a2   0  |  a0'  a1'  0
    rewards           r0   r1   r2   0  |  r0'  r1'  0
    returns_to_go     R0   R1   R2   0  |  R0'  R1'  0       R1 = r1 + r2, undiscounted

    episode_starts    0, 4
    episode_lengths   3, 2

A part of the data (`select`) has the same rows and fewer episodes: no row is copied, and all processes that map the
same files share their pages. So whoever reads rows goes by the episodes.
"""

import dataclasses
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, build_command, dataset_folder, read_record
from dynagen_bench.datasets.flat_files import LAYOUT, ROW_ARRAYS, Source, cache_folder, map_arrays
from dynagen_bench.datasets.normalization import Normalization, statistics
from dynagen_bench.datasets.subsets import (
    ADAPTATION_EPISODES,
    check_quality,
    spread_episodes,
    worst_episodes,
)


@dataclasses.dataclass(frozen=True, eq=False)
class OfflineDataset:
    """The data of one split of one robot, or a part of them: M rows, E episodes that lie in them.

    Attributes:
        robot: name of the robot.
        split: `train` or `test`; training takes `train` alone.
        observations: (M, S) float32.
        actions: (M, A) float32.
        rewards: (M,) float32.
        returns_to_go: (M,) float32, undiscounted, 0 in the last row of an episode.
        episode_starts: (E,) int64, first row of an episode.
        episode_lengths: (E,) int64, its number of actions T.
        episode_dynamics: (E,) int64, index of its dynamics in the split.
        episode_snapshots: (E,) int64, environment steps after which its policy was stored.
        episode_returns: (E,) float64, undiscounted.
        episode_seeds: (E,) int64, reset seeds.
        episode_terminated: (E,) bool, the last state ended it by itself.
    """

    robot: str
    split: str
    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    returns_to_go: NDArray[np.float32]
    episode_starts: NDArray[np.int64]
    episode_lengths: NDArray[np.int64]
    episode_dynamics: NDArray[np.int64]
    episode_snapshots: NDArray[np.int64]
    episode_returns: NDArray[np.float64]
    episode_seeds: NDArray[np.int64]
    episode_terminated: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Check that the arrays have their types, fit together, and that each episode has rows of its own.

        Raises:
            ValueError: one line, naming the array or the episode.
        """
        for field in dataclasses.fields(self)[2:]:
            if (kind := getattr(self, field.name).dtype) != LAYOUT[field.name]:
                raise ValueError(f"{field.name} is of {kind}: give {np.dtype(LAYOUT[field.name])}")
            model = "observations" if field.name in ROW_ARRAYS else "episode_lengths"
            found, expected = len(getattr(self, field.name)), len(getattr(self, model))
            if found != expected:
                raise ValueError(f"{field.name} has {found} rows: {model} has {expected}")
        at = _misplaced(self.episode_starts, self.episode_lengths, len(self.observations))
        if at is not None:
            raise ValueError(
                f"episode {at} begins in row {self.episode_starts[at]} and has {self.episode_lengths[at]} steps: it "
                f"leaves the {len(self.observations)} rows, or shares some with another episode"
            )

    @property
    def state_size(self) -> int:
        """S, elements of an observation."""
        return int(self.observations.shape[1])

    @property
    def action_size(self) -> int:
        """A, elements of an action."""
        return int(self.actions.shape[1])

    @property
    def num_steps(self) -> int:
        """Number of actions in the episodes, each of which has one row more."""
        return int(self.episode_lengths.sum())

    @property
    def is_whole(self) -> bool:
        """Every row is of an episode: nothing has been left out."""
        return self.num_steps + len(self.episode_lengths) == len(self.observations)

    def select(self, episodes: NDArray[np.integer[Any]]) -> "OfflineDataset":
        """The part of the data that has the episodes of these numbers, in this order; no row is copied.

        Raises:
            ValueError: an episode is asked for twice.
            IndexError: there is no episode of that number; NumPy would count a negative one from the end.
        """
        count, asked = len(self.episode_lengths), np.asarray(episodes)
        outside = asked[(asked < 0) | (asked >= count)]
        if len(outside):
            raise IndexError(f"there is no episode {outside[0]}: the data have {count}, numbered from 0")
        names = [name for name in LAYOUT if name not in ROW_ARRAYS]
        return dataclasses.replace(self, **{name: getattr(self, name)[episodes] for name in names})

    def normalization(self) -> Normalization:
        """Mean and deviation of the observations that an action was taken at (kzl/decision-transformer: all states).

        Of the episodes that are here: an agent that learns from a part of the data knows no more of the rest.

        Raises:
            ValueError: these are test data, which no agent may be normalised by.
        """
        if self.split != "train":
            raise ValueError(
                f"this is split {self.split!r}: normalisation is of train data, load_dataset(..., 'train')"
            )
        edges = np.zeros(len(self.observations), dtype=np.int8)
        edges[self.episode_starts] = 1
        edges[self.episode_starts + self.episode_lengths] -= 1
        chosen = np.cumsum(edges, dtype=np.int8).astype(np.bool_)  # 1 from a first row to the last that was acted in
        return statistics(self.observations, chosen)


def _misplaced(starts: NDArray[np.int64], lengths: NDArray[np.int64], rows: int) -> int | None:
    """Number of the first episode, by row, that does not have its length + 1 rows to itself, or None."""
    if (lengths < 0).any():
        return int(lengths.argmin())
    order = np.argsort(starts, kind="stable")
    # from the end of one episode to the beginning of the next; the rows' own beginning and end are the outermost
    ends = np.concatenate([[0], (starts + lengths + 1)[order]])
    wrong = np.flatnonzero(np.concatenate([starts[order], [rows]]) < ends)
    return int(order[max(0, wrong[0] - 1)]) if len(wrong) else None


def load_dataset(
    robot: str,
    split: str = "train",
    *,
    indices: Sequence[int] | None = None,
    every: int = 1,
    quality: float | None = None,
    progress: bool = True,
) -> OfflineDataset:
    """Load the data of a robot; the first time flat arrays are made from the Minari datasets, which takes a while.

    Args:
        robot: one of `ids.ROBOTS`.
        split: `train`, or `test` for fine-tuning on test dynamics and for looking at them; training refuses the latter.
        indices: dynamics of the split, in this order; None takes all.
        every: the part of the data that has every n-th snapshot alone (`dynagen data build ROBOT --every 4`).
        quality: keep this share of the episodes, those of the lowest returns; 0.3 is the paper's low-quality data
            (figure 5). The share is of all that is asked for here together, not of each dynamics.
        progress: show a progress bar on the error stream while arrays are made.

    Raises:
        ValueError: an unknown robot, split or index, a `quality` that is no share or of test data, or data that are
            damaged or of other dynamics.
        FileNotFoundError: a dataset is missing; the message has the command that makes it.
        OSError: the disk has no room for the arrays.
    """
    names = _chosen(robot, split, indices)
    if quality is not None and split != "train":
        raise ValueError(
            f"quality is of train data, not of split {split!r}: the paper's test and adaptation data stay as they are"
        )
    if quality is not None:
        check_quality(quality)  # before arrays are made
    records = {name: checked_record(name, every) for name in names}
    foreign = sorted({record.mujoco for record in records.values()} - {version("mujoco")})
    if foreign:
        warnings.warn(
            f"the data of {robot} were made with MuJoCo {', '.join(foreign)}, here is {version('mujoco')}: physics "
            "differ between versions",
            stacklevel=2,
        )
    label = f"{robot}-{split}" if every == 1 else f"{robot}-{split}-every{every}"
    sources = [Source(name.index, dataset_folder(name.part_id(every)), record) for name, record in records.items()]
    dataset = OfflineDataset(robot, split, **map_arrays(label, sources, progress))
    if not dataset.is_whole:
        raise ValueError(f"the flat arrays of {label} are damaged: empty the cache folder {cache_folder()}")
    return dataset if quality is None else dataset.select(worst_episodes(dataset.episode_returns, quality))


def load_adaptation(
    robot: str,
    index: int,
    *,
    split: str = "test",
    episodes: int = ADAPTATION_EPISODES,
    every: int = 1,
    progress: bool = True,
) -> OfflineDataset:
    """Load the adaptation set of one test dynamics: the few episodes that an agent may be fine-tuned on for it.

    Always the same ones, spread over the returns of that dynamics' data (`subsets.spread_episodes`). Normalise them as
    the agent was trained, by its train data. The data of the robot's whole split have to be there.

    Args:
        robot: one of `ids.ROBOTS`.
        index: number of the dynamics in the split.
        split: `test`; or `train` for the same of train dynamics, by which fine-tuning is chosen without the test ones.
        episodes: how many.
        every: of the part of the data that has every n-th snapshot alone.
        progress: show a progress bar on the error stream while arrays are made.

    Raises:
        ValueError: an unknown robot, split or index, more episodes than there are, or data that are damaged.
        FileNotFoundError: a dataset is missing; the message has the command that makes it.
    """
    ids.make_id(robot, split, index)
    ids.check_count("episodes", episodes)  # before arrays are made
    data = load_dataset(robot, split, every=every, progress=progress)
    numbers = np.flatnonzero(data.episode_dynamics == index)
    return data.select(numbers[spread_episodes(data.episode_returns[numbers], episodes)])


def _chosen(robot: str, split: str, indices: Sequence[int] | None) -> list[ids.DynamicsId]:
    ids.check_robot(robot)
    if split not in ("train", "test"):
        raise ValueError(f"there are no data of split {split!r}: choose 'train' or 'test'")
    return ids.choose_ids(robot, split, indices)


def checked_record(name: ids.DynamicsId, every: int) -> DatasetRecord:
    """The record of a dataset on this machine, after a look that it is what its place says.

    Raises:
        FileNotFoundError: it is not there; the message has the command that makes it.
        ValueError: what is there is of other dynamics, or another part.
    """
    folder = dataset_folder(name.part_id(every))
    command = build_command(name.robot, every)
    try:
        record = read_record(folder)
    except FileNotFoundError:
        raise FileNotFoundError(f"no data of {name.env_id} at {folder}: make them with `{command}`") from None
    found = (record.recipe["dynamics"], record.recipe["every"])
    if found != (name.env_id, every):
        raise ValueError(
            f"{folder} holds data of {found[0]}, every={found[1]}, not of {name.env_id}, every={every}: remove it, "
            f"then `{command}`"
        )
    return record
