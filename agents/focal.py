"""FOCAL (Li et al., 2021): a behaviour-regularised actor-critic that is told the dynamics by an encoder of transitions.

What is here: its config, its losses and how it acts. Called through `AGENTS`. It must not know the training loop, nor
what a dynamics is made of; of training data it knows which steps are of the same one.

    encoder     z = mean over transitions of e(s, a, r, s')             trained by the distance metric loss alone:
                same dynamics  √(‖zᵢ − zⱼ‖² + ε)      others  1 / (‖zᵢ − zⱼ‖² + 100 ε)       ‖·‖² a mean over elements
    critics     Q₁, Q₂ (s, a, z) → 5 r + γ V̄(s', z)      V (s, z) → min Q(s, ã, z) − log π(ã)      ã drawn from π
    divergence  D(s) = 1 + log softplus c(s, ã, z) − softplus c(s, a, z)      the dual form of KL(π, behaviour)
    actor       mean of  log π(ã) − min Q(s, ã, z) + α D(s)
    α           grows while the mean of D is above its target, and shrinks below

Written after github.com/FOCAL-ICLR/FOCAL-ICLR (rlkit/torch/sac/sac.py, rlkit/torch/brac/divergences.py) and its numbers
for walker_rand_params. `variant="as_released"` keeps three things that are not as its paper has them: the penalty of c
is on its output, where the paper and BRAC have its gradient; a batch never has two sets of one dynamics, so that the
first half of the distance metric loss is never there; and α is clipped where it is used but not where it is kept, so
that it winds up. The distance in the first half is the code's in both variants, the root of a mean, where the paper has
the square. Other differences: all losses of an update are taken at the same parameters, and one step of c at
3e-4 stands for its three of 1e-4; states are normalised by mean and deviation, and not by their largest; the last step
of an episode is terminal where the robot fell alone, there where it was cut off too; there is no penalty on the value,
which its configs of other tasks have; and Walker's numbers serve every robot, where its hopper_rand_params.json has ten
tasks a batch and an α from 500 to 2000. Actions are the robot's own: SlimHumanoid's are within ±0.4, so that its
divergences come out at about half of what they would be in shares of that.

It is tested in two ways, which are reported apart: with the transitions of the episode so far (`policy`), as the
sequence agents are, or with data of the test dynamics (`policy_given`), as in its paper, which is privileged.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from agents.config import TrainingConfig, check_ranges
from agents.context import ContextActor, Known, Step, transitions_of
from agents.gaussian import GaussianActor
from agents.interface import RobotSpec, Sampler
from agents.nets import Nets, fixed, move_to_mean
from agents.transitions import TaskSampler
from dynagen_bench.datasets import Normalization, OfflineDataset, Transitions

EPSILON: Final = 1e-3
"""ε of the distance metric loss; of its second half a hundred times that (sac.py, z_loss)."""


@dataclasses.dataclass(frozen=True)
class FOCALConfig(TrainingConfig):
    """configs/default.py and configs/walker_rand_params.json of the original."""

    context: int = 100
    """Transitions in a set from which a dynamics is told in training."""
    batch_size: int = 256
    """Steps of each dynamics in a gradient step, besides those of the sets."""
    tasks: int = 16
    """Dynamics in a gradient step."""
    steps: int = 2_000_000
    """Gradient steps of a run."""
    learning_rate: float = 3e-4
    """Of all nets."""
    warmup_steps: int = 0
    """None in the original."""
    beta2: float = 0.999
    """Adam's usual one."""
    weight_decay: float = 0.0
    """None in the original."""
    gradient_clip: float = 1e6
    """None in the original."""
    hidden: int = 256
    """Units of each of the three hidden layers of actor and critics."""
    encoder_hidden: int = 200
    """Units of each of the three hidden layers of the encoder."""
    latent: int = 20
    """Elements of z, each in (-1, 1)."""
    discount: float = 0.99
    """γ."""
    reward_scale: float = 5.0
    """Rewards are multiplied by it in the critics' targets."""
    follow: float = 0.005
    """Share of V that its slow copy V̄ takes over in a gradient step."""
    alpha: float = 50.0
    """α at the start."""
    alpha_max: float = 1e4
    """Largest α."""
    target_divergence: float = 0.05
    """D at which α stays; α moves by the mean of D less this in a gradient step."""
    actor_penalty: float = 1e-3
    """Weight of the squares of the actor's mean and log deviation, before tanh."""
    critic_penalty: float = 5.0
    """Weight of the penalty of c."""
    variant: Literal["paper", "as_released"] = "paper"
    """Whether what the released code got wrong is right, or as it was."""

    def __post_init__(self) -> None:
        super().__post_init__()
        ranges = {"tasks": (2, 1000), "hidden": (1, 65536), "encoder_hidden": (1, 65536), "latent": (1, 1024)}
        numbers = ("reward_scale", "alpha", "alpha_max", "target_divergence", "actor_penalty", "critic_penalty")
        shares = {"discount": (0.0, 1.0), "follow": (0.0, 1.0)}
        check_ranges(self, ranges | shares | dict.fromkeys(numbers, (0.0, 1e9)))
        if self.variant not in ("paper", "as_released"):
            raise ValueError(f"variant is {self.variant!r}: give paper or as_released")

    @property
    def sets(self) -> int:
        """Sets of transitions of one dynamics: two, so that some are of the same."""
        return 2 if self.variant == "paper" else 1

    def sampler(self, dataset: OfflineDataset, normalization: Normalization) -> Sampler:
        """Steps of some dynamics: those of its sets, and those that the actor and the critics learn from."""
        return _Batches(TaskSampler(dataset, normalization, self.tasks), self.sets * self.context)


