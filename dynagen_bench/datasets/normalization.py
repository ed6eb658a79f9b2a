"""Normalisation of observations.

What is here: `Normalization` and its statistics. Called by the flat data, the windows and acting agents. It must not
know which data it is made of: that they are train data is checked where they are (`OfflineDataset.normalization`).
"""

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

EPSILON: Final = 1e-6
"""Keeps constant observations finite (kzl/decision-transformer, gym/experiment.py)."""

_CHUNK: Final = 1 << 18
"""Rows that are in memory as float64 at once."""


@dataclasses.dataclass(frozen=True, eq=False)
class Normalization:
    """Mean and standard deviation of each element of an observation.

    Attributes:
        mean: (S,) float32.
        std: (S,) float32.

    Raises:
        ValueError: they are not of one shape (S,).
    """

    mean: NDArray[np.float32]
    std: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.mean.ndim != 1 or self.mean.shape != self.std.shape:
            raise ValueError(f"mean has shape {self.mean.shape} and std {self.std.shape}: give both the shape (S,)")

    def apply(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """(s − mean) / (std + 1e-6) of observations (..., S), float32.

        Raises:
            ValueError: the observations have another number of elements; NumPy would stretch a single one over all.
        """
        given = np.asarray(observations, dtype=np.float32)
        if given.shape[-1:] != self.mean.shape:
            raise ValueError(
                f"normalization is of {len(self.mean)} elements, and observations have shape {given.shape}: give that "
                "of the same robot's data"
            )
        return (given - self.mean) / (self.std + np.float32(EPSILON))


def statistics(observations: NDArray[np.floating[Any]], chosen: NDArray[np.bool_]) -> Normalization:
    """Mean and population standard deviation of the chosen rows (M,) of observations (M, S).

    Two passes in float64, in chunks: the data are larger than memory where that matters.

    Raises:
        ValueError: no row is chosen.
    """
    count = int(chosen.sum())
    if count == 0:
        raise ValueError("no observations to normalise by: the data have no steps")
    chunks = [slice(start, start + _CHUNK) for start in range(0, len(observations), _CHUNK)]
    total = np.zeros(observations.shape[1])
    for chunk in chunks:
        total += observations[chunk][chosen[chunk]].sum(axis=0, dtype=np.float64)
    mean = total / count
    squares = np.zeros_like(mean)
    for chunk in chunks:
        squares += np.square(observations[chunk][chosen[chunk]].astype(np.float64) - mean).sum(axis=0)
    return Normalization(mean.astype(np.float32), np.sqrt(squares / count).astype(np.float32))
