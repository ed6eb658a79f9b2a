"""Transformer-BC: behaviour cloning by a transformer, the paper's baseline of Table 2.

What is here: Decision Transformer without the return token (the paper, Table 2: it "trains transformer using behavior
cloning without return-to-go conditioning"). Called through `AGENTS`. It must not know the training loop.

    tokens   sₜ  aₜ
    trunk     ╰──╯
    head     aₜ
"""

import dataclasses
from typing import Final

import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy, blockwise
from agents.config import TransformerConfig
from agents.dt import StepEncoder, masked_mean_square
from agents.interface import History, RobotSpec
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows

STATE: Final = 0
"""Place of a step's state token; its action follows."""


@dataclasses.dataclass(frozen=True)
class TransformerBCConfig(TransformerConfig):
    """Table 6 without returns and state prediction."""


class TransformerBC(nn.Module):
    """Predicts a step's action from its state and the steps before."""

    limit: Tensor

    def __init__(self, config: TransformerBCConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        self.encoder = StepEncoder((spec.state_size, spec.action_size), config, generator)
        self.action_head = linear(config.embedding, spec.action_size, generator)
        self.register_buffer("limit", torch.from_numpy(spec.action_limit), persistent=False)

    def actions(self, at_states: Tensor) -> Tensor:
        """Actions (..., A) from the trunk's output at state tokens (..., D), inside the action space."""
        return torch.tanh(self.action_head(at_states)) * self.limit

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the actions; see `interface.Agent`."""
        history = History.of(windows, self.limit.device)
        history.check(self.spec.state_size, self.spec.action_size)
        inputs = (history.observations, history.actions)
        (at_states,) = self.encoder(inputs, history.timesteps, history.mask, (STATE,), generator)
        loss = masked_mean_square(self.actions(at_states) - history.actions, history.mask)
        return loss, {"action_loss": loss}

    def act(self, history: History) -> Tensor:
        """The last step's action (B, A)."""
        history.check(self.spec.state_size, self.spec.action_size)
        inputs = (history.observations, history.actions)
        return self.actions(self.encoder.last(inputs, history.timesteps, history.mask, STATE))

    def policy(self) -> ContextPolicy:
        """Acts on states and its own actions; no return is wanted of it."""
        return ContextPolicy(blockwise(self.act, self.limit.device), self.config.context, self.spec)
