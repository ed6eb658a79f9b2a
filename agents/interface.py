"""What passes between the agents and the rest: the robot's facts, what an agent sees, what an agent offers.

What is here: `RobotSpec`, `History` and the protocols: `Agent`, `Predictor` and what both are for the training loop.
Every agent, `acting`, `checkpoint` and `learner` use it. It must not know any agent.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dynagen_bench.datasets import OfflineDataset
from dynagen_bench.datasets.normalization import Normalization
from dynagen_bench.datasets.windows import Windows
from dynagen_bench.evaluation import Policy, action_space


@dataclasses.dataclass(frozen=True, eq=False)
class RobotSpec:
    """What the robot and its training data fix, and no hyperparameter changes.

    Attributes:
        robot: one of `ids.ROBOTS`.
        action_limit: (A,) float32, the action space is ± this (0.4 for SlimHumanoid, 1 for the others).
        normalization: of observations, from the training data.
    """

    robot: str
    action_limit: NDArray[np.float32]
    normalization: Normalization

    @classmethod
    def of_robot(cls, robot: str, normalization: Normalization) -> Self:
        """The facts of a robot, its action limit asked of the environment."""
        space = action_space(robot)
        assert np.array_equal(space.low, -space.high), f"{robot}'s action space is not symmetric"
        return cls(robot, space.high.astype(np.float32), normalization)

    @property
    def state_size(self) -> int:
        """S."""
        return len(self.normalization.mean)

    @property
    def action_size(self) -> int:
        """A."""
        return len(self.action_limit)


class History(NamedTuple):
    """The last K steps of B episodes, as an agent may see them when it acts; left padded, tensors.

    The last step's action is not taken yet when acting: it is zero there, and no agent may use a step's action for it.
    """

    observations: Tensor
    """(B, K, S) float32, normalised."""
    actions: Tensor
    """(B, K, A) float32."""
    returns_to_go: Tensor
    """(B, K) float32, undiscounted and unscaled."""
    timesteps: Tensor
    """(B, K) int64, 0 at the start of an episode."""
    mask: Tensor
    """(B, K) bool, False at padded steps."""

    @classmethod
    def of(cls, windows: Windows, device: torch.device | None = None) -> Self:
        """The part of a training window that an agent may see; next observations are a target only."""
        return cls(*(torch.from_numpy(getattr(windows, field)).to(device) for field in cls._fields))

    def check(self, state_size: int, action_size: int) -> None:
        """Assert the shapes that the fields' documentation states."""
        batch, context = self.mask.shape
        assert self.observations.shape == (batch, context, state_size), self.observations.shape
        assert self.actions.shape == (batch, context, action_size), self.actions.shape
        assert self.returns_to_go.shape == self.timesteps.shape == (batch, context), self.returns_to_go.shape


class Sampler(Protocol):
    """Draws what a gradient step is computed from; most draw `Windows`."""

    def sample(self, batch_size: int, rng: np.random.Generator) -> Any:
        """One batch, from `rng` alone."""


class Trainable(Protocol):
    """What the training loop needs; a `torch.nn.Module` with `loss` is one.

    Its class is called as `TrainableClass(config, spec, generator)`, the generator drawing its first parameters.
    Parameters that a loss does not reach stay as they are in its step.
    """

    def loss(self, windows: Any, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss to minimise, and its parts by name.

        Args:
            windows: what the sampler of the agent's config drew.
            generator: draws dropout and other noise; None leaves dropout out.
        """

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """As of `torch.nn.Module`."""

    def named_parameters(self) -> Iterator[tuple[str, torch.nn.Parameter]]:
        """As of `torch.nn.Module`."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> Any:
        """As of `torch.nn.Module`."""

    def to(self, device: torch.device) -> Self:
        """As of `torch.nn.Module`."""


@runtime_checkable
class Agent(Trainable, Protocol):
    """Acts: one of `AGENTS`."""

    def policy(self) -> Policy:
        """A new policy acting with the parameters of this agent, at the start of its episodes."""


class Memoryless(Agent, Protocol):
    """Acts by the present state alone: what the episode has shown before, it is not told."""

    memoryless: bool
    """True; whoever remembers something of the episode has no such attribute."""


@runtime_checkable
class Contextual(Agent, Protocol):
    """Is told the dynamics by data of it, and takes no gradient steps there."""

    def policy_given(self, dataset: OfflineDataset) -> Policy:
        """A policy for the one dynamics that the data are of; privileged."""


@runtime_checkable
class Predictor(Trainable, Protocol):
    """Predicts the next state: one of `PREDICTORS`, and agents that can."""

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S) float32, each from its step and those before in the window; no dropout.

        Numbers at padded steps mean nothing. It does not look at `windows.next_observations` of its own step or later.
        """


@runtime_checkable
class Phased(Protocol):
    """Is told how far training is: for agents that learn one thing after another."""

    def begin(self, step: int) -> None:
        """The update number `step`, counted from 0, comes next; `step` may be any, in a run that continues."""


@runtime_checkable
class Following(Protocol):
    """Has parameters that move without a gradient: slow copies of others, and multipliers."""

    def follow(self, values: Mapping[str, float]) -> None:
        """An update is done; `values` are the losses and parts that it was computed from."""


@runtime_checkable
class ForTask(Protocol):
    """Has a part of its own for each dynamics, and makes one for a dynamics that it has not seen."""

    def for_task(self) -> Agent:
        """A new agent of one dynamics, made of what is common to all; `loss` trains it on data of that dynamics.

        This agent stays as it is. The new one acts for its dynamics.
        """


@runtime_checkable
class Fitted(Protocol):
    """Has parameters that are statistics of its training data."""

    def fit(self, sampler: Any) -> None:
        """Take them from what the sampler of the agent's config draws from, before the first step of training.

        Not again in a run that continues or in fine-tuning: a checkpoint has them.
        """
