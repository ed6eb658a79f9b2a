"""Windows: the K consecutive steps of an episode that an agent is trained on.

What is here: seeded sampling of windows from flat data, all of a batch at once. Called by the training loop. It must
not know an agent, nor which split the data are of (fine-tuning samples from test data).

One window of K = 4 at step t = 1 of an episode of three actions; `.` is padding, zero with mask False:

    observations        .    .    s1   s2        (normalised)
    actions             .    .    a1   a2
    next_observations   .    .    s2   s3        (normalised; s3 is the episode's last row)
    returns_to_go       .    .    r1+r2  r2
    timesteps           0    0    1    2
    mask                -    -    yes  yes
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.flat import OfflineDataset
from dynagen_bench.datasets.normalization import Normalization
from dynagen_bench.datasets.steps import StepIndex


class Windows(NamedTuple):
    """A batch of B windows of K steps, padded on the left."""

    observations: NDArray[np.float32]
    """(B, K, S), normalised."""
    actions: NDArray[np.float32]
    """(B, K, A)."""
    next_observations: NDArray[np.float32]
    """(B, K, S), normalised."""
    returns_to_go: NDArray[np.float32]
    """(B, K), undiscounted, from this step's reward to the end of the episode."""
    timesteps: NDArray[np.int64]
    """(B, K), the step's number in its episode."""
    mask: NDArray[np.bool_]
    """(B, K), False where there is padding."""


class WindowSampler:
    """Draws windows: each step of the data is as likely as another to be the first of one.

    That is what kzl/decision-transformer (gym/experiment.py, get_batch) does in two draws: an episode in proportion to
    its length, then a start in it. A window has K steps, or as many as there are to the end of the episode.
    """

    def __init__(self, dataset: OfflineDataset, context: int, normalization: Normalization) -> None:
        """Sample windows of `context` = K steps.

        Raises:
            ValueError: K is no whole number from 1 on, or data without steps.
        """
        self.context = ids.check_count("context", context)
        self._index = StepIndex(dataset)
        self.dataset = dataset
        self.normalization = normalization

    def sample(self, batch_size: int, rng: np.random.Generator) -> Windows:
        """Draw `batch_size` = B windows; raises ValueError if that is no whole number from 1 on."""
        return self.windows_at(self._index.draw(batch_size, rng))

    def windows_at(self, steps: NDArray[np.int64]) -> Windows:
        """The windows that begin at steps (B,), counted through all episodes in order."""
        data = self.dataset
        episodes, first, _ = self._index.find(steps)  # (B,), `first` the timestep at which the window begins
        size = np.minimum(self.context, data.episode_lengths[episodes] - first)  # (B,) steps that are no padding
        position = np.arange(self.context) - (self.context - size)[:, None]  # (B, K), negative in the padding
        mask = position >= 0
        timesteps = np.where(mask, first[:, None] + position, 0)
        rows = data.episode_starts[episodes][:, None] + timesteps  # (B, K); padding reads the episode's first row
        keep = mask[..., None]
        return Windows(
            observations=np.where(keep, self.normalization.apply(data.observations[rows]), np.float32(0)),
            actions=np.where(keep, data.actions[rows], np.float32(0)),
            next_observations=np.where(keep, self.normalization.apply(data.observations[rows + 1]), np.float32(0)),
            returns_to_go=np.where(mask, data.returns_to_go[rows], np.float32(0)),
            timesteps=timesteps,
            mask=mask,
        )
