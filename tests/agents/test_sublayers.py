"""The sublayers and their written-out derivatives against autograd in float64, and the masks of dropout."""

import numpy as np
import pytest
import torch
from torch.nn.functional import layer_norm, linear, relu

from agents.sublayers import Affine, DropoutMasks, attend, drop, feed_forward

B, T, D = 3, 6, 16
LARGEST_ERROR = {torch.float32: 1e-5, torch.bfloat16: 2e-2}  # of a whole tensor's norm
QUERIES = {"all": None, "some": torch.tensor([1, 3, 4])}


def masks(seed: int = 5) -> DropoutMasks:
    return DropoutMasks(0.3, torch.Generator().manual_seed(seed))


def inputs(*sizes) -> list[torch.Tensor]:
    """Tokens (B, T, D), LayerNorm's parameters, and linear layers' of sizes (outputs, inputs)."""
    generator = torch.Generator().manual_seed(0)
    shapes = [(B, T, D), (D,), (D,)] + [shape for size in sizes for shape in (size, size[:1])]
    return [torch.randn(shape, generator=generator) * (1.0 if i < 3 else 0.3) for i, shape in enumerate(shapes)]


def attention_by_autograd(x, gain, shift, w_qkv, b_qkv, w_out, b_out, heads, attention_bias, queries):
    drawn = masks()
    queries = torch.arange(T) if queries is None else queries
    h = layer_norm(x, (D,), gain, shift)
    q, k, v = (t.unflatten(2, (heads, -1)).transpose(1, 2) for t in linear(h, w_qkv, b_qkv).chunk(3, dim=2))
    scores = q[:, :, queries] @ k.transpose(2, 3) / (D // heads) ** 0.5 + attention_bias.view(B, heads, -1, T)
    weights = scores.softmax(3)
    weights = weights * drawn.draw(weights.shape)
    y = linear((weights @ v).transpose(1, 2).flatten(2), w_out, b_out)
    return x[:, queries] + y * drawn.draw(y.shape)


def perceptron_by_autograd(x, gain, shift, w_wide, b_wide, w_narrow, b_narrow):
    y = linear(relu(linear(layer_norm(x, (D,), gain, shift), w_wide, b_wide)), w_narrow, b_narrow)
    return x + y * masks().draw(y.shape)


def attention_bias_scores(heads, queries, dtype):
    attention_bias = torch.full((T, T), -torch.inf).triu(1).expand(B * heads, T, T).clone()
    attention_bias[:heads, 2:, 0] = -1e30  # the first key of the first episode is padding
    return (attention_bias if queries is None else attention_bias[:, queries]).to(dtype)


def output_and_gradients(function, tensors):
    """Of a scalar that depends on each output by another weight."""
    tensors = [tensor.clone().requires_grad_() for tensor in tensors]
    y = function(*tensors)
    (y * torch.linspace(-1, 1, y.numel(), dtype=y.dtype).view(y.shape)).sum().backward()
    return [y.detach(), *(tensor.grad for tensor in tensors)]


def assert_close(found, expected, dtype):
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == torch.float32
        assert ours.shape == theirs.shape
        assert (ours - theirs).norm() <= LARGEST_ERROR[dtype] * theirs.norm()


@pytest.mark.parametrize("dtype", LARGEST_ERROR)
@pytest.mark.parametrize("heads", [1, 2])
@pytest.mark.parametrize("queries", QUERIES)
def test_attention_is_autograds(queries, heads, dtype):
    queries, tensors = QUERIES[queries], inputs((3 * D, D), (D, D))

    def ours(x, gain, shift, w_qkv, b_qkv, w_out, b_out):
        norm, qkv, out = Affine(gain, shift), Affine(w_qkv, b_qkv), Affine(w_out, b_out)
        return attend(x, norm, qkv, out, heads, attention_bias_scores(heads, queries, dtype), queries, masks())

    def theirs(*tensors):
        return attention_by_autograd(*tensors, heads, attention_bias_scores(heads, queries, torch.float64), queries)

    expected = output_and_gradients(theirs, [tensor.double() for tensor in tensors])
    assert_close(output_and_gradients(ours, tensors), expected, dtype)


@pytest.mark.parametrize("dtype", LARGEST_ERROR)
def test_perceptron_is_autograds(dtype):
    tensors = inputs((4 * D, D), (D, 4 * D))

    def ours(x, gain, shift, w_wide, b_wide, w_narrow, b_narrow):
        return feed_forward(x, Affine(gain, shift), Affine(w_wide, b_wide), Affine(w_narrow, b_narrow), dtype, masks())

    expected = output_and_gradients(perceptron_by_autograd, [tensor.double() for tensor in tensors])
    assert_close(output_and_gradients(ours, tensors), expected, dtype)


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("shape", [(1,), (7,), (1000, 301)])
def test_dropout_zeroes_at_its_rate_and_keeps_the_mean(rate, shape):
    y = drop(torch.ones(shape), DropoutMasks(rate, torch.Generator().manual_seed(1)))
    assert y.shape == shape
    assert y.dtype == torch.float32
    assert torch.isin(y, torch.tensor([0.0, 1 / (1 - round(rate * 2**16) / 2**16)])).all()
    if y.numel() > 1000:
        assert (y == 0).float().mean().item() == pytest.approx(rate, abs=4 * np.sqrt(rate * (1 - rate) / y.numel()))
        assert (y == 0).float().mean(dim=0).std() == pytest.approx(np.sqrt(rate * (1 - rate) / 1000), rel=0.2)


def test_dropout_is_the_generators_and_absent_without_one():
    x = torch.randn(100, generator=torch.Generator().manual_seed(0))
    generator = torch.Generator().manual_seed(2)
    first = drop(x, DropoutMasks(0.5, generator))
    assert torch.equal(first, drop(x, DropoutMasks(0.5, torch.Generator().manual_seed(2))))
    assert not torch.equal(first, drop(x, DropoutMasks(0.5, generator)))  # the generator has moved on
    one = DropoutMasks(0.5, generator)
    assert not torch.equal(drop(x, one), drop(x, one))
    assert DropoutMasks.of(0.5, None) is None
    assert DropoutMasks.of(0.0, generator) is None
    assert drop(x, None) is x
