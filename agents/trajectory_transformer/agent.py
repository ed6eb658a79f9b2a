"""Trajectory Transformer (Janner et al., 2021): a model of all numbers of a trajectory, and a search in it for actions.

What is here: its config, its loss and how it acts. Called through `AGENTS`. It must not know the training loop, nor in
which dynamics a trajectory was collected.

    a transition   s₁ … s_S  a₁ … a_A  r  v     each number a token of one of 100 bins, v = r′ + γ r″ + … follows
    net            ╰──┴────────┴───────╯        of each token given all before it in 10 transitions, values not seen
    loss           cross entropy, of actions five times
    acting         beam search from the last 5 transitions and the state: the first action of the best plan

Written after github.com/JannerM/trajectory-transformer. The budget is reduced: it plans with horizon 5 and 32 beams,
which the original does for some data only (15 and 128 for the others). Other differences, besides those told in
`discretization`, `token_transformer` and `planning`: the training loop's are a constant learning rate after the warm-up
and weight decay on every parameter but the thresholds; thresholds are of a part of the data (`FITTED`); an episode's
last step may begin a trajectory; the loss is a mean over what is known, not over padding too; and a plan begins with 5
whole transitions, of which the original crops one for each that it plans.
"""

import dataclasses
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy, blockwise
from agents.config import TransformerConfig, check_ranges
from agents.interface import History, RobotSpec, Sampler
from agents.trajectory_transformer.discretization import Discretizer
from agents.trajectory_transformer.planning import BeamSearch, Planning, beam_search
from agents.trajectory_transformer.token_transformer import TokenTransformer
from agents.trajectory_transformer.trajectories import Trajectories, TrajectorySampler
from dynagen_bench.datasets import Normalization, OfflineDataset

FITTED: Final = 500_000
"""Transitions that the thresholds are of; of fewer data all."""


