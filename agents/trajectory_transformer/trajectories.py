"""Trajectories: the K consecutive transitions of an episode that a model of all of it is trained on.

What is here: their sampling, with rewards and discounted values. Called by the config of Trajectory Transformer. It
must not know tokens.

One trajectory of K = 4 at step t = 2 of an episode of four actions. It ended by itself, and then it has ended for good;
or it was cut off at the horizon, and nothing is known of what would follow:

    rows       s2 a2 r2 v2 | s3 a3 r3 v3 |  0  |  0        s normalised, v2 = r3 + γ r4 + …, what follows r2
    ended            -            -        yes   yes       ended by itself
    mask            yes          yes       yes   yes
    ended            -            -         -     -        cut off
    mask            yes          yes        -     -
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench.datasets import Normalization, OfflineDataset
from dynagen_bench.datasets.steps import StepIndex
from dynagen_bench.envs import HORIZON


class Trajectories(NamedTuple):
    """A batch of B trajectories of K transitions, padded on the right."""

    rows: NDArray[np.float32]
    """(B, K, S + A + 2): normalised observation, action, reward and value; 0 after the end."""
    ended: NDArray[np.bool_]
    """(B, K), the episode has ended by itself before this step, and the horizon is not reached."""
    mask: NDArray[np.bool_]
    """(B, K), what is here is known: a transition, or that the episode has ended."""


class TrajectorySampler:
    """Draws trajectories: each step of the data is as likely as another to be the first of one."""

    def __init__(
        self,
        dataset: OfflineDataset,
        context: int,
        normalization: Normalization,
        discount: float,
        termination_penalty: float | None,
    ) -> None:
        """Sample trajectories of `context` = K transitions.

        Args:
            dataset: of any split.
            context: K.
            normalization: of observations.
            discount: γ of values.
            termination_penalty: in place of the reward of a step that ended its episode by itself; None leaves that.

        Raises:
            ValueError: data without steps.
        """
        self._data, self._context, self._normalization = dataset, context, normalization
        self._index = StepIndex(dataset)
        ends = self._index.ends
        offsets = dataset.episode_starts - (ends - dataset.episode_lengths)
        rewards = dataset.rewards[np.repeat(offsets, dataset.episode_lengths) + np.arange(ends[-1])]
        if termination_penalty is not None:
            rewards[ends[dataset.episode_terminated & (dataset.episode_lengths > 0)] - 1] = termination_penalty
        self._rewards = rewards  # (steps,), through all episodes in order
        self._values = discounted_values(rewards, dataset.episode_lengths, discount)  # (steps,)

    @property
    def num_steps(self) -> int:
        """Steps of the data."""
        return len(self._rewards)

    def sample(self, batch_size: int, rng: np.random.Generator) -> Trajectories:
        """Draw `batch_size` = B trajectories; raises ValueError as `StepIndex.draw`."""
        return self.at(self._index.draw(batch_size, rng))

    def at(self, steps: NDArray[np.int64]) -> Trajectories:
        """The trajectories that begin at steps (B,), counted through all episodes in order."""
        data = self._data
        episodes, first, _ = self._index.find(steps)
        timesteps = first[:, None] + np.arange(self._context)  # (B, K)
        real = timesteps < data.episode_lengths[episodes][:, None]
        ended = ~real & data.episode_terminated[episodes][:, None] & (timesteps < HORIZON)
        there = self.rows(np.where(real, steps[:, None] + np.arange(self._context), steps[:, None]))
        return Trajectories(np.where(real[:, :, None], there, np.float32(0)), ended, real | ended)

    def rows(self, steps: NDArray[np.int64]) -> NDArray[np.float32]:
        """Transitions (..., S + A + 2) at steps (...), counted through all episodes in order."""
        data = self._data
        rows = self._index.find(steps).rows
        observations = self._normalization.apply(data.observations[rows])
        numbers = (self._rewards[steps][..., None], self._values[steps][..., None])
        return np.concatenate((observations, data.actions[rows], *numbers), axis=-1)


def discounted_values(rewards: NDArray[np.float32], lengths: NDArray[np.int64], discount: float) -> NDArray[np.float32]:
    """vₜ = rₜ₊₁ + γ rₜ₊₂ + … to the end of the episode, (M,) of rewards (M,) of episodes of lengths (E,) in a row."""
    values = np.zeros(len(rewards), dtype=np.float32)
    order = np.argsort(-lengths, kind="stable")
    firsts, running, ordered = (np.cumsum(lengths) - lengths)[order], np.zeros(len(lengths)), -lengths[order]
    for t in reversed(range(int(lengths.max(initial=0)))):  # all episodes at once, of which the first ones are so long
        longer = int(np.searchsorted(ordered, -t, side="left"))
        steps = firsts[:longer] + t
        values[steps] = running[:longer]
        running[:longer] = rewards[steps] + discount * running[:longer]
    return values
