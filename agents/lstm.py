"""LSTM (Hochreiter and Schmidhuber, 1997): the next state from the steps so far, a predictor of the paper's Figure 4.

What is here: one recurrent layer over the steps of a window. Called through `PREDICTORS`. It must not know the training
loop, nor in which dynamics a window was collected.

    input     s₀ a₀   s₁ a₁   …   sₜ aₜ      from the window's first step that is no padding
    state      h₀  →   h₁  →  …  → hₜ        200 units, zero before the first step
    output                         ŝₜ₊₁ = sₜ + linear(hₜ)
    loss      mean (ŝₜ₊₁ − sₜ₊₁)²            states normalised, over steps that are no padding

The paper says no more of it than its name. Its size is the width of MLP and CaDM. It predicts the change of the state
as these two do: a gated state, bounded by ±1, would first have to learn to hand the present state through.
"""

import dataclasses

import torch
from torch import Tensor, nn

from agents.config import check_ranges
from agents.interface import History, RobotSpec
from agents.mlp import PredictorConfig, next_state_loss
from agents.trunk import linear
from dynagen_bench.datasets.windows import Windows


@dataclasses.dataclass(frozen=True)
class LSTMConfig(PredictorConfig):
    """One layer, as wide as the nets of MLP and CaDM."""

    hidden: int = 200
    """Units of the recurrent state."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, {"hidden": (1, 65536)})


class LSTM(nn.Module):
    """Predicts the next state from the states and actions of the window up to a step."""

    def __init__(self, config: LSTMConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.spec = spec
        inputs = spec.state_size + spec.action_size
        unset = nn.LSTM(inputs, config.hidden, batch_first=True, device="meta")  # its own start would be global
        self.recurrent = unset.to_empty(device="cpu")
        for parameter in self.recurrent.parameters():  # torch's own range
            nn.init.uniform_(parameter, -(config.hidden**-0.5), config.hidden**-0.5, generator=generator)
        self.head = linear(config.hidden, spec.state_size, generator)

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S); see `interface.Predictor`."""
        history = History.of(windows, self.head.weight.device)
        history.check(self.spec.state_size, self.spec.action_size)
        inputs = torch.cat((history.observations, history.actions), dim=2)  # (B, K, S + A)
        states, _ = self.recurrent(moved(inputs, history.mask, left=True))
        change: Tensor = self.head(moved(states, history.mask, left=False))
        return history.observations + change

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the next states; nothing is drawn from the generator."""
        return next_state_loss(self.predict(windows), windows)


def moved(steps: Tensor, mask: Tensor, left: bool) -> Tensor:
    """Steps (B, K, X) of left padded windows moved to the left, their padding behind them; or back to the right.

    The steps of `mask` (B, K) are kept whole; what stands at the others is a copy of some step, and means nothing.
    """
    context = mask.shape[1]
    shift = (~mask).sum(dim=1, keepdim=True)  # (B, 1)
    places = torch.arange(context, device=mask.device) + (shift if left else -shift)
    return steps.take_along_dim(places.clamp(0, context - 1)[:, :, None], dim=1)