@dataclasses.dataclass(frozen=True)
class TrajectoryTransformerConfig(TransformerConfig):
    """config/offline.py of the original, with the horizon and the beams that it has for HalfCheetah."""

    context: int = 10
    """Transitions of a trajectory."""
    batch_size: int = 256
    """Trajectories in a gradient step; the original has 128 for Ant."""
    steps: int = 200_000
    """Gradient steps of a run: 50 million trajectories, as the original."""
    learning_rate: float = 6e-4
    """After the warm-up, constant."""
    warmup_steps: int = 4000
    """About one pass over a million transitions, as the original."""
    beta2: float = 0.95
    """Second momentum of AdamW."""
    weight_decay: float = 0.1
    """Of AdamW."""
    layers: int = 4
    """Transformer blocks."""
    heads: int = 4
    """Attention heads a block; divides `embedding`."""
    bins: int = 100
    """Bins N of each dimension."""
    discount: float = 0.99
    """γ of values, and of plans."""
    termination_penalty: float | None = -100.0
    """The reward, in training, of a step that ended its episode by itself; None leaves it as it is."""
    action_weight: float = 5.0
    """Weight of the cross entropy of actions."""
    reward_weight: float = 1.0
    """Weight of that of rewards."""
    value_weight: float = 1.0
    """Weight of that of values; of states it is 1."""
    horizon: int = 5
    """Transitions of a plan, at most `context`."""
    beams: int = 32
    """Sequences that the search keeps."""
    expand: int = 2
    """Continuations of each, of which the best are kept."""
    cdf: float = 0.6
    """The least likely actions, with this share of the probability together, are not searched."""
    memory: int = 5
    """Transitions done that a plan begins with; fewer where `context` has no place for them beside the horizon."""
    plan_every: int = 1
    """Steps that are taken of a plan, at most `horizon`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = dict.fromkeys(("action_weight", "reward_weight", "value_weight"), (0.0, 1e6))
        counts = {"bins": (2, 10_000), "beams": (1, 100_000), "expand": (1, 1000), "memory": (0, 200)}
        own = {"horizon": (1, self.context), "plan_every": (1, self.horizon)}
        check_ranges(self, {**weights, **counts, **own, "discount": (0.0, 1.0), "cdf": (0.0, 1.0)})
        if self.termination_penalty is not None:
            check_ranges(self, {"termination_penalty": (-1e9, 1e9)})

    def sampler(self, dataset: OfflineDataset, normalization: Normalization) -> Sampler:
        """Trajectories, with rewards and values."""
        return TrajectorySampler(dataset, self.context, normalization, self.discount, self.termination_penalty)


class TrajectoryTransformer(nn.Module):
    """Predicts each number of a trajectory from those before it."""

    weights: Tensor
    limit: Tensor

    def __init__(self, config: TrajectoryTransformerConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        self.sizes = [spec.state_size, spec.action_size, 1, 1]
        self.discretizer = Discretizer(sum(self.sizes), config.bins)
        self.net = TokenTransformer(config, sum(self.sizes), config.bins, generator)
        weights = (1.0, config.action_weight, config.reward_weight, config.value_weight)
        each = torch.tensor(weights).repeat_interleave(torch.tensor(self.sizes))
        self.register_buffer("weights", each, persistent=False)  # (J,)
        self.register_buffer("limit", torch.from_numpy(spec.action_limit), persistent=False)

    def fit(self, sampler: Any) -> None:
        """Take the thresholds of the bins from the training data; see `interface.Fitted`."""
        assert isinstance(sampler, TrajectorySampler)
        steps = np.arange(sampler.num_steps)
        if len(steps) > FITTED:
            steps = np.sort(np.random.default_rng(0).choice(len(steps), FITTED, replace=False, shuffle=False))
        self.discretizer.fit(sampler.rows(steps))

    def loss(self, windows: Trajectories, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean cross entropy of what is known but the first number of each trajectory; see `interface.Trainable`.

        After an episode that has ended by itself all tokens are stop.
        """
        rows, ended, mask = (torch.from_numpy(x).to(self.limit.device) for x in windows)
        assert rows.shape == (*mask.shape, sum(self.sizes)), rows.shape
        tokens = self.discretizer.encode(rows).masked_fill_(ended[:, :, None], self.discretizer.stop)
        losses = self.net.cross_entropy(tokens, generator, self.config.dtype)
        losses = torch.where(mask[:, :, None], losses, 0.0).sum(dim=(0, 1))  # (J,)
        counts = mask.sum().expand(len(self.weights)).clone()
        counts[0] -= len(mask)  # the first one is given
        kinds = zip(torch.split(losses, self.sizes), torch.split(counts, self.sizes), strict=True)
        names = ("state_loss", "action_loss", "reward_loss", "value_loss")
        parts = {name: (x.sum() / n.sum().clamp(min=1)).detach() for name, (x, n) in zip(names, kinds, strict=True)}
        return (losses * self.weights).sum() / counts.sum(), parts

    def plan(self, history: History) -> Tensor:
        """Actions (B, horizon, A) after histories (B, n) without padding."""
        history.check(self.spec.state_size, self.spec.action_size)
        config, (states, actions, *_) = self.config, self.sizes
        search = BeamSearch(states, actions, config.horizon, config.beams, config.expand, config.cdf, config.discount)
        branches, logits = self.net.read(self._tokens(history), states)
        uniforms = search.uniforms().to(logits.device)
        plans = beam_search(branches, logits, search, self.discretizer.expect, uniforms)
        return self.discretizer.decode(plans.actions, states).clamp(-self.limit, self.limit)

    def _tokens(self, history: History) -> Tensor:
        """Tokens (B, n, J), in the last transition the state's alone; values, which nothing sees, are 0 throughout.

        A reward is what the wanted return has lost.
        """
        wanted = history.returns_to_go[:, :, None]
        rewards = torch.cat((wanted[:, :-1] - wanted[:, 1:], torch.zeros_like(wanted[:, :1])), dim=1)
        rows = torch.cat((history.observations, history.actions, rewards, torch.zeros_like(rewards)), dim=2)
        return self.discretizer.encode(rows)

    def policy(self) -> ContextPolicy:
        """Plans from what its episodes have shown, rewards too."""
        memory = min(self.config.memory, self.config.context - self.config.horizon)
        planning = Planning(blockwise(self.plan, self.limit.device), self.config.plan_every)
        return ContextPolicy(planning, memory + 1, self.spec)
