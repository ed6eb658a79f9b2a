"""Single steps of several dynamics, told apart: what agents with annotated data are trained on.

What is here: `TaskSampler`. Called by the configs of FOCAL and MerPO (the paper, section 5.2: they
"are trained with trajectories annotated with dynamics-id"). It must not know agents; a dynamics is a number to it, and
nothing of its mass or friction.
"""

import numpy as np
from numpy.typing import NDArray

from dynagen_bench.datasets import Normalization, OfflineDataset, Transitions
from dynagen_bench.datasets.steps import StepIndex
from dynagen_bench.datasets.transitions import transitions_at


class TaskSampler:
    """Draws M dynamics, and B steps of each: any step of a dynamics' data is as likely as another."""

    def __init__(self, dataset: OfflineDataset, normalization: Normalization, tasks: int) -> None:
        """Sample `tasks` = M dynamics at once, each once; all of them where there are no more.

        Raises:
            ValueError: data without steps.
        """
        self._data = dataset.select(np.argsort(dataset.episode_dynamics, kind="stable"))
        self._index, self._normalization = StepIndex(self._data), normalization
        ends = self._index.ends
        self.dynamics, first = np.unique(self._data.episode_dynamics, return_index=True)
        self._bounds = np.append(np.append(0, ends)[first], ends[-1])  # steps up to each dynamics' first
        self._tasks = min(tasks, len(self.dynamics))

    def sample(self, batch_size: int, rng: np.random.Generator) -> Transitions:
        """Draw `batch_size` = B steps of each of M dynamics, which are in order: (M, B, ...), normalised."""
        chosen = np.sort(rng.permutation(len(self.dynamics))[: self._tasks])
        low, high = self._bounds[chosen], self._bounds[chosen + 1]
        return self._at(rng.integers(low[:, None], high[:, None], size=(self._tasks, batch_size)))

    def everything(self) -> Transitions:
        """All steps of the data, of one dynamics, (1, N, ...).

        Raises:
            ValueError: the data are of several.
        """
        if len(self.dynamics) != 1:
            raise ValueError(f"the data are of {len(self.dynamics)} dynamics: give those of one")
        return self._at(np.arange(self._bounds[-1])[None])

    def _at(self, steps: NDArray[np.int64]) -> Transitions:
        """The steps (M, B), counted through all episodes by dynamics."""
        return transitions_at(self._data, self._index, steps, self._normalization)
