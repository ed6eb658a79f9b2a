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
    """

    mean: NDArray[np.float32]
    std: NDArray[np.float32]

    def apply(self, observations: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """(s − mean) / (std + 1e-6) of observations (..., S), float32."""
        centred = np.asarray(observations, dtype=np.float32) - self.mean
        return centred / (self.std + np.float32(EPSILON))


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
