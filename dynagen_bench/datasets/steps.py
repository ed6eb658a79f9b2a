"""Which row a step has: steps are counted through all episodes in order, and rows are those of the flat arrays.

What is here: `StepIndex`. Called by whatever draws steps of a dataset. It must not know what is made of them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.flat import OfflineDataset


class Places(NamedTuple):
    """Where steps (...) are."""

    episodes: NDArray[np.int64]
    """(...), number of the episode."""
    timesteps: NDArray[np.int64]
    """(...), steps of the episode before it."""
    rows: NDArray[np.int64]
    """(...), row of the dataset's arrays."""


class StepIndex:
    """The steps of a dataset, any of which is found in no time.

    Attributes:
        ends: (E,) int64, number of steps up to the end of each episode.
    """

    def __init__(self, dataset: OfflineDataset) -> None:
        """Raises ValueError for data without steps."""
        if dataset.num_steps == 0:
            raise ValueError(f"the {dataset.split} data of {dataset.robot} have no steps to sample")
        self._starts, self._lengths = dataset.episode_starts, dataset.episode_lengths
        self.ends = np.cumsum(self._lengths)

    def draw(self, batch_size: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Numbers of `batch_size` = B steps, (B,), each as likely as another.

        Raises:
            ValueError: the batch size is no whole number from 1 on.
            TypeError: a seed in place of a generator.
        """
        if not isinstance(rng, np.random.Generator):
            raise TypeError(f"rng is {rng!r}: give a generator, np.random.default_rng(seed)")
        return rng.integers(int(self.ends[-1]), size=ids.check_count("batch_size", batch_size))

    def find(self, steps: NDArray[np.int64]) -> Places:
        """The places of steps (...); raises ValueError if the data have not so many."""
        outside = (steps < 0) | (steps >= self.ends[-1])
        if outside.any():
            step = int(np.asarray(steps)[outside][0])
            raise ValueError(f"there is no step {step}: give numbers from 0 to {self.ends[-1] - 1}")
        episodes = np.searchsorted(self.ends, steps, side="right")
        timesteps = steps - (self.ends[episodes] - self._lengths[episodes])
        return Places(episodes, timesteps, self._starts[episodes] + timesteps)
