"""Transformer-BC: behaviour cloning by a transformer, the paper's baseline of Table 2.

What is here: Decision Transformer without the return token (the paper, Table 2: it "trains transformer using behavior
cloning without return-to-go conditioning"). Called through `AGENTS`. It must not know the training loop.

    tokens   sₜ  aₜ
    trunk     ╰──╯
    head     aₜ
"""

import dataclasses

import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy
from agents.config import TransformerConfig
from agents.dt import StepEncoder, masked_mean_square
from agents.interface import History, RobotSpec
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows


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

    def actions(self, history: History, generator: torch.Generator | None = None) -> Tensor:
        """Actions (B, K, A), each from the states up to its step and the actions before it."""
        history.check(self.spec.state_size, self.spec.action_size)
        inputs = (history.observations, history.actions)
        encoded = self.encoder(inputs, history.timesteps, history.mask, generator)  # (B, K, 2, D)
        return torch.tanh(self.action_head(encoded[:, :, 0])) * self.limit  # on the state token

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the actions; see `interface.Agent`."""
        history = History.of(windows)
        loss = masked_mean_square(self.actions(history, generator) - history.actions, history.mask)
        return loss, {"action_loss": loss}

    def act(self, history: History) -> Tensor:
        """The last step's action (B, A)."""
        return self.actions(history)[:, -1]

    def policy(self) -> ContextPolicy:
        """Acts on states and its own actions; no return is wanted of it."""
        return ContextPolicy(self.act, self.config.context, self.spec)
