"""An agent in training: its gradient steps, and the way to a checkpoint and back.

What is here: `Learner`. Called by `train`, and by whatever fine-tunes or measures. It must not know files, the data's
origin or any agent by name.
"""

import math

import numpy as np
import torch

from agents import TRAINABLE
from agents.checkpoint import Checkpoint, package_versions
from agents.config import TrainingConfig
from agents.interface import Following, Phased, RobotSpec, Sampler, Trainable


class Learner:
    """An agent, its optimiser, and how far they are.

    Attributes:
        step: updates done.
        seconds: wall clock of the run so far, evaluations included.
        phase_of: an agent that learns in phases stays in that of this step; None goes with `step`.
    """

    def __init__(
        self, name: str, config: TrainingConfig, spec: RobotSpec, seed: int, agent: Trainable | None = None
    ) -> None:
        """An agent, on CUDA where it is there: the one that is given, or a new one whose parameters the seed draws."""
        self.name, self.config, self.spec, self.seed = name, config, spec, seed
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        if agent is None:
            agent = TRAINABLE[name][1](config, spec, torch.Generator().manual_seed(seed))
        self.agent: Trainable = agent.to(device)
        self.optimizer = torch.optim.AdamW(
            self.agent.parameters(),
            lr=config.learning_rate,
            betas=(config.beta1, config.beta2),
            weight_decay=config.weight_decay,
            fused=True,
        )
        self.step, self.seconds = 0, 0.0
        self.phase_of: int | None = None
        self._dropout = torch.Generator(device)

    def update(self, sampler: Sampler) -> dict[str, float]:
        """One gradient step; returns the losses and the gradient's norm.

        Raises:
            FloatingPointError: a loss or gradient is not finite; the parameters are those of before the step.
        """
        rng = np.random.default_rng([self.seed, self.step])  # so that a continued run draws the same
        windows = sampler.sample(self.config.batch_size, rng)
        self._dropout.manual_seed(int(rng.integers(2**63)))
        if isinstance(self.agent, Phased):
            self.agent.begin(self.step if self.phase_of is None else self.phase_of)
        loss, parts = self.agent.loss(windows, self._dropout)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.agent.parameters(), self.config.gradient_clip)
        numbers = {"loss": loss, **parts, "gradient_norm": norm}
        values = dict(zip(numbers, torch.stack(list(numbers.values())).tolist(), strict=True))  # one wait for CUDA
        for name, value in values.items():
            if not math.isfinite(value):
                raise FloatingPointError(
                    f"{name} is {value} at step {self.step}: lower --learning-rate, or check the data"
                )
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.learning_rate_at(self.step)
        self.optimizer.step()
        if isinstance(self.agent, Following):
            self.agent.follow(values)
        self.step += 1
        return values

    def checkpoint(self) -> Checkpoint:
        """All that `restore` needs, sharing memory with the learner."""
        names = [name for name, _ in self.agent.named_parameters()]
        return Checkpoint(
            agent=self.name,
            config=self.config,
            spec=self.spec,
            seed=self.seed,
            step=self.step,
            seconds=self.seconds,
            parameters=dict(self.agent.named_parameters()),
            optimizer={names[i]: slots for i, slots in self.optimizer.state_dict()["state"].items()},
            versions=package_versions(),
        )

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back to a checkpoint of this agent, config and seed; raises ValueError where its parameters are others."""
        checkpoint.fill(self.agent)
        names = [name for name, _ in self.agent.named_parameters()]
        state = {i: dict(checkpoint.optimizer[name]) for i, name in enumerate(names) if name in checkpoint.optimizer}
        self.optimizer.load_state_dict({"state": state, "param_groups": self.optimizer.state_dict()["param_groups"]})
        self.step, self.seconds = checkpoint.step, checkpoint.seconds
