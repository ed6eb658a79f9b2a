"""The GPT of tokens: what sees what, and that going on token by token is as reading all at once."""

import pytest
import torch
from torch.nn.functional import cross_entropy, gelu, layer_norm, linear

from agents.config import TransformerConfig
from agents.sublayers import Affine, DropoutMasks, feed_forward
from agents.trajectory_transformer.token_transformer import TokenTransformer

J, K, N = 5, 4, 7
VALUE = J - 1
"""Place of a transition's value."""


def net_of(seed: int = 0, **changes) -> TokenTransformer:
    """A net whose parameters all matter."""
    given = {"layers": 2, "heads": 2, "embedding": 16, "context": K, "precision": "float32"}
    generator = torch.Generator().manual_seed(seed)
    net = TokenTransformer(TransformerConfig(**(given | changes)), J, N, generator)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(torch.randn(parameter.shape, generator=generator) * 0.2)
    return net


def random_tokens(batch: int = 6, seed: int = 1) -> torch.Tensor:
    """Some are stop."""
    return torch.randint(N + 1, (batch, K, J), generator=torch.Generator().manual_seed(seed))


def logits_by_hand(net, tokens) -> torch.Tensor:
    """Attention by a mask of tokens by tokens, as the original has it."""
    length, heads = K * J, net.heads
    ids = torch.where(tokens == N, J * N, tokens + N * torch.arange(J))
    x = (net.embedding[ids] + net.positions).flatten(1, 2)
    place = torch.arange(length)
    seen = (place[None] <= place[:, None]) & (place[None] % J != VALUE)
    for block in net.blocks:
        qkv = block.attention.qkv(block.norm1(x)).view(len(x), length, 3, heads, -1)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        scores = (q @ k.transpose(2, 3) / q.shape[3] ** 0.5).masked_fill(~seen, -torch.inf)
        x = x + block.attention.out((scores.softmax(3) @ v).transpose(1, 2).flatten(2))
        x = x + block.narrow(gelu(block.widen(block.norm2(x))))
    out = torch.stack([net.norm(x)[:, i] @ net.head[(i + 1) % J] for i in range(length)], dim=1)
    return out[:, :-1]  # of the tokens from the second on


def test_it_is_the_original():
    net, tokens = net_of(), random_tokens()
    with torch.no_grad():
        ours = net.logits(tokens)
        torch.testing.assert_close(ours.flatten(1, 2)[:, 1:], logits_by_hand(net, tokens), rtol=1e-4, atol=1e-4)


def test_cross_entropy_is_that_of_the_tokens():
    net, tokens = net_of(), random_tokens()
    losses = net.cross_entropy(tokens, None, torch.float32).flatten(1)
    logits = net.logits(tokens).flatten(1, 2)
    assert (losses[:, 0] == 0).all()
    expected = cross_entropy(logits[:, 1:].transpose(1, 2), tokens.flatten(1)[:, 1:], reduction="none")
    torch.testing.assert_close(losses[:, 1:], expected)


@pytest.mark.parametrize("place", range(K * J - 1))
def test_a_token_changes_no_output_before_it_and_a_value_only_the_next(place):
    net, tokens = net_of(), random_tokens()
    other = tokens.clone()
    other.view(-1, K * J)[:, place] = (other.view(-1, K * J)[:, place] + 1) % N
    with torch.no_grad():
        before, after = (net.logits(x).flatten(1, 2)[:, 1:] for x in (tokens, other))  # at the tokens
    assert torch.equal(before[:, :place], after[:, :place])
    assert not torch.equal(before[:, place], after[:, place])
    assert torch.equal(before[:, place + 1 :], after[:, place + 1 :]) == (place % J == VALUE or place == K * J - 2)


@pytest.mark.parametrize(("begun", "known"), [(0, 1), (0, 3), (2, 1), (2, 3), (3, 4)])
def test_token_by_token_it_says_what_it_says_at_once(begun, known):
    net, tokens = net_of(), random_tokens()
    first = begun * J + known
    keys = sum(place % J != VALUE for place in range(first, K * J - 1))
    with torch.no_grad():
        at_once = net.logits(tokens).flatten(1, 2)
        beginning = tokens[:, : begun + 1].clone()
        beginning[:, -1, known:] = 0  # not known
        branches, logits = net.read(beginning[:2], known)
        torch.testing.assert_close(logits, at_once[:2, first], rtol=1e-5, atol=1e-5)
        branches.choose(torch.zeros(2, 1, dtype=torch.int64), keys)
        for place in range(first, K * J - 1):
            logits = branches.add(tokens.view(-1, 1, K * J)[:2, :, place])
            torch.testing.assert_close(logits[:, 0], at_once[:2, place + 1], rtol=1e-5, atol=1e-5)


