"""The offline data of a robot as flat float32 arrays, memory-mapped.

What is here: `OfflineDataset`, its layout, and `load_dataset`. Called by training, evaluation of data, and users. It
must not know windows, agents or scores, nor how the arrays are cached.

Each episode takes T + 1 rows: its T steps, and one last row with the final observation, no action and no reward. Two
episodes of 3 and 2 steps:

    row               0    1    2    3  |  4    5    6
    observations      s0   s1   s2   s3 |  s0'  s1'  s2'
    actions           a0   a1   a2   0  |  a0'  a1'  0
    rewards           r0   r1   r2   0  |  r0'  r1'  0
    returns_to_go     R0   R1   R2   0  |  R0'  R1'  0       R1 = r1 + r2, undiscounted

    episode_starts    0, 4
    episode_lengths   3, 2
"""

import dataclasses
import warnings
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, dataset_folder, read_record
from dynagen_bench.datasets.flat_files import Source, map_arrays
from dynagen_bench.datasets.normalization import Normalization, statistics


@dataclasses.dataclass(frozen=True, eq=False)
class OfflineDataset:
    """The data of one split of one robot: M rows, E episodes.

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
        """Check that the arrays fit together; raises ValueError naming the first one that does not."""
        rows = int(self.episode_lengths.sum()) + len(self.episode_lengths)
        for field in dataclasses.fields(self)[2:]:
            expected = len(self.episode_lengths) if field.name.startswith("episode_") else rows
            found = len(getattr(self, field.name))
            if found != expected:
                raise ValueError(f"{field.name} has {found} rows: the episode lengths ask for {expected}")

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
        """Number of actions in the data; there are `len(episode_lengths)` more rows."""
        return int(self.episode_lengths.sum())

    def normalization(self) -> Normalization:
        """Mean and deviation of the observations that an action was taken at (kzl/decision-transformer: all states).

        Raises:
            ValueError: these are test data, which no agent may be normalised by.
        """
        if self.split != "train":
            raise ValueError(
                f"this is split {self.split!r}: normalisation is of train data, load_dataset(..., 'train')"
            )
        chosen = np.ones(len(self.observations), dtype=np.bool_)
        chosen[self.episode_starts + self.episode_lengths] = False
        return statistics(self.observations, chosen)


def load_dataset(
    robot: str, split: str = "train", *, indices: Sequence[int] | None = None, every: int = 1, progress: bool = True
) -> OfflineDataset:
    """Load the data of a robot; the first time flat arrays are made from the Minari datasets, which takes a while.

    Args:
        robot: one of `ids.ROBOTS`.
        split: `train`, or `test` for fine-tuning on test dynamics and for looking at them; training refuses the latter.
        indices: dynamics of the split, in this order; None takes all.
        every: the part of the data that has every n-th snapshot alone (`dynagen data build ROBOT --every 4`).
        progress: show a progress bar on the error stream while arrays are made.

    Raises:
        ValueError: an unknown robot, split or index, or data that are damaged or of other dynamics.
        FileNotFoundError: a dataset is missing; the message has the command that makes it.
    """
    names = _chosen(robot, split, indices)
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
    return OfflineDataset(robot, split, **map_arrays(label, sources, progress))


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
    command = f"dynagen data build {name.robot}" + ("" if every == 1 else f" --every {every}")
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
