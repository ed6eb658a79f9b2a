"""Single steps of a dataset, for what learns from them: state, action, reward, next state, and whether it ended there.

What is here: `Transitions`, `transitions_at`, and `TransitionSampler`. Called by users whose algorithms bootstrap (IQL,
CQL, TD3+BC), and by a sampler of the agents. It must not know agents; a dynamics is a number to it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench.datasets.flat import OfflineDataset
from dynagen_bench.datasets.normalization import Normalization
from dynagen_bench.datasets.steps import StepIndex


class Transitions(NamedTuple):
    """Steps (...) of a dataset."""

    observations: NDArray[np.float32]
    """(..., S)."""
    actions: NDArray[np.float32]
    """(..., A)."""
    rewards: NDArray[np.float32]
    """(...)."""
    next_observations: NDArray[np.float32]
    """(..., S)."""
    terminal: NDArray[np.bool_]
    """(...), the step ended the episode by itself. An episode that reached the horizon could have gone on: False."""
    dynamics: NDArray[np.int64]
    """(...), number of the step's dynamics in the split; privileged, as no observation shows it."""


def transitions_at(
    dataset: OfflineDataset, index: StepIndex, steps: NDArray[np.int64], normalization: Normalization | None
) -> Transitions:
    """The steps (...) of these numbers, counted through all episodes in order; `index` is of the dataset."""
    episodes, timesteps, rows = index.find(steps)
    before, after = dataset.observations[rows], dataset.observations[rows + 1]
    if normalization is not None:
        before, after = normalization.apply(before), normalization.apply(after)
    return Transitions(
        observations=before,
        actions=dataset.actions[rows],
        rewards=dataset.rewards[rows],
        next_observations=after,
        terminal=dataset.episode_terminated[episodes] & (timesteps == dataset.episode_lengths[episodes] - 1),
        dynamics=dataset.episode_dynamics[episodes],
    )


class TransitionSampler:
    """Draws steps: each of the data is as likely as another."""

    def __init__(self, dataset: OfflineDataset, normalization: Normalization | None = None) -> None:
        """Sample steps, with observations as they are or normalised.

        Raises:
            ValueError: data without steps.
        """
        self._data, self._index, self._normalization = dataset, StepIndex(dataset), normalization

    def sample(self, batch_size: int, rng: np.random.Generator) -> Transitions:
        """Draw `batch_size` = B steps, (B, ...); raises ValueError if that is no whole number from 1 on."""
        return self._at(self._index.draw(batch_size, rng))

    def everything(self) -> Transitions:
        """All steps in order, (N, ...) with N = `dataset.num_steps`, copied into memory: to fill another's buffer."""
        return self._at(np.arange(self._data.num_steps))

    def _at(self, steps: NDArray[np.int64]) -> Transitions:
        return transitions_at(self._data, self._index, steps, self._normalization)
