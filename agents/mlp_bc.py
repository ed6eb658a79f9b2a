"""MLP-BC: behaviour cloning by the present state alone, which cannot tell one body from another.

What is here: a control, no baseline of the paper. Windows, loss and batches are Transformer-BC's, which differs from it
by the episode so far, the timestep and the net. Called through `AGENTS`. It must not know the training loop.

    input    sₜ
    net      2 × 256, relu
    output   aₜ = limit · tanh(net(sₜ))

The net is the actor of TD3+BC (Fujimoto and Gu, 2021; github.com/sfujim/TD3_BC, TD3_BC.py), whose authors clone with it
too.
"""

import dataclasses
from typing import Final

import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy, blockwise
from agents.config import TrainingConfig, check_ranges
from agents.dt import masked_mean_square
from agents.interface import History, RobotSpec
from agents.nets import Nets
from dynagen_bench.datasets.windows import Windows


@dataclasses.dataclass(frozen=True)
class MLPBCConfig(TrainingConfig):
    """Sampled and optimised as the transformers are; the net is TD3+BC's."""

    layers: int = 2
    """Hidden layers."""
    hidden: int = 256
    """Units of each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, {"layers": (1, 100), "hidden": (1, 65536)})


class MLPBC(nn.Module):
    """Predicts a step's action from its state."""

    limit: Tensor

    memoryless: Final = True
    """See `interface.Memoryless`."""

    def __init__(self, config: MLPBCConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.spec = spec
        self.net = Nets(1, (spec.state_size, *[config.hidden] * config.layers, spec.action_size), generator)
        self.register_buffer("limit", torch.from_numpy(spec.action_limit), persistent=False)

    def actions(self, observations: Tensor) -> Tensor:
        """Actions (B, A) for normalised observations (B, S), inside the action space."""
        (outputs,) = self.net(observations)
        return torch.tanh(outputs) * self.limit

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the actions; nothing is drawn from the generator. See `interface.Agent`."""
        history = History.of(windows, self.limit.device)
        history.check(self.spec.state_size, self.spec.action_size)
        found = self.actions(history.observations.flatten(0, 1)).view_as(history.actions)
        loss = masked_mean_square(found - history.actions, history.mask)
        return loss, {"action_loss": loss}

    def act(self, history: History) -> Tensor:
        """The last step's action (B, A)."""
        return self.actions(history.observations[:, -1])

    def policy(self) -> ContextPolicy:
        """Acts on the present state: a history of one step."""
        return ContextPolicy(blockwise(self.act, self.limit.device), 1, self.spec)
