"""Models of several dynamics side by side, from which episodes are imagined: MerPO's.

What is here: `WorldModel`, an ensemble for each dynamics and one in the middle of them, the meta-model. Called by
`agent`. It must not know policies, critics, nor how long an imagined episode is.

    input     normalised state s, action / limit
    output    a Gaussian of the change of the normalised state and of the reward; the probability that the step ends it
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from agents.nets import Nets, move_to_mean, spread

LOG_VARIANCE: Final = (-10.0, 4.0)
"""Bounds of the logarithm of the variance, approached softly (Chua et al., 2018, learn theirs)."""
FARTHEST: Final = 10.0
"""Standard deviations from the mean at which an imagined state is held: no data are there."""


class Steps(NamedTuple):
    """Steps of M dynamics, R of each, tensors."""

    observations: Tensor
    """(M, R, S), normalised."""
    actions: Tensor
    """(M, R, A)."""
    rewards: Tensor
    """(M, R)."""
    following: Tensor
    """(M, R, S), normalised, the next state."""
    terminal: Tensor
    """(M, R) bool, the step ended the episode."""


class Prediction(NamedTuple):
    """What E nets of each of M dynamics say of R steps."""

    mean: Tensor
    """(E, M, R, S + 1), change of the normalised state, and reward."""
    log_variance: Tensor
    """(E, M, R, S + 1)."""
    end: Tensor
    """(E, M, R), logit of the probability that the step ends the episode."""


class WorldModel(nn.Module):
    """E nets of each of M dynamics (`tasks`), and E of the meta-model (`meta`), which no gradient moves.

    All begin as the meta-model does: of nets that began apart, the mean of the parameters would be of no use.
    """

    limit: Tensor

    def __init__(
        self,
        tasks: int,
        members: int,
        state_size: int,
        action_limit: NDArray[np.float32],
        hidden: Sequence[int],
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        sizes = (state_size + len(action_limit), *hidden, 2 * (state_size + 1) + 1)
        self.members = members
        self.meta = Nets(members, sizes, generator).requires_grad_(False)
        self.tasks = Nets(members * tasks, sizes, generator)
        spread(self.meta, self.tasks)
        self.register_buffer("limit", torch.from_numpy(action_limit), persistent=False)

    def negative_log_likelihood(self, steps: Steps, generator: torch.Generator | None) -> Tensor:
        """Of all nets of all dynamics on their data: the mean over the steps, summed over nets and dynamics.

        Each net gives each step a weight of its own, drawn from the exponential distribution (the Bayesian bootstrap),
        so that the nets of a dynamics do not see the same data; without a generator all are 1.
        """
        loss = _surprise(self.predict(steps.observations, steps.actions), steps)
        if generator is not None:
            loss = loss * torch.empty_like(loss).exponential_(generator=generator)
        return loss.mean(dim=-1).sum()

    def meta_negative_log_likelihood(self, steps: Steps) -> Tensor:
        """The meta-model's on data of any dynamics: the mean over its nets and the steps."""
        x = self._inputs(steps.observations, steps.actions).flatten(0, 1)
        flat = Steps(*(part.flatten(0, 1)[None] for part in steps))
        return _surprise(_read(self.meta(x), self.members), flat).mean()

    def distance(self) -> Tensor:
        """Σ ‖φₙ − φ‖² over the dynamics: how far their models are from the meta-model, which gets no gradient."""
        parts = []
        for own, meta in zip(self.tasks.parameters(), self.meta.parameters(), strict=True):
            of_members = own.view(self.members, -1, *own.shape[1:])
            middle = meta[:, None].expand_as(of_members)
            parts.append(functional.mse_loss(of_members, middle, reduction="sum"))
        return torch.stack(parts).sum()

    def follow(self, share: float) -> None:
        """The meta-model goes a share of the way to the mean of the dynamics' models, where `distance` is least."""
        move_to_mean(self.meta, self.tasks, share)

    def predict(self, observations: Tensor, actions: Tensor) -> Prediction:
        """What each net says of states (M, R, S) and actions (M, R, A) of its dynamics."""
        x = self._inputs(observations, actions)
        return _read(self.tasks(x.repeat(self.members, 1, 1)), self.members)

    @torch.no_grad()
    def step(self, observations: Tensor, actions: Tensor, generator: torch.Generator | None) -> Steps:
        """Imagine a step from states (M, R, S) by actions (M, R, A): one net of the dynamics, drawn for each row.

        The rows are dealt to the nets, a row to each as likely as to another, and each is computed once. Without a
        generator they are dealt in order, what follows is the mean, and a step ends if it is likelier than not.
        """
        dynamics, rows = actions.shape[:2]
        device = actions.device
        each = -(-rows // self.members)
        places = torch.arange(each * self.members, device=device)
        if generator is not None:
            places = torch.randperm(len(places), generator=generator, device=device)
        dealt = torch.argsort(places) % rows  # the row at each place; some twice, so that all nets have as many
        x = self._inputs(observations, actions)[:, dealt].view(dynamics, self.members, each, -1)
        output = self.tasks(x.transpose(0, 1).reshape(self.members * dynamics, each, -1))
        by_dynamics = output.view(self.members, dynamics, each, -1).transpose(0, 1).flatten(1, 2)
        found = _read(by_dynamics[:, places[:rows]], 1)
        change, bound = found.mean[0], torch.zeros_like(found.end[0])
        if generator is not None:
            noise = torch.randn(change.shape, generator=generator, device=device)
            change = change + (0.5 * found.log_variance[0]).exp() * noise
            drawn = torch.rand(bound.shape, generator=generator, device=device)
            bound = torch.logit(drawn, eps=1e-6)
        following = (observations + change[..., :-1]).clamp(-FARTHEST, FARTHEST)
        return Steps(observations, actions, change[..., -1], following, found.end[0] > bound)

    def _inputs(self, observations: Tensor, actions: Tensor) -> Tensor:
        return torch.cat((observations, actions / self.limit), dim=-1)


def _read(output: Tensor, kinds: int) -> Prediction:
    """The parts of outputs (E · M, R, 2 (S + 1) + 1)."""
    each = output.shape[-1] // 2
    output = output.view(kinds, -1, *output.shape[1:])
    mean, raw, end = output[..., :each], output[..., each : 2 * each], output[..., -1]
    low, high = LOG_VARIANCE
    below = high - functional.softplus(high - raw)
    return Prediction(mean, low + functional.softplus(below - low), end)


def _surprise(found: Prediction, steps: Steps) -> Tensor:
    """Negative log likelihood (E, M, R) of what followed."""
    target = torch.cat((steps.following - steps.observations, steps.rewards[..., None]), dim=-1)
    square = (found.mean - target).square() * (-found.log_variance).exp()
    gaussian = 0.5 * (square + found.log_variance + math.log(2 * math.pi)).sum(dim=-1)
    ended = steps.terminal.to(found.end.dtype).expand_as(found.end)
    return gaussian + functional.binary_cross_entropy_with_logits(found.end, ended, reduction="none")