def test_sequences_are_chosen_and_go_on_each_its_own_way():
    net, generator = net_of(), torch.Generator().manual_seed(2)
    tokens, lanes = random_tokens(2), torch.arange(2)[:, None]
    sequences = tokens[:, :1, :2].expand(2, 1, 2)  # of two tokens, for each beginning one
    with torch.no_grad():
        branches, _ = net.read(tokens[:, :1], known=2)
        for rows, coming in ((3, 1), (5, 1), ("twice", 2), (4, 3), ("twice", 2), ("twice", 1), (7, 2)):
            if rows == "twice":
                branches.spread(2, coming)
                sequences, rows = sequences.repeat_interleave(2, dim=1), 2 * sequences.shape[1]
            else:
                chosen = torch.randint(sequences.shape[1], (2, rows), generator=generator)
                branches.choose(chosen, coming)
                sequences = sequences[lanes, chosen]
            added = 0
            while added < coming or sequences.shape[2] % J == VALUE:  # which is never a key
                new = torch.randint(N + 1, (2, rows), generator=generator)
                added += sequences.shape[2] % J != VALUE
                sequences = torch.cat((sequences, new[:, :, None]), dim=2)
                logits = branches.add(new)
            length = sequences.shape[2]
            whole = torch.zeros(2 * rows, K * J, dtype=torch.int64)
            whole[:, :length] = sequences.flatten(0, 1)
            expected = net.logits(whole.view(-1, K, J)).flatten(1, 2)[:, length].view(2, rows, -1)
            torch.testing.assert_close(logits, expected, rtol=1e-5, atol=1e-5)


def test_fewer_tokens_than_were_said_to_come_are_refused():
    branches, _ = net_of().read(random_tokens()[:, :1], known=2)
    branches.choose(torch.zeros(6, 1, dtype=torch.int64), 2)
    branches.add(torch.zeros(6, 1, dtype=torch.int64))
    with pytest.raises(AssertionError, match="1 tokens less were added"):
        branches.choose(torch.zeros(6, 1, dtype=torch.int64), 1)


def test_padding_on_the_right_changes_nothing_and_has_no_gradient():
    net, tokens = net_of(), random_tokens()
    other = tokens.clone()
    other[:, 2:] = (other[:, 2:] + 3) % N
    gradients = []
    for given in (tokens, other):
        net.zero_grad()
        losses = net.cross_entropy(given, None, torch.float32)[:, :2]
        losses.sum().backward()
        gradients.append([losses.detach(), *(parameter.grad for parameter in net.parameters())])
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_first_parameters_are_the_originals():
    net = TokenTransformer(TransformerConfig(layers=2, heads=4, context=K), 40, 100, torch.Generator().manual_seed(0))
    assert net.embedding.std().item() == pytest.approx(0.02, rel=0.03)
    assert (net.positions == 0).all()
    assert net.head.abs().max() <= 128**-0.5
    assert net.head.std().item() == pytest.approx(128**-0.5 / 3**0.5, rel=0.03)


@pytest.mark.parametrize(("dtype", "largest"), [(torch.float32, 1e-5), (torch.bfloat16, 2e-2)])
def test_the_perceptron_with_gelu_is_autograds(dtype, largest):
    generator = torch.Generator().manual_seed(0)
    shapes = [(3, 6, 16), (16,), (16,), (64, 16), (64,), (16, 64), (16,)]
    tensors = [torch.randn(shape, generator=generator) * 0.3 for shape in shapes]

    def masks():
        return DropoutMasks(0.3, torch.Generator().manual_seed(5))

    def ours(x, gain, shift, w_wide, b_wide, w_narrow, b_narrow):
        parameters = Affine(gain, shift), Affine(w_wide, b_wide), Affine(w_narrow, b_narrow)
        return feed_forward(x, *parameters, dtype, masks(), gelu=True)

    def by_autograd(x, gain, shift, w_wide, b_wide, w_narrow, b_narrow):
        y = linear(gelu(linear(layer_norm(x, (16,), gain, shift), w_wide, b_wide)), w_narrow, b_narrow)
        return x + y * masks().draw(y.shape)

    found = []
    for function, kind in ((ours, torch.float32), (by_autograd, torch.float64)):
        leaves = [x.to(kind, copy=True).requires_grad_() for x in tensors]
        y = function(*leaves)
        (y * torch.linspace(-1, 1, y.numel(), dtype=kind).view(y.shape)).sum().backward()
        found.append([y.detach(), *(x.grad for x in leaves)])
    for mine, theirs in zip(*found, strict=True):
        assert (mine - theirs).norm() <= largest * theirs.norm()
