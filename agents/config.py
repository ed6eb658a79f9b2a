"""What agents are configured with: the paper's Table 6, once.

What is here: how any agent is trained (`TrainingConfig`, all that the training loop reads), the transformer that DADT,
Decision Transformer and Transformer-BC share, with the paper's values as defaults, and their checks. The agents' own
configs add fields. It must not know what an agent does with its samples.
"""

import dataclasses
import functools
import math
from pathlib import Path
from typing import Any, Final, Literal, Self, get_args

import torch

from agents.interface import Sampler
from dynagen_bench.datasets import Normalization, OfflineDataset, WindowSampler
from dynagen_bench.envs import HORIZON

Precision = Literal["float32", "bfloat16"]

# Lowest and highest value of each field, both allowed; a whole number is wanted where the low end is an int.
_TRAINING_RANGES: Final[dict[str, tuple[float, float]]] = {
    "context": (1, HORIZON),
    "batch_size": (1, 1_000_000),
    "steps": (1, 1_000_000_000),
    "warmup_steps": (0, 1_000_000_000),
    "decay_steps": (0, 1_000_000_000),
    "learning_rate": (0.0, 1.0),
    "beta1": (0.0, 0.999999),
    "beta2": (0.0, 0.999999),
    "weight_decay": (0.0, 10.0),
    "gradient_clip": (1e-6, math.inf),
}
_TRANSFORMER_RANGES: Final[dict[str, tuple[float, float]]] = {
    "layers": (1, 100),
    "heads": (1, 1024),
    "embedding": (1, 65536),
    "dropout": (0.0, 0.99),
}


@functools.cache
def fast_precision() -> Precision:
    """bfloat16 where a GPU (compute capability 8.0 on) or the processor (avx512_bf16, amx_bf16, Arm's bf16) has it."""
    if torch.cuda.is_available():
        return "bfloat16" if torch.cuda.get_device_capability() >= (8, 0) else "float32"
    processors = Path("/proc/cpuinfo")
    words = processors.read_text(encoding="utf-8").split() if processors.is_file() else []
    return "bfloat16" if {"avx512_bf16", "amx_bf16", "bf16"}.intersection(words) else "float32"


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """What is sampled and how it is optimised, for any agent; defaults are Table 6 and appendix C of the paper.

    Raises:
        ValueError: a field is out of its range; the message names the field, the value and the range.
    """

    context: int = 20
    """Steps K of a window."""
    batch_size: int = 64
    """Windows in a gradient step."""
    steps: int = 1_000_000
    """Gradient steps of a run."""
    learning_rate: float = 3e-5
    """After the warm-up."""
    warmup_steps: int = 10_000
    """First steps, over which the learning rate grows linearly from 0."""
    decay_steps: int = 0
    """Last steps, over which the learning rate falls linearly to 0; 0 keeps it constant, as the paper does."""
    beta1: float = 0.9
    """First momentum of AdamW."""
    beta2: float = 0.99
    """Second momentum of AdamW."""
    weight_decay: float = 1e-4
    """Of AdamW, on every parameter as in the original Decision Transformer."""
    gradient_clip: float = 1.0
    """Largest norm of the whole gradient."""

    def __post_init__(self) -> None:
        check_ranges(self, _TRAINING_RANGES)
        if self.decay_steps > self.steps:
            raise ValueError(f"decay_steps is {self.decay_steps}: give at most all {self.steps} steps")

    def for_robot(self, robot: str) -> Self:
        """This config with the fields filled in that depend on the robot or on other fields; here there are none."""
        return self

    def check_data(self, dataset: OfflineDataset) -> None:
        """Raise ValueError if an agent of this config cannot be trained on these data; most can on any."""

    def sampler(self, dataset: OfflineDataset, normalization: Normalization) -> Sampler:
        """What draws the batches of a gradient step: windows of K steps."""
        return WindowSampler(dataset, self.context, normalization)

    def learning_rate_at(self, step: int) -> float:
        """Learning rate of the update number `step`, counted from 0.

        The warm-up is that of kzl/decision-transformer (gym/experiment.py). A fall at the end of a rate that was
        constant before is what Hägele et al. (2024) find as good as a cosine.
        """
        grown = (step + 1) / max(self.warmup_steps, 1)
        left = (self.steps - step) / self.decay_steps if self.decay_steps else 1.0
        return self.learning_rate * min(grown, left, 1.0)


@dataclasses.dataclass(frozen=True)
class TransformerConfig(TrainingConfig):
    """Architecture of a sequence agent as well; defaults are Table 6. Its context K makes 3K tokens for DT and DADT."""

    layers: int = 3
    """Transformer blocks."""
    heads: int = 1
    """Attention heads a block; divides `embedding`."""
    embedding: int = 128
    """Size D of a token."""
    dropout: float = 0.1
    """On embeddings, attention weights and the output of each sublayer."""
    precision: Precision = dataclasses.field(default_factory=fast_precision)
    """Of the trunk's products in training; if left out, what this machine does fast. Agents act in float32."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, _TRANSFORMER_RANGES)
        if self.precision not in get_args(Precision):
            raise ValueError(f"precision is {self.precision!r}: give one of {', '.join(get_args(Precision))}")
        if self.embedding % self.heads:
            raise ValueError(f"embedding {self.embedding} does not divide into {self.heads} heads: choose a multiple")

    def check_data(self, dataset: OfflineDataset) -> None:
        """Raise ValueError if an episode is longer than any timestep that a transformer has an embedding of."""
        super().check_data(dataset)
        if len(dataset.episode_lengths) and (most := dataset.episode_lengths.max()) > HORIZON:
            raise ValueError(f"an episode of the data has {most} steps: give data of episodes of at most {HORIZON}")

    @property
    def dtype(self) -> torch.dtype:
        """`precision`, as torch calls it."""
        found: torch.dtype = getattr(torch, self.precision)
        return found


def check_ranges(config: Any, ranges: dict[str, tuple[float, float]]) -> None:
    """Raise ValueError naming the first field of `config` that is outside (low, high) of `ranges`, or no number."""
    for field, (low, high) in ranges.items():
        value = getattr(config, field)
        kind = int if isinstance(low, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high:
            number = "whole number" if kind is int else "number"
            raise ValueError(f"{field} is {value!r}: give a {number} from {low:g} to {high:g}")


def check_first_phase(config: TrainingConfig, field: str, rest: str) -> None:
    """Raise ValueError unless `field`, the steps of a first phase, is None or leaves some of `steps` for `rest`."""
    first, steps = getattr(config, field), config.steps
    if first is not None and (isinstance(first, bool) or not isinstance(first, int) or not 0 < first < steps):
        raise ValueError(
            f"{field} is {first!r} of {steps!r} steps: give a whole number from 1 on, below steps, so that some are "
            f"left for {rest}"
        )
