"""CaDM, context-aware dynamics model (Lee et al., 2020), learned offline: a predictor of the paper's Figure 4.

What is here: the context encoder, the forward and the backward nets, and their loss. Called through `PREDICTORS`. It
must not know the training loop, nor in which dynamics a window was collected.

    context    cₜ = encoder of the last 10 pairs (sᵢ₊₁ − sᵢ, aᵢ), i < t: 256, 128, 64, ReLU → 10 numbers
    forward    ŝₜ₊₁ = sₜ + f(sₜ, aₜ, cₜ)                5 nets of 4 × 200, swish; the prediction is their mean
    backward   ŝₜ   = sₜ₊₁ + b(sₜ₊₁, aₜ, cₜ)            as many nets, for the loss alone
    loss       mean (ŝₜ₊₁ − sₜ₊₁)² + 0.5 · mean (ŝₜ − sₜ)²   each net's own, states normalised, no padding

Pairs lie in the window; where there are fewer than 10 the first are zero (the original fills its buffer from the other
end). The original cuts a sample into 10 steps of history and 10 future ones, which all are predicted with the context
that the history gives. To use all of a window, and to learn from short histories too, each of its steps is a future
step here: it is given a context that is 0 to 9 steps older than cₜ, drawn at random, but none from before the window.

The original's ensemble is one of probabilistic nets, whose members have bootstrapped data of their own. Here the nets
are deterministic and minimise the square error, the windows of a batch are dealt among the members at random, and one
encoder serves all of them, where the original has one per member. The encoder's pairs are differences of normalised
states and plain actions, where the original standardises both. Planning is not needed. Written after
github.com/younggyoseo/CaDM (cadm/dynamics/mlp_cadm_ensemble_cem_dynamics.py, core/utils.py).
"""

import dataclasses
import itertools
from typing import Final

import torch
from torch import Tensor, nn

from agents.config import check_ranges
from agents.dt import masked_mean_square
from agents.interface import History, RobotSpec
from agents.mlp import MLPConfig
from agents.nets import Nets
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows

ENCODER: Final = (256, 128, 64)
"""Hidden layers of the context encoder."""


@dataclasses.dataclass(frozen=True)
class CaDMConfig(MLPConfig):
    """The original's, with the nets of MLP."""

    batch_size: int = 320
    """Windows in a gradient step, dealt among the members: 64 for each of five, as many as the others learn from."""
    history: int = 10
    """Pairs of state difference and action that a context is made of."""
    future: int = 10
    """Steps that one context serves in training."""
    code: int = 10
    """Size of a context."""
    members: int = 5
    """Nets in the ensemble."""
    backward_weight: float = 0.5
    """Of the backward nets' error beside the forward nets'."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole = {"history": (1, 200), "future": (1, 200), "code": (1, 65536), "members": (1, 1000)}
        check_ranges(self, {**whole, "backward_weight": (0.0, 1e6)})


class CaDM(nn.Module):
    """Predicts the next state from a step's state and action, and a context that the steps before are made into."""

    def __init__(self, config: CaDMConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        pair = spec.state_size + spec.action_size
        encoder = [
            layer
            for inputs, outputs in itertools.pairwise((config.history * pair, *ENCODER))
            for layer in (linear(inputs, outputs, generator), nn.ReLU())
        ]
        self.encoder = nn.Sequential(*encoder, linear(ENCODER[-1], config.code, generator))
        sizes = (pair + config.code, *[config.hidden] * config.layers, spec.state_size)
        self.forward_nets = Nets(config.members, sizes, generator, nn.functional.silu)
        self.backward_nets = Nets(config.members, sizes, generator, nn.functional.silu)

    def contexts(self, history: History) -> Tensor:
        """Contexts (B, K, C): of each step, from the steps before it."""
        history.check(self.spec.state_size, self.spec.action_size)
        differences = history.observations.diff(dim=1)  # (B, K - 1, S)
        pairs = torch.cat((differences, history.actions[:, :-1]), dim=2) * history.mask[:, :-1, None]
        pairs = nn.functional.pad(pairs, (0, 0, self.config.history, 0))  # zeros before the window
        lasts = pairs.unfold(1, self.config.history, 1)  # (B, K, S + A, history)
        out: Tensor = self.encoder(lasts.flatten(2))
        return out

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S), the mean of the members; see `interface.Predictor`."""
        history = History.of(windows, self.forward_nets.weights[0].device)
        inputs = torch.cat((history.observations, history.actions, self.contexts(history)), dim=2)
        change: Tensor = self.forward_nets(inputs.flatten(0, 1)).mean(dim=0).view_as(history.observations)
        return history.observations + change

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Forward + weight · backward error; the generator draws each step's context and each member's windows.

        Without a generator every step has its newest context, and every member has all windows.
        """
        device = self.forward_nets.weights[0].device
        history, following = History.of(windows, device), torch.from_numpy(windows.next_observations).to(device)
        assert following.shape == history.observations.shape, following.shape
        contexts = older(self.contexts(history), history.mask, self.config.future, generator)
        dealt = deal(len(following), self.config.members, generator).to(device)  # (M, L)
        mask = history.mask[dealt].flatten(0, 1)  # (M · L, K)
        change = (following - history.observations)[dealt].flatten(0, 1)  # (M · L, K, S)

        def error(nets: Nets, states: Tensor, wanted: Tensor) -> Tensor:
            inputs = torch.cat((states, history.actions, contexts), dim=2)[dealt]  # (M, L, K, S + A + C)
            return masked_mean_square(nets(inputs.flatten(1, 2)).view_as(wanted) - wanted, mask)

        forward = error(self.forward_nets, history.observations, change)
        backward = error(self.backward_nets, following, -change)
        parts = {"next_state_loss": forward, "backward_loss": backward}
        return forward + self.config.backward_weight * backward, parts


def older(contexts: Tensor, mask: Tensor, future: int, generator: torch.Generator | None) -> Tensor:
    """Contexts (B, K, C) for training: that of 0 to `future` - 1 steps before, but none of a step of the padding."""
    if generator is None:
        return contexts
    age = torch.randint(future, mask.shape, generator=generator, device=mask.device)
    first = (~mask).sum(dim=1, keepdim=True)  # (B, 1)
    steps = torch.arange(mask.shape[1], device=mask.device)
    return contexts.take_along_dim(torch.maximum(steps - age, first)[:, :, None], dim=1)


def deal(windows: int, members: int, generator: torch.Generator | None) -> Tensor:
    """Numbers of windows (M, L) that each member learns from: a share of them, or all without a generator.

    Shares are of one size, so that some windows are dealt twice where they do not divide.
    """
    if generator is None:
        return torch.arange(windows).expand(members, -1)
    share = -(-windows // members)
    order = torch.randperm(windows, generator=generator, device=generator.device)
    return order[torch.arange(members * share, device=generator.device) % windows].view(members, share)
