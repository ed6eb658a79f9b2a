"""An agent that goes on learning in one dynamics, from a few of its episodes; and how long it should.

What is here: how it is fine-tuned, and the curve by which the number of steps is chosen, in train dynamics that the run
held out. Called by `adapt`; its curve also by `targets`, its settings by `submit`. It must not know any agent by name,
nor what is done with the test dynamics' results.

Fine-tuning is training continued: the same updates on other data, with the paper's values (appendix C), a constant
learning rate and a new optimiser. Observations stay normalised by the train data. An agent that learns in phases begins
with its first one, which is the one that its actions come from. An agent that is told the dynamics by data is given
them, and takes no step.
"""

import csv
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from rich.table import Table
from torch import Tensor

from agents.checkpoint import Checkpoint
from agents.config import TrainingConfig, check_ranges
from agents.interface import Agent, Contextual, ForTask, Trainable
from agents.learner import Learner
from agents.trained_run import TrainedRun
from dynagen_bench import ids
from dynagen_bench.datasets import OfflineDataset
from dynagen_bench.datasets.subsets import ADAPTATION_EPISODES
from dynagen_bench.evaluation import Evaluation, evaluate
from dynagen_bench.whole import whole_file

CURVE: Final = (0, 100, 200, 500, 1000, 2000, 5000)
"""Steps after which the curve has a point."""


PAPER: Final[dict[str, Any]] = {"learning_rate": 1e-5, "weight_decay": 1e-2, "batch_size": 32}
"""Appendix C."""


@dataclasses.dataclass(frozen=True)
class AdaptationSettings:
    """How an agent is fine-tuned; defaults are the paper's (appendix C), where it has one.

    Raises:
        ValueError: a field is out of its range.
    """

    steps: int | None = None
    """Gradient steps for each dynamics; the paper gives no number, 2,000 if left out. In held-out train dynamics of
    Hopper the mean return first falls, is above its start again at 1,000, and still rises at 5,000, the last point
    measured (docs/results.md, one run; `--curve` measures it). 2,000 is the default for its cost."""
    learning_rate: float | None = None
    """Constant; the paper's 1e-5 if left out, for an agent with parts of its own for each dynamics that of training."""
    weight_decay: float | None = None
    """Of AdamW; the paper's 1e-2 if left out, or that of training, as above."""
    batch_size: int | None = None
    """Samples in a gradient step; the paper's 32 if left out, or that of training, as above."""
    episodes: int = ADAPTATION_EPISODES
    """Of each dynamics to fine-tune on; 10 is the benchmark's fixed set, and what may be submitted."""
    seed: int = 0
    """Of windows and dropout, together with the run's own."""

    def __post_init__(self) -> None:
        ranges: dict[str, tuple[float, float]]
        ranges = {"steps": (0, 10**9), "batch_size": (1, 10**6), "episodes": (1, 10**6), "seed": (0, 2**63 - 1)}
        ranges |= {"learning_rate": (0.0, 1.0), "weight_decay": (0.0, 10.0)}
        check_ranges(self, {field: limits for field, limits in ranges.items() if getattr(self, field) is not None})

    def for_agent(self, agent: Trainable, config: TrainingConfig) -> Self:
        """These with what is left out filled in for an agent of that config.

        Raises:
            ValueError: steps, or how to take them, are asked for of an agent that is given data and takes none.
        """
        own: dict[str, Any] = {"steps": 2000, **PAPER}
        if isinstance(agent, ForTask):
            own |= {field: getattr(config, field) for field in PAPER}
        if isinstance(agent, Contextual):
            own["steps"] = 0
            for field, value in own.items():
                if getattr(self, field) not in (None, value):
                    raise ValueError(
                        f"{field} is {getattr(self, field)}, and the agent is told the dynamics by data and takes no "
                        f"gradient step there: leave out --{field.replace('_', '-')}"
                    )
        return dataclasses.replace(self, **{k: value for k, value in own.items() if getattr(self, k) is None})