class _Batches:
    """A task sampler that draws more steps a dynamics."""

    def __init__(self, tasks: TaskSampler, more: int) -> None:
        self._tasks, self._more = tasks, more

    def sample(self, batch_size: int, rng: np.random.Generator) -> Transitions:
        return self._tasks.sample(batch_size + self._more, rng)


class FOCAL(nn.Module):
    """Encoder, actor, critics and the divergence's critic."""

    def __init__(self, config: FOCALConfig, spec: RobotSpec, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        states, actions, z = spec.state_size, spec.action_size, config.latent
        hidden = [config.hidden] * 3
        of_transition = 2 * states + actions + 1
        self.encoder = Nets(1, (of_transition, *[config.encoder_hidden] * 3, z), generator)
        self.actor = GaussianActor(1, (states + z, *hidden), spec.action_limit, generator)
        self.q = Nets(2, (states + actions + z, *hidden, 1), generator)
        self.v = Nets(1, (states + z, *hidden, 1), generator)
        self.slow_v = Nets(1, (states + z, *hidden, 1), generator).requires_grad_(False)
        self.slow_v.load_state_dict(self.v.state_dict())
        self.c = Nets(1, (states + actions + z, *hidden, 1), generator)
        self.alpha = nn.Parameter(torch.tensor(config.alpha), requires_grad=False)

    def encode(self, transitions: Tensor) -> Tensor:
        """Transitions (..., C, 2 S + A + 1), see `context.transitions_of` → z (..., Z), their mean."""
        each = torch.tanh(self.encoder(transitions.flatten(0, -2))[0])
        return each.view(*transitions.shape[:-1], -1).mean(dim=-2)

    def loss(self, windows: Transitions, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """All losses; each reaches the nets that it is of. See `interface.Trainable`."""
        given = [torch.from_numpy(x).to(self.alpha.device) for x in windows[:-1]]
        sets = self.config.sets * self.config.context
        batch = given[0].shape[1] - sets
        assert batch > 0, given[0].shape
        parts = transitions_of(*(x[:, batch:] for x in given[:4]))
        z = self.encode(parts.view(len(parts), self.config.sets, self.config.context, -1))  # (M, sets, Z)
        own = z[:, :1].detach().expand(-1, batch, -1).flatten(0, 1)  # (R, Z), R = M · B
        s, a, r, following, terminal = (x[:, :batch].flatten(0, 1) for x in given)
        drawn, log_probability, spread = self.actor.draw(torch.cat((s, own), dim=1), generator)
        drawn, log_probability = drawn[0], log_probability[0]
        with fixed(self.q, self.c):
            value = self.q(torch.cat((s, drawn, own), dim=1)).amin(dim=0)[:, 0]
            of_drawn = self.c(torch.cat((s, drawn, own), dim=1))[0, :, 0]
        of_data = self.c(torch.cat((s, a, own), dim=1))[0, :, 0]
        divergence = dual_divergence(of_drawn, of_data.detach()).mean()
        alpha = self.alpha.clamp(0.0, self.config.alpha_max)
        actor_loss = (log_probability - value).mean() + alpha * divergence + self.config.actor_penalty * spread
        losses = {
            "encoder_loss": self._distances(z),
            **self._critic_losses(s, a, r, following, terminal, own, (value - log_probability).detach()),
            "c_loss": self._divergence_loss(s, a, own, drawn.detach(), of_data, generator),
            "actor_loss": actor_loss,
        }
        return torch.stack(list(losses.values())).sum(), {**losses, "divergence": divergence.detach()}

    def _distances(self, z: Tensor) -> Tensor:
        """The distance metric loss of z (M, sets, Z)."""
        tasks = torch.arange(len(z), device=z.device).repeat_interleave(z.shape[1])
        first, second = torch.triu_indices(len(tasks), len(tasks), 1, device=z.device)
        flat = z.flatten(0, 1)
        square = (flat[first] - flat[second]).square().mean(dim=1)
        same = tasks[first] == tasks[second]
        near = torch.where(same, torch.sqrt(square + EPSILON), 0.0).sum() / (same.sum() + EPSILON)
        far = torch.where(same, 0.0, 1 / (square + 100 * EPSILON)).sum() / ((~same).sum() + EPSILON)
        return near + far

    def _critic_losses(
        self, s: Tensor, a: Tensor, r: Tensor, following: Tensor, terminal: Tensor, z: Tensor, now: Tensor
    ) -> dict[str, Tensor]:
        """Of Q₁ and Q₂ and of V, at rows (R, ·) of states, actions, z; `now` (R,) is what V is to be."""
        with torch.no_grad():
            after = self.slow_v(torch.cat((following, z), dim=1))[0, :, 0]
            target = self.config.reward_scale * r + self.config.discount * torch.where(terminal, 0.0, after)
        q = self.q(torch.cat((s, a, z), dim=1))[:, :, 0]  # (2, R)
        v = self.v(torch.cat((s, z), dim=1))[0, :, 0]
        return {"q_loss": (q - target).square().mean(dim=1).sum(), "v_loss": (v - now).square().mean()}

    def _divergence_loss(
        self, s: Tensor, a: Tensor, z: Tensor, drawn: Tensor, of_data: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Of c: it makes D large, and is held back by a penalty between the actions of the data and the drawn ones."""
        share = torch.full((len(s), 1), 0.5, device=s.device)
        if generator is not None:
            share = torch.rand(len(s), 1, generator=generator, device=s.device)
        with torch.enable_grad():  # the penalty has a gradient in it, also where none is asked for
            between = (share * a + (1 - share) * drawn).requires_grad_(True)
            output = self.c(torch.cat((s, between, z), dim=1))[0, :, 0]
            (gradient,) = torch.autograd.grad(output.sum(), between, create_graph=True)
        square = output.square() if self.config.variant == "as_released" else gradient.square().sum(dim=1)
        penalty = functional.relu(torch.sqrt(1e-8 + square) - 1.0).square().mean()
        of_drawn = self.c(torch.cat((s, drawn, z), dim=1))[0, :, 0]
        return self.config.critic_penalty * penalty - dual_divergence(of_drawn, of_data).mean()

    @torch.no_grad()
    def follow(self, values: Mapping[str, float]) -> None:
        """After an update: V̄ takes over a share of V, and α moves by D less its target."""
        move_to_mean(self.slow_v, self.v, self.config.follow)
        self.alpha.add_(values["divergence"] - self.config.target_divergence)
        if self.config.variant == "paper":
            self.alpha.clamp_(0.0, self.config.alpha_max)

    def policy(self) -> ContextActor:
        """Acts with z of the episode's own transitions so far; of none it is 0."""
        return self._actor(None)

    def policy_given(self, dataset: OfflineDataset) -> ContextActor:
        """Acts with z of all transitions in the data of the dynamics that it will act in: privileged."""
        steps = TaskSampler(dataset, self.spec.normalization, 1).everything()
        with torch.inference_mode():
            z = self.encode(transitions_of(*(torch.from_numpy(x[0]).to(self.alpha.device) for x in steps[:4])))
        return self._actor(z.cpu())

    def _actor(self, given: Tensor | None) -> ContextActor:
        return ContextActor(self._act, self._encode, self.alpha.device, self.spec, self.config.latent, given)

    def _act(self, known: Known) -> Tensor:
        """The actor's most likely actions (N, A)."""
        return self.actor.best(torch.cat(known, dim=1))[0]

    def _encode(self, step: Step) -> Tensor:
        """What one transition each tells, z (N, Z)."""
        return self.encode(step.transitions[:, None])


def dual_divergence(of_drawn: Tensor, of_data: Tensor) -> Tensor:
    """D (R,) from what c says of the actor's actions and of the data's."""
    return 1.0 + torch.log(functional.softplus(of_drawn) + 1e-8) - functional.softplus(of_data)
