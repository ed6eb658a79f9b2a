"""MerPO (Lin et al., 2022): models and actor-critics of the train dynamics, held together by a meta-model and -policy.

What is here: its config, its losses, how it acts and how it is made ready for a dynamics that it has not seen. Called
through `AGENTS`. It must not know the training loop, nor what a dynamics is made of; it has nets for each.

This is a re-implementation from its description (arXiv 2202.02929). There is no public code to validate it against, and
nothing here shows that it does what the authors' does. The paper's abstract has the parts: meta-model, meta-policy,
conservative evaluation, and improvement between two regularisers. The forms below are as they are commonly told, those
of evaluation as COMBO (Yu et al., 2021) has them; neither they nor the values marked "told" or COMBO have been compared
with the text of the papers. Dynamics are n = 1 ... M, each with data Dₙ, a model φₙ, critics Qₙ, a policy πₙ and a
behaviour policy bₙ; c is the meta-policy.

    meta-model    min over φ and all φₙ of  Σₙ E_Dₙ[−log T_φₙ(s', r | s, a)] + η ‖φₙ − φ‖²                 first phase
    behaviour     bₙ by maximum likelihood on Dₙ                                                           first phase
    evaluation    min over Qₙ of  β (E_ρ[Qₙ] − E_Dₙ[Qₙ]) + ½ E_f[(Qₙ − r − γ Q̄ₙ(s', a'))²]                 as COMBO
                  ρ: steps that φₙ imagines with πₙ, from states of Dₙ        f: f of Dₙ and (1 − f) of ρ
    improvement   max over πₙ of  E_ρ[min Qₙ(s, ã)] − λ α KL(πₙ, bₙ) − λ (1 − α) KL(πₙ, c)           α = 0.4
    meta-policy   min over c of  Σₙ E_ρ[KL(πₙ, c)]
    new dynamics  the same with its own data, from φ and c, which stay as they are

Choices, where the description leaves one open or a processor is too slow for it:
* All dynamics are in each gradient step. What each has begins alike, so that a mean over dynamics has a meaning.
* φ has no gradient: after a step it goes `meta_rate` of the way to the mean of φₙ, where its part of the sum is least.
* The model is an ensemble that tells reward and end as well; one net of it, drawn anew, makes each imagined step.
* Steps are imagined afresh in each gradient step, and those after an imagined end are left out of every mean.
* Both critics have the loss of evaluation, with the smaller Q̄ (slow copies) of a' ~ πₙ. Rewards are as they come.
* Q is divided by its mean size in improvement, in each dynamics, so that one λ does for all robots.
* Both divergences are computed and not sampled: of two Gaussians under one tanh there is a formula.
* c follows bₙ in the first phase, and πₙ begins the second as bₙ; there is no other training of c by returns.
* For a new dynamics, critics begin as the mean of the train dynamics', πₙ and bₙ as c. It has no phases: a share of
  its gradient steps are those of model and behaviour, from the first to the last, so that it may end at any.
* Zero-shot, c acts by its most likely action; it needs no history and gets none.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn

from agents.acting import ContextPolicy, blockwise
from agents.config import TrainingConfig, check_first_phase, check_ranges
from agents.gaussian import GaussianActor, Moments, divergence
from agents.interface import History, RobotSpec, Sampler
from agents.merpo.world_model import Steps, WorldModel
from agents.nets import Nets, fixed, move_to_mean, spread
from agents.transitions import TaskSampler
from dynagen_bench.datasets import Normalization, OfflineDataset, Transitions

LOG_STD: Final = (-5.0, 2.0)
"""Of all policies: bounds of the logarithm of the deviation before tanh."""


@dataclasses.dataclass(frozen=True)
class MerPOConfig(TrainingConfig):
    """Sizes that a processor can do; what is told of the paper or of COMBO says so, and the rest is chosen."""

    context: int = 1
    """It acts by the state alone."""
    batch_size: int = 64
    """Steps of each dynamics in a gradient step."""
    steps: int = 20_000
    """Gradient steps of a run, of both phases."""
    learning_rate: float = 3e-4
    """Of all nets (COMBO: of its critics)."""
    warmup_steps: int = 0
    """None."""
    beta2: float = 0.999
    """Adam's usual one."""
    weight_decay: float = 0.0
    """None: η holds the models."""
    gradient_clip: float = 1e6
    """None."""
    tasks: int = 20
    """Dynamics M in the data; 20 are in the benchmark's train data, fewer if a run holds some out."""
    model_steps: int | None = None
    """Steps of the first phase, below `steps`; half of them if left out."""
    members: int = 5
    """Nets of a model (COMBO: 7, of which it uses the best 5)."""
    model_hidden: int = 200
    """Units of each hidden layer of a model (COMBO)."""
    model_layers: int = 3
    """Hidden layers of a model (COMBO: 4)."""
    eta: float = 0.1
    """η, what a model's square distance from the meta-model costs: as much as leaves the models' own fit as it is."""
    meta_rate: float = 0.1
    """Share of the way to the mean of the models that the meta-model goes in a gradient step."""
    hidden: int = 256
    """Units of each hidden layer of critics and policies (COMBO)."""
    layers: int = 2
    """Hidden layers of critics and policies (COMBO: 3)."""
    discount: float = 0.99
    """γ (COMBO)."""
    follow: float = 0.005
    """Share of Q that its slow copy Q̄ takes over in a gradient step (COMBO)."""
    rollout: int = 5
    """Steps that are imagined from a state (COMBO: 1 or 5)."""
    starts: int = 16
    """States of each dynamics that steps are imagined from, in a gradient step; at most `batch_size`."""
    real_share: float = 0.5
    """f, the data's share in the squares (COMBO)."""
    beta: float = 1.0
    """β, how conservative the critics are (COMBO: 0.5, 1 or 5)."""
    penalty: float = 0.1
    """λ, of the divergences, in sizes of Q."""
    alpha: float = 0.4
    """α, share of the divergence from the behaviour policy; the rest is from the meta-policy (told: about 0.4)."""
    adaptation_model_share: float = 0.25
    """Share of the gradient steps in a new dynamics that are those of its model and behaviour policy."""

    def __post_init__(self) -> None:
        super().__post_init__()
        sizes = {"model_hidden": 65536, "hidden": 65536, "tasks": 1000, "members": 100, "rollout": 1000}
        layers = {"model_layers": 20, "layers": 20}
        check_ranges(self, {field: (1, most) for field, most in (sizes | layers | {"starts": 10**6}).items()})
        if self.starts > self.batch_size:
            raise ValueError(
                f"starts is {self.starts} and batch_size {self.batch_size}: give a batch size of at least `starts`"
            )
        shares = ("meta_rate", "discount", "follow", "real_share", "alpha", "adaptation_model_share")
        check_ranges(self, dict.fromkeys(shares, (0.0, 1.0)) | dict.fromkeys(("eta", "beta", "penalty"), (0.0, 1e9)))
        check_first_phase(self, "model_steps", rest="the actor and the critics")

    def for_robot(self, robot: str) -> Self:
        """This config with the first phase's steps filled in."""
        if self.model_steps is not None:
            return self
        return dataclasses.replace(self, model_steps=max(1, self.steps // 2))

    def check_data(self, dataset: OfflineDataset) -> None:
        """Raise ValueError unless the data are of as many dynamics as there are nets for."""
        self.check_tasks(len(np.unique(dataset.episode_dynamics)))

    def check_tasks(self, found: int) -> None:
        """Raise ValueError unless data of so many dynamics are what there are nets for."""
        if found != self.tasks:
            raise ValueError(f"the data are of {found} dynamics, tasks is {self.tasks}: give --tasks {found}")

    def sampler(self, dataset: OfflineDataset, normalization: Normalization) -> Sampler:
        """Steps of all dynamics in the data."""
        return TaskSampler(dataset, normalization, len(np.unique(dataset.episode_dynamics)))


class Imagined(NamedTuple):
    """What the models imagine."""

    steps: Steps
    """(M, R): R = `rollout` times `starts`."""
    next_actions: Tensor
    """(M, R, A), the policy's in the next states."""
    weight: Tensor
    """(M, R), 0 for steps after an end; their sum is 1 in each dynamics."""


class MerPO(nn.Module):
    """Models, critics, policies and behaviour policies of M dynamics, a meta-model and a meta-policy."""

    memoryless: Final = True
    """See `interface.Memoryless`."""

    def __init__(
        self, config: MerPOConfig, spec: RobotSpec, generator: torch.Generator, *, adapting: bool = False
    ) -> None:
        """`adapting`: the one dynamics is new, what is common to all stays, and `policy` acts for it (`for_task`)."""
        super().__init__()
        self.config, self.spec, self.adapting = config.for_robot(spec.robot), spec, adapting
        states, limit, tasks = spec.state_size, spec.action_limit, config.tasks
        hidden = [config.hidden] * config.layers
        model_hidden = [config.model_hidden] * config.model_layers
        self.model = WorldModel(tasks, config.members, states, limit, model_hidden, generator)
        self.meta_policy = GaussianActor(1, (states, *hidden), limit, generator, LOG_STD)
        self.actor, self.behaviour = (
            GaussianActor(tasks, (states, *hidden), limit, generator, LOG_STD) for _ in range(2)
        )
        of_critic = (states + len(limit), *hidden, 1)
        self.q, self.slow_q = (Nets(2 * tasks, of_critic, generator) for _ in range(2))
        pair = Nets(2, of_critic, generator)
        for few, many in (
            (self.meta_policy, self.actor),
            (self.meta_policy, self.behaviour),
            (pair, self.q),
            (pair, self.slow_q),
        ):
            spread(few, many)
        self.slow_q.requires_grad_(False)
        self.meta_policy.requires_grad_(not adapting)
        self.begin(0)

    def begin(self, step: int) -> None:
        """Go to the phase of a step; see `interface.Phased`. At the start of the second one πₙ becomes bₙ."""
        assert self.config.model_steps is not None  # for_robot has filled it in
        if self.adapting:
            share = self.config.adaptation_model_share
            self._learns_model = int((step + 1) * share) > int(step * share)
            return
        self._learns_model = step < self.config.model_steps
        if step == self.config.model_steps:
            self.actor.load_state_dict(self.behaviour.state_dict())

    def loss(self, windows: Transitions, generator: torch.Generator | None) -> tuple[Tensor, dict[str, Tensor]]:
        """All losses of the phase; each reaches the nets that it is of. See `interface.Trainable`.

        Each is a sum over the dynamics. Without a generator nothing is imagined and nothing learned: it is how well the
        meta-model and the meta-policy fit the data, of whatever dynamics these are.

        Raises:
            ValueError: the data are of more or fewer dynamics than there are nets for.
        """
        device = self.model.limit.device
        steps = Steps(*(torch.from_numpy(x).to(device) for x in windows[:-1]))
        if generator is None:
            return self._fit_of_meta(steps)
        self.config.check_tasks(len(steps.rewards))
        losses, notes = self._model_losses(steps, generator) if self._learns_model else self._losses(steps, generator)
        if self.adapting:
            del losses["meta_policy_loss"]
        return torch.stack(list(losses.values())).sum(), {**losses, **notes}

    def _fit_of_meta(self, steps: Steps) -> tuple[Tensor, dict[str, Tensor]]:
        moments = self.meta_policy.moments(steps.observations.flatten(0, 1))
        of_policy = -self.meta_policy.log_density(moments, steps.actions.flatten(0, 1)[None]).mean()
        of_model = self.model.meta_negative_log_likelihood(steps)
        return of_model + of_policy, {"meta_model_fit": of_model, "meta_policy_fit": of_policy}

    def _model_losses(self, steps: Steps, generator: torch.Generator) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """The first phase: models, behaviour policies, and the meta-policy after them."""
        moments = self.behaviour.moments(steps.observations)
        losses = {
            "model_loss": self.model.negative_log_likelihood(steps, generator),
            "proximal_loss": self.config.eta * self.model.distance(),
            "behaviour_loss": -self.behaviour.log_density(moments, steps.actions).mean(dim=1).sum(),
            "meta_policy_loss": divergence(detached(moments), self._meta(steps.observations)).mean(dim=1).sum(),
        }
        return losses, {}

    def _losses(self, steps: Steps, generator: torch.Generator) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """The second phase: actor-critics, and the meta-policy after the policies."""
        imagined = self.imagine(steps.observations[:, : self.config.starts], generator)
        q_loss, gap = self._evaluation(steps, imagined, generator)
        improvement, meta, notes = self._improvement(imagined, generator)
        losses = {"q_loss": q_loss, "actor_loss": improvement, "meta_policy_loss": meta}
        return losses, {"conservative_gap": gap, **notes}

    @torch.no_grad()
    def imagine(self, observations: Tensor, generator: torch.Generator) -> Imagined:
        """What each dynamics' model imagines with its policy from states (M, R, S)."""
        actions = self.actor.act(self.actor.moments(observations), generator)
        alive = torch.ones(observations.shape[:2], device=observations.device)
        parts, next_actions, weights = list[Steps](), list[Tensor](), list[Tensor]()
        for _ in range(self.config.rollout):
            parts.append(self.model.step(observations, actions, generator))
            weights.append(alive)
            observations = parts[-1].following
            actions = self.actor.act(self.actor.moments(observations), generator)
            next_actions.append(actions)
            alive = alive * ~parts[-1].terminal
        weight = torch.cat(weights, dim=1)
        steps = Steps(*(torch.cat(x, dim=1) for x in zip(*parts, strict=True)))
        return Imagined(steps, torch.cat(next_actions, dim=1), weight / weight.sum(dim=1, keepdim=True))

    def _evaluation(self, data: Steps, imagined: Imagined, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Of the critics, and how much higher they value the imagined steps than the data (mean over dynamics)."""
        steps = Steps(*(torch.cat(x, dim=1) for x in zip(data, imagined.steps, strict=True)))
        of_data = torch.full_like(data.rewards, 1 / data.rewards.shape[1])
        with torch.no_grad():
            next_actions = self.actor.act(self.actor.moments(data.following), generator)
            after = self._values(self.slow_q, steps.following, torch.cat((next_actions, imagined.next_actions), dim=1))
            target = steps.rewards + self.config.discount * torch.where(steps.terminal, 0.0, after.amin(dim=0))
        share = self.config.real_share
        weight = torch.cat((share * of_data, (1 - share) * imagined.weight), dim=1)
        q = self._values(self.q, steps.observations, steps.actions)
        square = (weight * (q - target).square()).sum()
        gap = (torch.cat((-of_data, imagined.weight), dim=1) * q).sum()
        return self.config.beta * gap + 0.5 * square, gap.detach() / (2 * len(of_data))

    def _improvement(self, imagined: Imagined, generator: torch.Generator) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Of the policies and of the meta-policy, in the imagined states."""
        states, weight, config = imagined.steps.observations, imagined.weight, self.config
        moments = self.actor.moments(states)
        with fixed(self.q):
            value = self._values(self.q, states, self.actor.act(moments, generator)).amin(dim=0)
        size = (weight * value.detach().abs()).sum(dim=1, keepdim=True) + 1e-6
        with torch.no_grad():
            behaviour = self.behaviour.moments(states)
        meta = self._meta(states)
        from_behaviour = divergence(moments, behaviour)
        from_meta = divergence(moments, detached(meta))
        held = config.alpha * from_behaviour + (1 - config.alpha) * from_meta
        loss = (weight * (config.penalty * held - value / size)).sum()
        means = {"value": value, "behaviour_divergence": from_behaviour, "meta_divergence": from_meta}
        notes = {name: (weight * x.detach()).sum() / len(weight) for name, x in means.items()}
        return loss, (weight * divergence(detached(moments), meta)).sum(), notes

    def _values(self, critics: Nets, observations: Tensor, actions: Tensor) -> Tensor:
        """(2, M, R) of steps (M, R)."""
        x = torch.cat((observations, actions), dim=-1)
        values: Tensor = critics(x.repeat(2, 1, 1))
        return values.view(2, *actions.shape[:2])

    def _meta(self, observations: Tensor) -> Moments:
        """The meta-policy's moments (M, R, A) in states (M, R, S)."""
        mean, log_std = self.meta_policy.moments(observations.flatten(0, 1))
        return mean.view(*observations.shape[:2], -1), log_std.view(*observations.shape[:2], -1)

    @torch.no_grad()
    def follow(self, values: Mapping[str, float]) -> None:
        """After an update: the meta-model goes towards the models, or Q̄ takes over a share of Q."""
        if not self._learns_model:
            move_to_mean(self.slow_q, self.q, self.config.follow)
        elif not self.adapting:
            self.model.follow(self.config.meta_rate)

    def for_task(self) -> "MerPO":
        """An agent of a new dynamics, made of the meta-model, the meta-policy and the mean of the critics."""
        agent = MerPO(dataclasses.replace(self.config, tasks=1), self.spec, torch.Generator(), adapting=True)
        agent.to(self.model.limit.device)
        for few, of in ((self.model.meta, agent.model.meta), (self.model.meta, agent.model.tasks)):
            spread(few, of)
        for policy in (agent.meta_policy, agent.actor, agent.behaviour):
            spread(self.meta_policy, policy)
        for one, all_ in ((agent.q, self.q), (agent.slow_q, self.slow_q)):
            move_to_mean(one, all_)
        return agent

    def policy(self) -> ContextPolicy:
        """Acts by the state alone: by the meta-policy, or in a new dynamics by the policy of that."""
        return ContextPolicy(blockwise(self.act, self.model.limit.device), 1, self.spec)

    def act(self, history: History) -> Tensor:
        """The most likely actions (N, A) in the last states."""
        actor = self.actor if self.adapting else self.meta_policy
        return actor.best(history.observations[:, -1])[0]


def detached(moments: Moments) -> Moments:
    """The same, for no gradient to flow through."""
    return moments[0].detach(), moments[1].detach()