class FineTuning:
    """One agent on its way from a run's last checkpoint to one dynamics."""

    def __init__(
        self, checkpoint: Checkpoint, settings: AdaptationSettings, name: ids.DynamicsId, data: OfflineDataset
    ) -> None:
        """At the checkpoint; the random numbers of the way are those of the run's seed, the settings' and the name."""
        agent = checkpoint.build_agent()
        settings = settings.for_agent(agent, checkpoint.config)
        config = dataclasses.replace(
            checkpoint.config, warmup_steps=0, decay_steps=0, **{field: getattr(settings, field) for field in PAPER}
        )
        key = (checkpoint.seed, settings.seed, tuple(ids.SPLIT_SIZES).index(name.split), name.index)
        seed = int(np.random.SeedSequence(key).generate_state(1)[0])
        self.name, self._data = name, data
        self._sampler = config.sampler(data, checkpoint.spec.normalization)
        own = agent.for_task() if isinstance(agent, ForTask) else agent
        self._learner = Learner(checkpoint.agent, config, checkpoint.spec, seed, own)
        if own is agent:  # what is made for one dynamics has phases of its own; all else goes on learning to act
            self._learner.phase_of = 0

    def advance_to(self, steps: int, after_each: Callable[[], None]) -> None:
        """Take gradient steps until there are `steps`; raises FloatingPointError where a loss is no number."""
        while self._learner.step < steps:
            try:
                self._learner.update(self._sampler)
            except FloatingPointError as error:
                raise FloatingPointError(f"adapting to {self.name.robot} {self.name.label}: {error}") from error
            after_each()

    @property
    def parameters(self) -> Mapping[str, Tensor]:
        """Name → tensor, of the agent as it is now."""
        return self._learner.checkpoint().parameters

    def evaluate(self) -> Evaluation:
        """In the dynamics, the same episodes as without fine-tuning."""
        agent = self._learner.agent
        assert isinstance(agent, Agent), "`TrainedRun` is of agents alone"
        policy = agent.policy_given(self._data) if isinstance(agent, Contextual) else agent.policy()
        return evaluate(policy, self.name.robot, self.name.split, indices=[self.name.index])


def check_takes_steps(run: TrainedRun) -> None:
    """Raise ValueError if a run's agent is told the dynamics by data: there is no number of steps to choose."""
    if isinstance(run.checkpoint.build_agent(), Contextual):
        raise ValueError(
            f"{run.folder} is of {run.checkpoint.agent!r}, which is told the dynamics by data and takes no gradient "
            "step there: leave out --curve"
        )


def measure_curve(
    checkpoint: Checkpoint,
    settings: AdaptationSettings,
    name: ids.DynamicsId,
    data: OfflineDataset,
    points: Sequence[int],
    after_each: Callable[[], None],
) -> list[float]:
    """The mean return after so many steps in one dynamics; `settings.steps` is not used."""
    tuning, means = FineTuning(checkpoint, settings, name, data), list[float]()
    for steps in points:
        tuning.advance_to(steps, after_each)
        means.append(float(tuning.evaluate().returns.mean()))
    return means


def write_curve(path: Path, of: str, points: Sequence[float], returns: Mapping[str, Sequence[float]]) -> None:
    """Write a line a point: what it is at, in the column `of`, the mean over the dynamics, and each one's own mean."""
    with whole_file(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([of, "mean_return", *returns])
        for point, *values in zip(points, *returns.values(), strict=True):
            writer.writerow([point, *(f"{value:.7g}" for value in (float(np.mean(values)), *values))])


def curve_table(of: str, points: Sequence[float], returns: Mapping[str, Sequence[float]], title: str) -> Table:
    """The same for the terminal."""
    shown = Table(of, "mean return", *returns, title=title)
    for point, *values in zip(points, *returns.values(), strict=True):
        shown.add_row(f"{point:.12g}", *(f"{value:.1f}" for value in (np.mean(values), *values)))
    return shown
