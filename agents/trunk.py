"""The one causal transformer that the sequence agents share.

What is here: GPT-2 without position embeddings, as the original Decision Transformer uses it (pre-LayerNorm blocks,
ReLU, normal(0, 0.02) weights), tokens in and tokens out. Called by the agents. It must not know what a token is.

Randomness is passed: a generator draws the first parameters, and dropout is done only where a generator is given. There
is therefore no train and eval mode to set, and nothing here touches torch's global generator.
"""

import math
from typing import Final

import torch
from torch import Tensor, nn

from agents.config import TransformerConfig

INITIAL_STD: Final = 0.02
"""Of every weight of the trunk, as GPT-2; biases start at 0."""


def dropout(x: Tensor, rate: float, generator: torch.Generator | None) -> Tensor:
    """Zero each element with probability `rate` (to 1/65536) and scale the others up; without a generator, return `x`.

    One 64-bit draw decides four elements: with a draw an element, dropout is a sixth of a training step on a processor.
    """
    if generator is None or rate == 0.0:
        return x
    dropped = round(rate * 2**16)  # of the 65536 values of a lane
    draws = torch.empty(math.ceil(x.numel() / 4), dtype=torch.int64).random_(-(2**63), None, generator=generator)
    lanes = draws.view(torch.int16)[: x.numel()].view(x.shape)
    return x * (lanes >= dropped - 2**15).to(x.dtype).mul_(1.0 / (1.0 - dropped / 2**16))


def linear(inputs: int, outputs: int, generator: torch.Generator, std: float | None = None) -> nn.Linear:
    """A linear layer drawn from `generator`: normal(0, std) and zero bias; without std uniform(±inputs^-1/2)."""
    layer: nn.Linear = nn.utils.skip_init(nn.Linear, inputs, outputs)  # type: ignore[no-untyped-call]
    if std is None:
        nn.init.uniform_(layer.weight, -(inputs**-0.5), inputs**-0.5, generator=generator)
        nn.init.uniform_(layer.bias, -(inputs**-0.5), inputs**-0.5, generator=generator)
    else:
        nn.init.normal_(layer.weight, std=std, generator=generator)
        nn.init.zeros_(layer.bias)
    return layer


class SelfAttention(nn.Module):
    """Causal self-attention of H heads."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.heads, self.rate = config.heads, config.dropout
        self.qkv = linear(config.embedding, 3 * config.embedding, generator, INITIAL_STD)
        self.out = linear(config.embedding, config.embedding, generator, INITIAL_STD)

    def forward(self, x: Tensor, hidden: Tensor, generator: torch.Generator | None) -> Tensor:
        """(B, T, D) → (B, T, D); `hidden` (B, 1, T, T) is True where a query (row) must not see a key (column)."""
        B, T, D = x.shape  # noqa: N806, the letters of the package
        q, k, v = self.qkv(x).view(B, T, 3, self.heads, D // self.heads).permute(2, 0, 3, 1, 4)  # each (B, H, T, D/H)
        # Written out: with dropout PyTorch's own call takes this way too, its masks come from the global generator,
        # and at 60 tokens the fused kernel gains nothing (8.6 ms against 8.0 ms here, forward and backward).
        scores = (q @ k.transpose(2, 3)) * (D // self.heads) ** -0.5  # (B, H, T, T)
        weights = dropout(scores.masked_fill(hidden, -math.inf).softmax(dim=3), self.rate, generator)
        y = (weights @ v).transpose(1, 2).reshape(B, T, D)  # heads side by side again
        return dropout(self.out(y), self.rate, generator)


class Block(nn.Module):
    """A pre-LayerNorm block: attention, then a two-layer perceptron, each added to its input."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.rate = config.dropout
        self.norm1 = nn.LayerNorm(config.embedding)
        self.attention = SelfAttention(config, generator)
        self.norm2 = nn.LayerNorm(config.embedding)
        self.widen = linear(config.embedding, 4 * config.embedding, generator, INITIAL_STD)
        self.narrow = linear(4 * config.embedding, config.embedding, generator, INITIAL_STD)

    def forward(self, x: Tensor, hidden: Tensor, generator: torch.Generator | None) -> Tensor:
        """(B, T, D) → (B, T, D)."""
        x = x + self.attention(self.norm1(x), hidden, generator)
        return x + dropout(self.narrow(self.widen(self.norm2(x)).relu_()), self.rate, generator)


class Trunk(nn.Module):
    """The causal transformer: token t sees the tokens up to t that are no padding."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.rate = config.dropout
        self.blocks = nn.ModuleList(Block(config, generator) for _ in range(config.layers))
        self.norm = nn.LayerNorm(config.embedding)

    def forward(self, tokens: Tensor, mask: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """(B, T, D) → (B, T, D).

        Args:
            tokens: (B, T, D) float32.
            mask: (B, T) bool, False at padding; what comes out there means nothing.
            generator: draws dropout; None leaves dropout out.
        """
        length = tokens.shape[1]
        later = torch.ones(length, length, dtype=torch.bool).triu(diagonal=1)  # (T, T), True right of the diagonal
        hidden = later | ~mask[:, None, None, :]  # (B, 1, T, T)
        hidden &= ~torch.eye(length, dtype=torch.bool)  # padding sees itself: a row with nothing to see would be NaN
        x = dropout(tokens, self.rate, generator)
        for block in self.blocks:
            x = block(x, hidden, generator)
        out: Tensor = self.norm(x)
        return out
