"""MLP: the next state from the present state and action alone, a next-state predictor of the paper's Figure 4.

What is here: how the three predictors are optimised, their loss, and MLP itself. Called through `PREDICTORS`. It must
not know the training loop, nor in which dynamics a window was collected.

    input     sₜ  aₜ                         of the same step, nothing of the steps before
    net       4 × 200, swish
    output    ŝₜ₊₁ = sₜ + net(sₜ, aₜ)
    loss      mean (ŝₜ₊₁ − sₜ₊₁)²            states normalised, over steps that are no padding

The paper says that MLP "only consumes the current state"; without the action there would be nothing to compare. It is
the "vanilla dynamics model" that CaDM is held against (Lee et al., 2020; github.com/younggyoseo/CaDM,
cadm/dynamics/mlp_ensemble_cem_dynamics.py, with one member). That one predicts the change of the state, each element
divided by its own deviation; here, and in LSTM and CaDM, the change is one of normalised states and no further scaled,
so that what is minimised is the error that is reported.
"""

import dataclasses

import torch
from torch import Tensor, nn

from agents.config import TrainingConfig, check_ranges
from agents.dt import masked_mean_square
from agents.interface import History, RobotSpec
from agents.nets import Nets
from dynagen_bench.datasets.windows import Windows


@dataclasses.dataclass(frozen=True)
class PredictorConfig(TrainingConfig):
    """Windows and batches as DADT's (Table 6); the optimiser is that of CaDM and its MLP, Adam at a constant rate."""

    learning_rate: float = 1e-3
    """Constant."""
    warmup_steps: int = 0
    """None in the originals."""
    beta2: float = 0.999
    """Adam's usual one."""
    weight_decay: float = 5e-5
    """The originals have 2.5e-5 to 1e-4, growing from layer to layer, as a term of the loss."""


@dataclasses.dataclass(frozen=True)
class MLPConfig(PredictorConfig):
    """The net of CaDM's vanilla dynamics model."""

    layers: int = 4
    """Hidden layers."""
    hidden: int = 200
    """Units of each."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, {"layers": (1, 100), "hidden": (1, 65536)})


class MLP(nn.Module):
    """Predicts the next state from a step's own state and action."""

    def __init__(self, config: MLPConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.spec = spec
        sizes = (spec.state_size + spec.action_size, *[config.hidden] * config.layers, spec.state_size)
        self.net = Nets(1, sizes, generator, nn.functional.silu)

    def predict(self, windows: Windows) -> Tensor:
        """Normalised next states (B, K, S); see `interface.Predictor`."""
        history = History.of(windows, self.net.weights[0].device)
        history.check(self.spec.state_size, self.spec.action_size)
        inputs = torch.cat((history.observations, history.actions), dim=2)  # (B, K, S + A)
        change: Tensor = self.net(inputs.flatten(0, 1)).view_as(history.observations)
        return history.observations + change

    def loss(self, windows: Windows, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean square error of the next states; nothing is drawn from the generator."""
        return next_state_loss(self.predict(windows), windows)


def next_state_loss(predicted: Tensor, windows: Windows) -> tuple[Tensor, dict[str, Tensor]]:
    """Mean square error of predicted next states (B, K, S) over steps that are no padding, as a predictor's loss."""
    error = predicted - torch.from_numpy(windows.next_observations).to(predicted.device)
    loss = masked_mean_square(error, torch.from_numpy(windows.mask).to(predicted.device))
    return loss, {"next_state_loss": loss}
