"""The GPT of Trajectory Transformer: tokens of J dimensions a transition in, the distribution of each next one out.

What is here: the net, and `Branches`, which goes on from what it has read in many ways at once, token by token. Called
by `agent`; `planning` asks a `Branches` alone. It must not know what a dimension means but the last.

    tokens    s s s a a r v   s s s a a r v   …        an embedding for each dimension and bin, and for each position
    seen by   ╰─┴─┴─┴─┴─╯ ·   ╰─┴─┴─┴─┴─╯ ·             later tokens; the last of a transition, its value, by none
    heads     s s a a r v s   s s a a r v              of each next token, one for each dimension

After github.com/JannerM/trajectory-transformer (trajectory/models/transformers.py). Its blocks are those of `trunk`
with GELU. Differences: attention weights have no dropout, so that they need not be kept (2 GB for a batch of Ant's);
that values are seen by none is done without a mask of tokens by tokens, by leaving them out of the keys.
"""

import math
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from agents.config import TransformerConfig
from agents.sublayers import EPSILON, DropoutMasks, drop, feed_forward
from agents.trunk import INITIAL_STD, Block, affine

FEWEST: Final = 416
"""Numbers of a segment of keys, at least: below 400 products each, torch takes three to ten times as long for them."""


class KeyValue(NamedTuple):
    """What later tokens see of earlier ones in one block."""

    key: Tensor
    """(..., T, D/H)."""
    value: Tensor
    """(..., T, D/H)."""


