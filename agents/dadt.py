"""Dynamics-Augmented Decision Transformer (the paper): Decision Transformer that also predicts the next state.

What is here: what DADT adds to `dt`: one linear head and one term of the loss. Called through `AGENTS`. It must not
know the training loop, nor in which dynamics a window was collected.

    tokens   R̂ₜ  sₜ  aₜ
    trunk     ╰───┴───╯
    heads         aₜ  sₜ₊₁      the next state from its step's action token: from all tokens up to it
    loss     mean (âₜ − aₜ)² + λ · mean (ŝₜ₊₁ − sₜ₊₁)²,  states normalised, both means over steps that are no padding

The paper fixes neither the token that the next state is predicted from nor the scale of its error: the action token is
where the original Decision Transformer has its (untrained) state head, and normalised states are what all agents get.
"""

import dataclasses

import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy
from agents.config import check_ranges
from agents.dt import ACTION, STATE, DecisionTransformer, DTConfig, masked_mean_square
from agents.interface import History, RobotSpec
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows


@dataclasses.dataclass(frozen=True)
class DADTConfig(DTConfig):
    """Table 6."""

    next_state_weight: float = 0.05
    """λ, the weight of the next state's error beside the action's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, {"next_state_weight": (0.0, 1e6)})


class DADT(nn.Module):
    """A Decision Transformer and a head on its action tokens; acts as the former."""

    def __init__(self, config: DADTConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.dt = DecisionTransformer(config, spec, generator)
        self.next_state_head = linear(config.embedding, spec.state_size, generator)
        self.weight = config.next_state_weight

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Action error + λ · next-state error; see `interface.Agent`."""
        device = self.dt.limit.device
        history, next_observations = History.of(windows, device), torch.from_numpy(windows.next_observations).to(device)
        assert next_observations.shape == history.observations.shape, next_observations.shape
        at_states, at_actions = self.dt.encode(history, (STATE, ACTION), generator)
        action_loss = masked_mean_square(self.dt.actions(at_states) - history.actions, history.mask)
        next_state_loss = masked_mean_square(self.next_state_head(at_actions) - next_observations, history.mask)
        parts = {"action_loss": action_loss, "next_state_loss": next_state_loss}
        return action_loss + self.weight * next_state_loss, parts

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S); see `interface.Predictor`."""
        return next_states(self.dt, self.next_state_head, windows)

    def policy(self) -> ContextPolicy:
        """As Decision Transformer's."""
        return self.dt.policy()


def next_states(dt: DecisionTransformer, head: nn.Module, windows: Windows) -> Tensor:
    """What a head (D → S) reads from the action tokens: normalised next states (B, K, S), in float32, no dropout."""
    with torch.no_grad():
        (at_actions,) = dt.encode(History.of(windows, dt.limit.device), (ACTION,), dtype=torch.float32)
        out: Tensor = head(at_actions)
    return out
