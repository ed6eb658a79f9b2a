"""The two halves of a transformer block, each with its derivative written out, in float32 or bfloat16.

What is here: `attend` and `feed_forward`, each x + dropout(f(LayerNorm(x))), and the masks of dropout. Called by
`trunk`, which holds the parameters. It must not know what a token is.

Why by hand: in bfloat16 the products of these small nets are two thirds of a training step, and memory traffic most of
the rest. Products take `dtype` and all around them is float32 (residuals, LayerNorm, softmax, gradients of weights):
LayerNorm and softmax take a processor longer in bfloat16, and are less exact. A weight is cast once a step, q, k and v
need no copies between products, and what can be overwritten is. The tests hold both dtypes against autograd.

    M = B · T tokens    R = B · T' queries, tokens whose output is wanted    D embedding    H heads
"""

import math
from typing import Any, Final, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

EPSILON: Final = 1e-5
"""Of LayerNorm; PyTorch's default, and GPT-2's."""


class DropoutMasks:
    """Masks of one forward pass: 0 with probability `rate` (to 1/65536), 1 / (1 - rate) elsewhere.

    On a CPU they come from numpy's SFC64, which takes half the time of torch's generator and is seeded from it; one
    64-bit draw decides four elements.
    """

    def __init__(self, rate: float, generator: torch.Generator) -> None:
        """Masks on the generator's device."""
        self._dropped = round(rate * 2**16)  # of the 65536 values of 16 bits
        self._scale = 1.0 / (1.0 - self._dropped / 2**16)
        self._generator = generator
        if generator.device.type == "cpu":
            seed = int(torch.randint(2**63 - 1, (), generator=generator))
            self._bits = np.random.Generator(np.random.SFC64(seed))

    @classmethod
    def of(cls, rate: float, generator: torch.Generator | None) -> Self | None:
        """Masks, or None where nothing is dropped."""
        return None if generator is None or rate == 0.0 else cls(rate, generator)

    def draw(self, shape: torch.Size) -> Tensor:
        """The next mask, float32."""
        if self._generator.device.type != "cpu":
            draws = torch.empty(shape, dtype=torch.int32, device=self._generator.device)
            return (draws.random_(2**16, generator=self._generator) >= self._dropped) * self._scale
        size = math.prod(shape)
        lanes = self._bits.integers(2**64, size=-(-size // 4), dtype=np.uint64).view(np.uint16)[:size]
        return torch.from_numpy((lanes >= self._dropped) * np.float32(self._scale)).view(shape)


def drop(x: Tensor, masks: DropoutMasks | None) -> Tensor:
    """Dropout of x (...) float32; without masks, `x`."""
    return x if masks is None else x * masks.draw(x.shape)


class Affine(NamedTuple):
    """A linear layer's weight (outputs, inputs) and bias (outputs,), or LayerNorm's gain and shift, both (D,)."""

    weight: Tensor
    bias: Tensor


def attend(
    x: Tensor,
    norm: Affine,
    qkv: Affine,
    out: Affine,
    heads: int,
    attention_bias: Tensor,
    queries: Tensor | None,
    masks: DropoutMasks | None,
) -> Tensor:
    """Self-attention and what it is added to: (B, T, D) float32 → (B, T', D) float32.

    Args:
        x: the tokens.
        norm: LayerNorm's, (D,).
        qkv: (3D, D) and (3D,), of query, key and value.
        out: (D, D) and (D,).
        heads: H, divides D.
        attention_bias: (B · H, T', T), added to the scores; its dtype is that of the products.
        queries: (T',) int64, the tokens that see; None for all of them.
        masks: draws dropout, on the attention weights and on the output.
    """
    y: Tensor = _Attention.apply(x, *norm, *qkv, *out, heads, attention_bias, queries, masks)  # type: ignore[no-untyped-call]
    return y


def feed_forward(
    x: Tensor,
    norm: Affine,
    widen: Affine,
    narrow: Affine,
    dtype: torch.dtype,
    masks: DropoutMasks | None,
    gelu: bool = False,
) -> Tensor:
    """A two-layer perceptron with ReLU or GELU and what it is added to: (B, T, D) float32 → (B, T, D) float32.

    Args:
        x: the tokens.
        norm: LayerNorm's, (D,).
        widen: (4D, D) and (4D,).
        narrow: (D, 4D) and (D,).
        dtype: of the products.
        masks: draws dropout, on the output.
        gelu: GELU in place of ReLU.
    """
    y: Tensor = _FeedForward.apply(x, *norm, *widen, *narrow, dtype, masks, gelu)  # type: ignore[no-untyped-call]
    return y


class _Attention(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, *inputs: Any) -> Tensor:
        gain, shift, w_qkv, b_qkv, w_out, b_out, heads, attention_bias, queries, masks = inputs
        (batch, _, size), dtype = x.shape, attention_bias.dtype
        ctx.heads, ctx.scale = heads, (size // heads) ** -0.5
        h, mean, rstd = torch.native_layer_norm(x, (size,), gain, shift, EPSILON)
        h = h.to(dtype)
        query_rows = _rows(h if queries is None else h.index_select(1, queries))  # (R, D)
        h = _rows(h)  # (M, D)
        w_qkv, b_qkv, w_out = w_qkv.to(dtype), b_qkv.to(dtype), w_out.to(dtype)
        # three products, so that q, k and v are each in one piece, as the products below want them
        parts = zip(b_qkv.chunk(3), (query_rows, h, h), w_qkv.chunk(3), strict=True)
        q, k, v = (_split(torch.addmm(b, rows, w.T), batch, heads) for b, rows, w in parts)  # (B · H, T' or T, D/H)
        scores = torch.baddbmm(attention_bias, q, k.transpose(1, 2), alpha=ctx.scale)  # (B · H, T', T)
        weights = torch.softmax(scores, dim=2, dtype=torch.float32)
        mask = None if masks is None else masks.draw(weights.shape)
        kept = (weights if mask is None else weights * mask).to(dtype)
        y = _join(torch.bmm(kept, v), batch)  # (R, D)
        residual = x if queries is None else x.index_select(1, queries)
        result, out_mask = _add(residual, torch.addmm(b_out.to(dtype), y, w_out.T), masks)
        ctx.save_for_backward(
            x, mean, rstd, gain, shift, queries, h, query_rows, w_qkv, q, k, v, weights, mask, kept, y, w_out, out_mask
        )
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        (
            x,
            mean,
            rstd,
            gain,
            shift,
            queries,
            h,
            query_rows,
            w_qkv,
            q,
            k,
            v,
            weights,
            mask,
            kept,
            y,
            w_out,
            out_mask,
        ) = ctx.saved_tensors
        batch, dtype = len(x), h.dtype
        dy, dw_out, db_out = _product_backward(_masked(grad, out_mask).to(dtype), y, w_out)
        dy = _split(dy, batch, ctx.heads)  # (B · H, T', D/H)
        dv = torch.bmm(kept.transpose(1, 2), dy)
        dweights = torch.bmm(dy, v.transpose(1, 2)).float()  # (B · H, T', T)
        dscores = torch.ops.aten._softmax_backward_data(_masked(dweights, mask), weights, 2, torch.float32)
        dscores = dscores.mul_(ctx.scale).to(dtype)
        dq, dk = torch.bmm(dscores, k), torch.bmm(dscores.transpose(1, 2), q)
        parts = zip((dq, dk, dv), (query_rows, h, h), w_qkv.chunk(3), strict=True)
        (dquery_rows, dwq, dbq), (dh, dwk, dbk), (dh_too, dwv, dbv) = (
            _product_backward(_join(part, batch), rows, w) for part, rows, w in parts
        )
        dh = dh.float().add_(dh_too).view(x.shape)
        if queries is None:
            dx = _norm_backward(dh.add_(dquery_rows.view(x.shape)), x, mean, rstd, gain, shift)
            dx[0].add_(grad)
        else:
            dh.index_add_(1, queries, dquery_rows.float().view(grad.shape))
            dx = _norm_backward(dh, x, mean, rstd, gain, shift)
            dx[0].index_add_(1, queries, grad)
        return *dx, torch.cat((dwq, dwk, dwv)), torch.cat((dbq, dbk, dbv)), dw_out, db_out, *[None] * 4


class _FeedForward(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, *inputs: Any) -> Tensor:
        gain, shift, w_wide, b_wide, w_narrow, b_narrow, dtype, masks, gelu = inputs
        h, mean, rstd = torch.native_layer_norm(x, x.shape[2:], gain, shift, EPSILON)
        h, w_wide, w_narrow = _rows(h.to(dtype)), w_wide.to(dtype), w_narrow.to(dtype)
        wide = torch.addmm(b_wide.to(dtype), h, w_wide.T)  # (M, 4D)
        before, wide = (wide, torch.nn.functional.gelu(wide)) if gelu else (None, wide.relu_())
        result, out_mask = _add(x, torch.addmm(b_narrow.to(dtype), wide, w_narrow.T), masks)
        ctx.save_for_backward(x, mean, rstd, gain, shift, h, w_wide, before, wide, w_narrow, out_mask)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Any:
        x, mean, rstd, gain, shift, h, w_wide, before, wide, w_narrow, out_mask = ctx.saved_tensors
        dwide, dw_narrow, db_narrow = _product_backward(_masked(grad, out_mask).to(h.dtype), wide, w_narrow)
        if before is None:
            dwide = torch.ops.aten.threshold_backward.grad_input(dwide, wide, 0, grad_input=dwide)  # of ReLU, in place
        else:
            dwide = torch.ops.aten.gelu_backward(dwide, before)
        dh, dw_wide, db_wide = _product_backward(dwide, h, w_wide)
        dx = _norm_backward(dh.float().view(x.shape), x, mean, rstd, gain, shift)
        dx[0].add_(grad)
        return *dx, dw_wide, db_wide, dw_narrow, db_narrow, *[None] * 3


def _rows(x: Tensor) -> Tensor:
    """(B, T, D) → (B · T, D)."""
    return x.reshape(-1, x.shape[-1])


def _split(x: Tensor, batch: int, heads: int) -> Tensor:
    """(B · T, D) → (B · H, T, D/H); no copy for one head."""
    length, size = len(x) // batch, x.shape[1] // heads
    return x.view(batch, length, heads, size).transpose(1, 2).reshape(-1, length, size)


def _join(x: Tensor, batch: int) -> Tensor:
    """(B · H, T, D/H) → (B · T, D): heads side by side again."""
    heads, length, size = len(x) // batch, x.shape[1], x.shape[2]
    return x.view(batch, heads, length, size).transpose(1, 2).reshape(batch * length, heads * size)


def _add(residual: Tensor, y: Tensor, masks: DropoutMasks | None) -> tuple[Tensor, Tensor | None]:
    """`residual` (B, T, D) + dropout of y (B · T, D), and the mask."""
    y = y.float().view(residual.shape)
    if masks is None:
        return residual + y, None
    mask = masks.draw(residual.shape)
    return torch.addcmul(residual, y, mask), mask


def _masked(grad: Tensor, mask: Tensor | None) -> Tensor:
    return grad if mask is None else grad * mask


def _product_backward(dy: Tensor, x: Tensor, w: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of y = x wᵀ + b: dx, and in float32 dw and db."""
    dy = dy.view(-1, dy.shape[-1])
    return dy @ w, (dy.T @ x).float(), dy.sum(0).float()


def _norm_backward(
    dh: Tensor, x: Tensor, mean: Tensor, rstd: Tensor, gain: Tensor, shift: Tensor
) -> tuple[Tensor, ...]:
    """Of LayerNorm: dx (B, T, D), and the gradients of gain and shift."""
    found: tuple[Tensor, ...] = torch.ops.aten.native_layer_norm_backward(
        dh, x, x.shape[2:], mean, rstd, gain, shift, [True] * 3
    )
    return found