class TokenTransformer(nn.Module):
    """A causal transformer over K transitions of J tokens each, of N bins or stop."""

    def __init__(self, config: TransformerConfig, dimensions: int, bins: int, generator: torch.Generator) -> None:
        """`dimensions`: J, `bins`: N; both of a transition's tokens."""
        super().__init__()
        size = config.embedding
        self.dimensions, self.bins, self.heads, self.rate = dimensions, bins, config.heads, config.dropout
        table = torch.randn(dimensions * bins + 1, size, generator=generator) * INITIAL_STD
        self.embedding = nn.Parameter(table)  # the last row is of stop, in all dimensions
        self.positions = nn.Parameter(torch.zeros(config.context, dimensions, size))
        self.blocks = nn.ModuleList(Block(config, generator) for _ in range(config.layers))
        self.norm = nn.LayerNorm(size)
        heads = torch.rand(dimensions, size, bins + 1, generator=generator)
        self.head = nn.Parameter((2 * heads - 1) * size**-0.5)

    def cross_entropy(self, tokens: Tensor, generator: torch.Generator | None, dtype: torch.dtype) -> Tensor:
        """-log p (B, K, J) of each of tokens (B, K, J), given those before it; the first one's is 0.

        Args:
            tokens: int64, right padded: what is in the padding matters to no token before it.
            generator: draws dropout; None leaves dropout out.
            dtype: of the matrix products.
        """
        logits = self.logits(tokens, generator, dtype)
        losses = functional.cross_entropy(logits.flatten(0, 2), tokens.flatten(), reduction="none").view(tokens.shape)
        return torch.cat((torch.zeros_like(losses[:, 0, :1]), losses.flatten(1)[:, 1:]), dim=1).view(tokens.shape)

    def logits(
        self, tokens: Tensor, generator: torch.Generator | None = None, dtype: torch.dtype = torch.float32
    ) -> Tensor:
        """Of each token given those before it, (B, K, J, N + 1) float32; the first one's mean nothing."""
        out, _ = self._run(tokens, generator, dtype)
        before = functional.pad(out, (0, 0, 1, 0))[:, :-1]  # (B, K · J, D), the output at the token before each
        by_dimension = before.reshape(-1, self.dimensions, out.shape[2]).transpose(0, 1).to(dtype)  # (J, B · K, D)
        logits = torch.bmm(by_dimension, self.head.to(dtype)).float()
        return logits.transpose(0, 1).reshape(*tokens.shape, self.bins + 1)

    def read(self, tokens: Tensor, known: int) -> tuple["Branches", Tensor]:
        """Begin with tokens (B, K', J), the first `known` of the last transition; and logits (B, N + 1) of the next."""
        out, seen = self._run(tokens, None, torch.float32)
        begun = tokens.shape[1] - 1
        keys = begun * (self.dimensions - 1) + known
        kept = [KeyValue(*(x[:, :, :keys].flatten(0, 1).contiguous() for x in pair)) for pair in seen]
        position = begun * self.dimensions + known  # of the next token
        return Branches(self, kept, position), out[:, position - 1] @ self.head[known]

    def embed(self, tokens: Tensor, first: int = 0) -> Tensor:
        """(..., J') → (..., J', D), of the dimensions from `first` on, without positions."""
        offsets = torch.arange(first, first + tokens.shape[-1], device=tokens.device) * self.bins
        stopped = tokens == self.bins
        return functional.embedding(torch.where(stopped, len(self.embedding) - 1, tokens + offsets), self.embedding)

    def _run(
        self, tokens: Tensor, generator: torch.Generator | None, dtype: torch.dtype
    ) -> tuple[Tensor, list[KeyValue]]:
        """Outputs (B, K · J, D) at tokens (B, K, J), and what is seen of them, (B, H, K · (J - 1), D/H) a block."""
        masks, seen = DropoutMasks.of(self.rate, generator), []
        x = drop((self.embed(tokens) + self.positions[: tokens.shape[1]]).flatten(1, 2), masks)
        for block in self.blocks:
            assert isinstance(block, Block)
            x, pair = self._attend(block, x, masks, dtype)
            x = feed_forward(x, affine(block.norm2), affine(block.widen), affine(block.narrow), dtype, masks, gelu=True)
            seen.append(pair)
        return self.norm(x), seen

    def _attend(
        self, block: Block, x: Tensor, masks: DropoutMasks | None, dtype: torch.dtype
    ) -> tuple[Tensor, KeyValue]:
        """Attention of a block, added to x (B, K · J, D).

        Values are no keys, and so have a call of their own: among the others, a token sees just those up to itself. In
        float32 whatever `dtype` is: a processor's bfloat16 takes twice as long for the derivative.
        """
        (batch, length, size), each = x.shape, self.dimensions
        h = functional.layer_norm(x, (size,), *affine(block.norm1), EPSILON).to(dtype)
        qkv = _linear(block.attention.qkv, h, dtype).float()
        parts = qkv.view(batch, -1, each, 3, self.heads, size // self.heads).unbind(dim=3)  # (B, K, J, H, D/H) each
        q, k, v = (part[:, :, :-1].flatten(1, 2).transpose(1, 2) for part in parts)  # (B, H, K · (J - 1), D/H)
        of_others = functional.scaled_dot_product_attention(q, k, v, is_causal=True)
        own = torch.arange(k.shape[2], device=x.device) // (each - 1)  # transition of each key
        later = own > torch.arange(length // each, device=x.device)[:, None]  # (K, K · (J - 1))
        visible = torch.zeros(later.shape, device=x.device).masked_fill_(later, -math.inf)
        at_values = parts[0][:, :, -1].transpose(1, 2)  # (B, H, K, D/H)
        of_values = functional.scaled_dot_product_attention(at_values, k, v, attn_mask=visible)
        joined = [y.transpose(1, 2).reshape(batch, length // each, -1, size) for y in (of_others, of_values)]
        y = _linear(block.attention.out, torch.cat(joined, dim=2).view(x.shape).to(dtype), dtype)
        return x + drop(y.float(), masks), KeyValue(k, v)


class Branches:
    """R sequences for each of B beginnings. What some have in common is kept once.

    All in float32, as agents act. Keys and values are in segments of some tokens each, (G · H, T, D/H) a block, which
    the R · B / G sequences after one another have in common: the first is of what was read, the next of what was added
    before sequences were spread, the last of what was added since, to each its own.
    """

    def __init__(self, model: TokenTransformer, read: list[KeyValue], position: int) -> None:
        """After `TokenTransformer.read`, R = 1: `read` (B · H, T, D/H) a block, `position` of the token to come."""
        self._model, self._position = model, position
        self._lanes = len(read[0].key) // model.heads
        self._segments = [[pair] for pair in read]  # a list a block
        self._rows = 1  # R
        self._filled, self._coming = read[0].key.shape[1], 0  # tokens in the last segment, and that are to come

    def spread(self, times: int, coming: int) -> None:
        """Go on with each sequence `times` times.

        `coming` tokens have to be added before the next call of this or of `choose`, values not counted.
        """
        self._check_all_came(coming)
        self._rows *= times
        for segments in self._segments:
            if segments[-1].key.shape[1] > self._filled:
                segments[-1] = KeyValue(*(x[:, : self._filled].contiguous() for x in segments[-1]))
            segments.append(KeyValue(*self._place(segments[0].key, max(coming, FEWEST // segments[0].key.shape[2]))))
        self._filled = 0

    def choose(self, rows: Tensor, coming: int) -> None:
        """Go on with sequences `rows` (B, R') of 0 … R - 1, each as often as it is there; `coming` as of `spread`."""
        self._check_all_came(coming)
        before, self._rows = self._rows, rows.shape[1]
        for number, (read, *own) in enumerate(self._segments):
            parts: list[list[Tensor]] = [[], []]
            for pair in own:
                groups = len(pair.key) // (self._lanes * self._model.heads)  # of a beginning
                first = torch.arange(self._lanes, device=rows.device)[:, None] * groups
                chosen = (first + rows // (before // groups)).flatten()
                for kind, x in zip(parts, pair, strict=True):
                    of_rows = x.view(-1, self._model.heads, *x.shape[1:]).index_select(0, chosen).flatten(0, 1)
                    kind.append(of_rows[:, : self._filled] if pair is own[-1] else of_rows)
            places = self._place(read.key, coming)
            joined = [torch.cat((*kind, place), dim=1) for kind, place in zip(parts, places, strict=True)]
            self._segments[number] = [read, KeyValue(*joined)]
        self._filled = sum(pair.key.shape[1] for pair in self._segments[0][1:]) - places[0].shape[1]

    def _place(self, like: Tensor, tokens: int) -> tuple[Tensor, Tensor]:
        """Zeros for the keys and values of tokens to come, all sequences apart."""
        shape = (self._lanes * self._rows * self._model.heads, tokens, like.shape[2])
        return like.new_zeros(shape), like.new_zeros(shape)

    def _check_all_came(self, coming: int) -> None:
        assert self._coming == 0, f"{self._coming} tokens less were added than were said to come"
        self._coming = coming

    def add(self, tokens: Tensor) -> Tensor:
        """Add tokens (B, R), one per sequence → logits (B, R, N + 1) float32 of the next."""
        model = self._model
        transition, dimension = divmod(self._position, model.dimensions)
        x = model.embed(tokens[..., None], dimension)[:, :, 0] + model.positions[transition, dimension]  # (B, R, D)
        is_key = dimension < model.dimensions - 1
        for block, segments in zip(model.blocks, self._segments, strict=True):
            assert isinstance(block, Block)
            x = self._attend(block, x, segments, is_key)
            norm, widen, narrow = affine(block.norm2), affine(block.widen), affine(block.narrow)
            x = feed_forward(x, norm, widen, narrow, torch.float32, None, gelu=True)
        self._filled, self._coming, self._position = self._filled + is_key, self._coming - is_key, self._position + 1
        logits: Tensor = model.norm(x) @ model.head[self._position % model.dimensions]
        return logits

    def _attend(self, block: Block, x: Tensor, segments: list[KeyValue], is_key: bool) -> Tensor:
        """Attention of a block, added to x (B, R, D), whose keys and values become part of the last segment."""
        heads = self._model.heads
        qkv = block.attention.qkv(block.norm1(x)).view(x[..., 0].numel(), 3, heads, -1)
        q, k, v = qkv.unbind(dim=1)  # (B · R, H, D/H) each
        if is_key:
            for kept, new in zip(segments[-1], (k, v), strict=True):
                kept[:, self._filled] = new.flatten(0, 1)
        q = q * q.shape[2] ** -0.5
        scores = [_joined(torch.bmm(_grouped(q, pair), pair.key.transpose(1, 2)), heads) for pair in segments]
        scores[-1][..., self._filled + is_key :] = -math.inf
        weights = torch.cat(scores, dim=2).softmax(dim=2)  # (B · R, H, tokens)
        parts = torch.split(weights, [pair.key.shape[1] for pair in segments], dim=2)
        seen = (torch.bmm(_grouped(w, pair), pair.value) for w, pair in zip(parts, segments, strict=True))
        y = torch.stack([_joined(part, heads) for part in seen]).sum(dim=0)
        result: Tensor = x + block.attention.out(y.view(x.shape))
        return result


def _grouped(x: Tensor, pair: KeyValue) -> Tensor:
    """(B · R, H, X) → (G · H, R · B / G, X), for the products with a segment."""
    groups = len(pair.key) // x.shape[1]
    return x.view(groups, -1, *x.shape[1:]).transpose(1, 2).flatten(0, 1)


def _joined(x: Tensor, heads: int) -> Tensor:
    """(G · H, R · B / G, X) → (B · R, H, X)."""
    return x.view(-1, heads, *x.shape[1:]).transpose(1, 2).flatten(0, 1)


def _linear(layer: nn.Linear, x: Tensor, dtype: torch.dtype) -> Tensor:
    """A linear layer in `dtype`."""
    return functional.linear(x, layer.weight.to(dtype), layer.bias.to(dtype))
