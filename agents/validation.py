"""Selection without peeking: how an agent in training does in train dynamics that it is not trained on.

What is here: which dynamics are held out, what is measured in them, and when training stops by it. Called by `train`,
`evaluate`, and by `trained_run` for what is chosen there. It must not know the training loop, nor test dynamics: those
are for the result alone.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch

from agents.config import TrainingConfig
from agents.interface import Agent, Phased, RobotSpec, Trainable
from dynagen_bench import ids
from dynagen_bench.datasets import OfflineDataset
from dynagen_bench.evaluation import evaluate

BATCHES: Final = 64
"""Of the validation loss: always the same ones, in every run on the same data; 4,096 windows in batches of 64."""


def held_out_indices(count: int) -> range:
    """The last `count` train dynamics."""
    size = ids.SPLIT_SIZES["train"]
    return range(size - count, size)


def set_apart(dataset: OfflineDataset, count: int) -> tuple[OfflineDataset, OfflineDataset | None]:
    """The data to train on, and those of the last `count` train dynamics, None if none are held out; no row is copied.

    Raises:
        ValueError: one of the two has no episode.
    """
    if count == 0:
        return dataset, None
    held = np.isin(dataset.episode_dynamics, held_out_indices(count))
    if held.all() or not held.any():
        raise ValueError(
            f"of the {len(held)} episodes {held.sum()} are of the {count} train dynamics that are held out: give "
            "another --hold-out, or more of the data"
        )
    return dataset.select(np.flatnonzero(~held)), dataset.select(np.flatnonzero(held))


class Validation:
    """What is measured in the held-out dynamics."""

    def __init__(self, held: OfflineDataset, count: int, config: TrainingConfig, spec: RobotSpec) -> None:
        """Measure in the last `count` train dynamics, and on their data `held`.

        Args:
            held: their data.
            count: how many they are.
            config: says what the batches of the loss are.
            spec: the robot's, with the normalisation of the data that are trained on.
        """
        self._robot, self._indices, self._batch_size = spec.robot, held_out_indices(count), config.batch_size
        self._sampler = config.sampler(held, spec.normalization)

    def measure(self, agent: Trainable) -> dict[str, float]:
        """`validation_loss`, without dropout, and of an agent that acts `validation_return`, over all episodes.

        The start states are those that `evaluate` takes by default.
        """
        found = {"validation_loss": self._loss(agent)}
        if isinstance(agent, Agent):
            evaluation = evaluate(agent.policy(), self._robot, "train", indices=self._indices, traces=False)
            found["validation_return"] = float(evaluation.returns.mean())
        return found

    def _loss(self, agent: Trainable) -> float:
        losses = []
        for batch in range(BATCHES):
            drawn = self._sampler.sample(self._batch_size, np.random.default_rng(batch))
            with torch.no_grad():
                losses.append(agent.loss(drawn, None)[0].item())
        return float(np.mean(losses))


def check_patience(name: str, agent: Trainable, patience: int) -> None:
    """Raise ValueError if an agent's training is not to be stopped by its returns."""
    if patience and not isinstance(agent, Agent):
        raise ValueError(f"patience is {patience}: {name} has no returns, it does not act; give 0")
    if patience and isinstance(agent, Phased):
        raise ValueError(f"patience is {patience}: {name} learns in phases, and ends with the last one; give 0")


def has_stalled(points: Sequence[tuple[int, float]], every: int, patience: int) -> bool:
    """Whether none of the last `patience` returns beats the best before them; always False of patience 0.

    Of the points (step, return) those at every `every` steps count: a run that was once shorter has one more, at its
    end then, and stops where a run does that was never shorter.
    """
    if not patience:
        return False
    returns = [value for step, value in points if step % every == 0]
    return patience < len(returns) and max(returns[-patience:]) <= max(returns[:-patience])
