"""A stochastic actor: tanh of a Gaussian, as soft actor-critic has it.

What is here: `GaussianActor`, which FOCAL and MerPO share. It must not know what its input is made of, nor a loss.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from agents.nets import Nets

Moments: TypeAlias = tuple[Tensor, Tensor]
"""Mean and log deviation of u, (M, R, A) each."""


class GaussianActor(nn.Module):
    """Input → a Gaussian over u; the action is limit · tanh u. M actors of one shape, each with rows R of its own."""

    limit: Tensor

    def __init__(
        self,
        members: int,
        sizes: Sequence[int],
        action_limit: NDArray[np.float32],
        generator: torch.Generator,
        log_std: tuple[float, float] = (-20.0, 0.0),
    ) -> None:
        """`sizes`: of the input and the hidden layers. `log_std`: what it is clipped to (FOCAL: never wider than 1)."""
        super().__init__()
        self.net = Nets(members, (*sizes, 2 * len(action_limit)), generator)
        self.log_std = log_std
        self.register_buffer("limit", torch.from_numpy(action_limit), persistent=False)

    def moments(self, x: Tensor) -> Moments:
        """Mean and log deviation of u, (M, R, A) each, for inputs (M, R, ·), or (R, ·) for all actors."""
        mean, log_std = self.net(x).chunk(2, dim=-1)
        return mean, log_std.clamp(*self.log_std)

    def draw(self, x: Tensor, generator: torch.Generator | None) -> tuple[Tensor, Tensor, Tensor]:
        """Actions (M, R, A), their log density (M, R), and the mean of the squares of mean and log deviation.

        Gradients flow through the actions. Without a generator u is its mean.
        """
        mean, log_std = self.moments(x)
        noise = torch.zeros_like(mean)
        if generator is not None:
            noise = torch.randn(mean.shape, generator=generator, device=mean.device)
        u = mean + log_std.exp() * noise
        gaussian = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        squash = 2 * (math.log(2) - u - functional.softplus(-2 * u))  # log of 1 − tanh² u, also where u is large
        density = (gaussian - squash - self.limit.log()).sum(dim=-1)
        return torch.tanh(u) * self.limit, density, mean.square().mean() + log_std.square().mean()

    def act(self, moments: Moments, generator: torch.Generator | None) -> Tensor:
        """Actions (M, R, A) as of `draw`, and nothing else; gradients flow through them."""
        mean, log_std = moments
        if generator is None:
            return torch.tanh(mean) * self.limit
        noise = torch.randn(mean.shape, generator=generator, device=mean.device)
        return torch.tanh(mean + log_std.exp() * noise) * self.limit

    def log_density(self, moments: Moments, actions: Tensor) -> Tensor:
        """Log density (M, R) of actions (M, R, A), which are taken to be a little inside of the limit."""
        mean, log_std = moments
        inside = (actions / self.limit).clamp(-1 + 1e-6, 1 - 1e-6)
        u = torch.atanh(inside)
        gaussian = -0.5 * ((u - mean) / log_std.exp()).square() - log_std - 0.5 * math.log(2 * math.pi)
        return (gaussian - torch.log1p(-inside.square()) - self.limit.log()).sum(dim=-1)

    def best(self, x: Tensor) -> Tensor:
        """The action (M, R, A) at the mean of u."""
        return self.act(self.moments(x), None)


def divergence(of: Moments, from_: Moments) -> Tensor:
    """KL divergence (M, R) of one actor from another of the same limit: u and limit · tanh u tell as much."""
    (mean, log_std), (other, other_log_std) = of, from_
    ratio = log_std - other_log_std
    distance = (mean - other) * (-other_log_std).exp()
    return (0.5 * ((2 * ratio).exp() + distance.square() - 1) - ratio).sum(dim=-1)
