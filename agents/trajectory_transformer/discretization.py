"""Numbers as tokens: bins of equal counts, for each dimension its own.

What is here: the thresholds of data, and `Discretizer`, which holds them and takes numbers to tokens and back. Called
by Trajectory Transformer. It must not know what a dimension means, nor where data come from.

    numbers      -1.3 … 0.0 … 0.4 … 7.1          N bins a dimension, each with as many numbers of the data
    thresholds   |   |  | | ||| | |      |       N + 1, from the smallest number to the largest
    tokens         0  1  2 …          N-1        and N for stop, which stands for no number

After github.com/JannerM/trajectory-transformer (trajectory/utils/discretization.py, QuantileDiscretizer), with one
difference: its bins have a rounded-up number of data each, so that the last ones may be empty; here counts differ by
one at most.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn


def quantile_thresholds(rows: NDArray[np.float32], bins: int) -> NDArray[np.float32]:
    """Thresholds (J, N + 1) of `bins` = N bins for each column of rows (M, J).

    Bin n has the numbers from threshold n on that are below the next; the last bin has the largest number too. Where
    one number is so frequent that it fills bins, those are empty but the last of them.

    Raises:
        ValueError: no rows, or not all finite.
    """
    if len(rows) == 0 or not np.isfinite(rows).all():
        raise ValueError(f"{len(rows)} rows to make bins of, finite: {np.isfinite(rows).all()}: give finite numbers")
    ordered = np.sort(rows, axis=0)
    firsts = np.arange(bins) * len(rows) // bins
    return np.ascontiguousarray(np.concatenate((ordered[firsts], ordered[-1:])).T, dtype=np.float32)


class Discretizer(nn.Module):
    """Thresholds of J dimensions, kept as parameters that no gradient moves: a checkpoint has them."""

    def __init__(self, dimensions: int, bins: int) -> None:
        """Without thresholds yet: see `fit`."""
        super().__init__()
        self.bins = bins
        self.thresholds = nn.Parameter(torch.full((dimensions, bins + 1), torch.nan), requires_grad=False)

    @property
    def stop(self) -> int:
        """The token that stands for no number, N."""
        return self.bins

    def fit(self, rows: NDArray[np.float32]) -> None:
        """Take the thresholds of rows (M, J); raises ValueError as `quantile_thresholds` does."""
        with torch.no_grad():
            self.thresholds.copy_(torch.from_numpy(quantile_thresholds(rows, self.bins)))

    def encode(self, numbers: Tensor, first: int = 0) -> Tensor:
        """Tokens (..., J') int64 of numbers (..., J') of the dimensions from `first` on.

        What is outside the data's range gets the nearest bin.

        Raises:
            RuntimeError: there are no thresholds.
        """
        count = numbers.shape[-1]
        thresholds = self._fitted()[first : first + count]
        columns = numbers.reshape(-1, count).T.contiguous()
        found = torch.searchsorted(thresholds, columns, right=True) - 1
        return found.clamp_(0, self.bins - 1).T.reshape(numbers.shape)

    def decode(self, tokens: Tensor, first: int = 0) -> Tensor:
        """The middles (..., J') float32 of the bins of tokens (..., J'); stop is read as the last bin, as there."""
        columns = torch.arange(first, first + tokens.shape[-1], device=tokens.device)
        return self._middles()[columns, tokens.clamp(max=self.bins - 1)]

    def expect(self, probabilities: Tensor, dimension: int) -> Tensor:
        """Mean (...) of the bins' middles, of probabilities (..., N + 1); stop counts as 0."""
        return probabilities[..., :-1] @ self._middles()[dimension]

    def _fitted(self) -> Tensor:
        if self.thresholds.isnan().any():
            raise RuntimeError("the discretizer has no thresholds: fit it to training data, or load a checkpoint")
        return self.thresholds

    def _middles(self) -> Tensor:
        """(J, N) float32; of two neighbouring float32 numbers the lower one, so that it is in the bin."""
        low, high = self._fitted()[:, :-1], self.thresholds[:, 1:]
        middles = (low + high) / 2
        return torch.where(middles < high, middles, low)
