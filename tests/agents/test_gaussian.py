"""The stochastic actor that FOCAL and MerPO share: what its density and divergence are of."""

import numpy as np
import pytest
import torch

from agents.gaussian import GaussianActor, divergence


def test_divergence_is_that_of_the_actions():
    of, from_ = ((torch.tensor([[[m, 0.2]]]), torch.tensor([[[d, -0.3]]])) for m, d in ((0.5, -1.0), (-0.2, 0.4)))
    normals = [torch.distributions.Normal(mean, log_std.exp()) for mean, log_std in (of, from_)]
    expected = torch.distributions.kl_divergence(*normals).sum(dim=-1)
    torch.testing.assert_close(divergence(of, from_), expected)
    actor = GaussianActor(1, (1,), np.array([0.4, 2.0], np.float32), torch.Generator().manual_seed(0), (-5.0, 2.0))
    many = [tuple(x.expand(1, 50_000, 2) for x in moments) for moments in (of, from_)]
    actions = actor.act(many[0], torch.Generator().manual_seed(0))
    sampled = (actor.log_density(many[0], actions) - actor.log_density(many[1], actions)).mean()
    assert sampled.item() == pytest.approx(expected.item(), rel=0.02)
