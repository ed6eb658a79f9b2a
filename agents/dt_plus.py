"""DT+: a Decision Transformer that is trained to act, and then read for the next state (the paper, Table 3).

What is here: DADT's network, trained in two phases in place of one: first Decision Transformer's own training, then a
linear head on the frozen rest. Called through `AGENTS`. It must not know the training loop.

    step       0 …… trunk_steps             trunk_steps …… steps
    trained    all that is Decision         the head of the next state
               Transformer's, on actions    alone, on next states

The paper says neither how long each phase is nor how the head is trained. Here each has half of the steps if nothing
else is said, and one optimiser is for both. In the second phase dropout is left out: in a trunk that learns nothing
more it would only be noise in what the head reads, and the comparison with DADT is to be no worse for DT+ by it.
"""

import dataclasses
from typing import Self

import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy
from agents.config import check_first_phase
from agents.dadt import next_states
from agents.dt import ACTION, DecisionTransformer, DTConfig
from agents.interface import History, RobotSpec
from agents.mlp import next_state_loss
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows


@dataclasses.dataclass(frozen=True)
class DTPlusConfig(DTConfig):
    """Decision Transformer's, and how long it is trained before the head is."""

    trunk_steps: int | None = None
    """Steps of the first phase, below `steps`; half of them if left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_first_phase(self, "trunk_steps", rest="the head")

    def for_robot(self, robot: str) -> Self:
        """This config with the robot's target return and the first phase's steps filled in."""
        config = super().for_robot(robot)
        if config.trunk_steps is not None:
            return config
        return dataclasses.replace(config, trunk_steps=max(1, config.steps // 2))


class DTPlus(nn.Module):
    """A Decision Transformer and a head on its action tokens; acts as the former, which the head never changes."""

    def __init__(self, config: DTPlusConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.trunk_steps = config.for_robot(spec.robot).trunk_steps
        self.dt = DecisionTransformer(config, spec, generator)  # before the head: its first weights are as without one
        self.next_state_head = linear(config.embedding, spec.state_size, generator)
        self.begin(0)

    def begin(self, step: int) -> None:
        """Go to the phase of a step; see `interface.Phased`."""
        assert self.trunk_steps is not None  # for_robot has filled it in
        self._trunk_is_frozen = step >= self.trunk_steps

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Action error in the first phase, next-state error in the second; see `interface.Agent`."""
        if not self._trunk_is_frozen:
            return self.dt.loss(windows, generator)
        with torch.no_grad():  # nothing flows back into the trunk, so that none of it is kept for a backward pass
            (at_actions,) = self.dt.encode(History.of(windows, self.dt.limit.device), (ACTION,))
        return next_state_loss(self.next_state_head(at_actions), windows)

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S); see `interface.Predictor`."""
        return next_states(self.dt, self.next_state_head, windows)

    def policy(self) -> ContextPolicy:
        """As Decision Transformer's."""
        return self.dt.policy()
