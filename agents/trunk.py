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
from agents.sublayers import Affine, DropoutMasks, attend, drop, feed_forward

INITIAL_STD: Final = 0.02
"""Of every weight of the trunk, as GPT-2; biases start at 0."""

PADDED: Final = -1e30
"""Added to the score of a padding key: beside any real key its weight is exactly 0."""


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
    """The parameters of causal self-attention of H heads."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.qkv = linear(config.embedding, 3 * config.embedding, generator, INITIAL_STD)
        self.out = linear(config.embedding, config.embedding, generator, INITIAL_STD)


class Block(nn.Module):
    """A pre-LayerNorm block: attention, then a two-layer perceptron, each added to its input."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.heads = config.heads
        self.norm1 = nn.LayerNorm(config.embedding)
        self.attention = SelfAttention(config, generator)
        self.norm2 = nn.LayerNorm(config.embedding)
        self.widen = linear(config.embedding, 4 * config.embedding, generator, INITIAL_STD)
        self.narrow = linear(4 * config.embedding, config.embedding, generator, INITIAL_STD)

    def forward(self, x: Tensor, attention_bias: Tensor, queries: Tensor | None, masks: DropoutMasks | None) -> Tensor:
        """(B, T, D) → (B, T', D) at the queries (T',); `attention_bias` (B · H, T', T) is added to the scores."""
        qkv, out = affine(self.attention.qkv), affine(self.attention.out)
        x = attend(x, affine(self.norm1), qkv, out, self.heads, attention_bias, queries, masks)
        return feed_forward(x, affine(self.norm2), affine(self.widen), affine(self.narrow), attention_bias.dtype, masks)


def affine(layer: nn.Linear | nn.LayerNorm) -> Affine:
    """The parameters of a layer."""
    return Affine(layer.weight, layer.bias)


class Trunk(nn.Module):
    """The causal transformer: token t sees the tokens up to t that are no padding."""

    def __init__(self, config: TransformerConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.heads, self.rate = config.heads, config.dropout
        self.blocks = nn.ModuleList(Block(config, generator) for _ in range(config.layers))
        self.norm = nn.LayerNorm(config.embedding)

    def forward(
        self,
        tokens: Tensor,
        mask: Tensor,
        generator: torch.Generator | None = None,
        queries: Tensor | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> Tensor:
        """(B, T, D) → (B, T', D).

        Args:
            tokens: (B, T, D) float32.
            mask: (B, T) bool, False at padding; what comes out there means nothing.
            generator: draws dropout; None leaves dropout out.
            queries: (T',) int64, the tokens whose output is wanted, all if left out. The last block computes no other.
            dtype: of the matrix products.
        """
        attention_bias = make_attention_bias(mask, self.heads, dtype)
        masks = DropoutMasks.of(self.rate, generator)
        x = drop(tokens, masks)
        for block in self.blocks[:-1]:
            x = block(x, attention_bias, None, masks)
        if queries is not None:
            attention_bias = attention_bias[:, queries]
        out: Tensor = self.norm(self.blocks[-1](x, attention_bias, queries, masks))
        return out


def make_attention_bias(mask: Tensor, heads: int, dtype: torch.dtype) -> Tensor:
    """What is added to scores of (query, key), (B · H, T, T): 0 where it sees, -inf or -1e30 if not; mask (B, T).

    A key that is padding gets a finite number: a query with nothing else to see (padding too) would be NaN.
    """
    length = mask.shape[1]
    later = torch.full((length, length), -math.inf, dtype=dtype, device=mask.device).triu(diagonal=1)
    padding = (~mask).to(dtype) * PADDED  # (B, T)
    return (padding[:, None, :] + later).repeat_interleave(heads, dim=0)
