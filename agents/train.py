"""The one training loop: `python -m agents.train dadt --robot Hopper --steps 20000 --seed 0`.

What is here: from a config to a run folder with curves, checkpoints and the official evaluation. Called from the
command line and by the demo. It must not know any agent by name: `AGENTS` has them.

A run is a function of (agent, config, seed, data). The randomness of a step is drawn from (seed, step) alone, so that a
run that was killed continues from its last checkpoint with the parameters of one that was not: give the same command
again.
"""

import dataclasses
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rich
import rich.progress
import torch
import tyro

from agents import AGENTS
from agents.checkpoint import load_checkpoint, package_versions, save_checkpoint
from agents.config import TrainingConfig
from agents.interface import RobotSpec, Sampler
from agents.learner import Learner
from agents.run_folder import Curves, RunSettings, claimed, git_commit, read_json, write_json
from dynagen_bench.datasets import OfflineDataset, load_dataset
from dynagen_bench.evaluation import Evaluation, evaluate
from dynagen_bench.evaluation.traces import save_traces


def train(name: str, config: TrainingConfig, settings: RunSettings, dataset: OfflineDataset) -> Path:
    """Train an agent, or go on with its run, and evaluate it; returns the run folder.

    Raises:
        ValueError: the data are not training data of the robot or not all finite, or the run folder is of another run.
        OSError: the disk is full; the checkpoint before is kept.
        FloatingPointError: the loss is no number any more; the message names the step, and the last checkpoint stays.
    """
    if dataset.split != "train" or dataset.robot != settings.robot:
        raise ValueError(
            f"the data are {dataset.robot} {dataset.split!r}: train on load_dataset({settings.robot!r}, 'train')"
        )
    config = config.for_robot(settings.robot)
    folder = settings.folder(name)
    with claimed(folder, describe(name, config, settings, dataset)):
        check_finite(dataset)
        normalization = dataset.normalization()
        learner = Learner(name, config, RobotSpec.of_robot(settings.robot, normalization), settings.seed)
        last = folder / "last.safetensors"
        if last.is_file():
            learner.restore(load_checkpoint(last, agent=name, robot=settings.robot))
        if learner.step > config.steps:
            raise ValueError(f"{folder} is at step {learner.step} already: give --steps {learner.step} or more")
        sampler = config.sampler(dataset, normalization)
        curves = Curves(folder, learner.step)
        try:
            _run(learner, sampler, settings, folder, curves)
            if not (folder / "evaluation.json").is_file():  # deleted, after the run was complete
                record_evaluation(learner, folder, official=True)
        finally:
            curves.close()
    return folder


def _run(learner: Learner, sampler: Sampler, settings: RunSettings, folder: Path, curves: Curves) -> None:
    """Train to the last step: after each, what is due of a line of the curves, an evaluation and a checkpoint."""
    steps, recent = learner.config.steps, list[dict[str, float]]()
    before, started = learner.seconds, time.monotonic()
    with rich.progress.Progress(
        "{task.description}",
        rich.progress.BarColumn(),
        rich.progress.MofNCompleteColumn(),
        rich.progress.TimeRemainingColumn(),
        "{task.fields[note]}",
    ) as bars:
        bar = bars.add_task(folder.name, total=steps, completed=learner.step, note="")
        while learner.step < steps:
            recent.append(learner.update(sampler))
            learner.seconds = before + time.monotonic() - started
            step, done = learner.step, learner.step == steps
            if done or step % settings.log_every == 0:
                means = {key: float(np.mean([values[key] for values in recent])) for key in recent[0]}
                rate = learner.config.learning_rate_at(step - 1)
                curves.add(step, {**means, "learning_rate": rate, "seconds": learner.seconds})
                recent.clear()
                bars.update(bar, completed=step, note=f"loss {means['loss']:.4f}")
            if done or (settings.evaluate_every and step % settings.evaluate_every == 0):
                bars.update(bar, note="evaluating")
                curves.add(step, record_evaluation(learner, folder, official=done))
            if done or step % settings.checkpoint_every == 0:
                curves.save()
                save_checkpoint(folder / "last.safetensors", learner.checkpoint())


def check_finite(dataset: OfflineDataset) -> None:
    """Raise ValueError naming the first row of the data that has NaN or infinity."""
    rows = 1 << 18  # the data may be larger than memory
    for field in ("observations", "actions", "returns_to_go"):
        values = getattr(dataset, field)
        for first in range(0, len(values), rows):
            part = values[first : first + rows]
            if not np.isfinite(part).all():
                row = first + int(np.argwhere(~np.isfinite(part))[0, 0])
                raise ValueError(
                    f"{field} of the {dataset.robot} data are not finite in row {row}: build the data anew"
                )


def record_evaluation(learner: Learner, folder: Path, official: bool) -> dict[str, float]:
    """Evaluate in the test dynamics, keep it if it is the best so far or official, and return what the curves show."""
    evaluation = evaluate(learner.agent.policy(), learner.spec.robot, split="test")
    traces = evaluation.traces
    assert traces is not None, "evaluate records traces unless told not to"
    record = {
        "agent": learner.name,
        "seed": learner.seed,
        "gradient_steps": learner.step,
        "hours": learner.seconds / 3600,
        "versions": package_versions(),
        "evaluation": evaluation.to_json(),
    }
    mean_return = float(evaluation.returns.mean())  # orders as the score does, and needs no reference scores
    best = folder / "evaluation-best.json"
    if not best.is_file() or mean_return > Evaluation.from_json(read_json(best)["evaluation"]).returns.mean():
        save_traces(best.with_suffix(".safetensors"), traces)
        save_checkpoint(folder / "best.safetensors", dataclasses.replace(learner.checkpoint(), optimizer={}))
        write_json(best, record)
    if official:
        save_traces(folder / "evaluation.safetensors", traces)
        write_json(folder / "evaluation.json", record)
    return {"test_return": mean_return, **score_if_known(evaluation)}


def score_if_known(evaluation: Evaluation) -> dict[str, float]:
    """The official score as `test_score`; nothing for a robot whose reference scores are not made yet."""
    try:
        return {"test_score": evaluation.score}
    except ValueError:
        return {}


def describe(name: str, config: TrainingConfig, settings: RunSettings, dataset: OfflineDataset) -> dict[str, Any]:
    """What config.json says of a run."""
    return {
        "agent": name,
        "config": dataclasses.asdict(config),
        "settings": {**dataclasses.asdict(settings), "runs": str(settings.runs)},
        "data": {"episodes": len(dataset.episode_lengths), "data_steps": dataset.num_steps},
        "versions": package_versions(),
        "commit": git_commit(),
    }


def _command(name: str, config_class: type[TrainingConfig]) -> Any:
    """The subcommand of one agent: the run's settings and the config's fields, side by side."""

    def command(settings: RunSettings, config: TrainingConfig) -> None:
        if settings.threads:
            torch.set_num_threads(settings.threads)
        dataset = load_dataset(settings.robot, "train", every=settings.every)
        folder = train(name, config, settings, dataset)
        record = read_json(folder / "evaluation.json")
        evaluation = Evaluation.from_json(record["evaluation"])
        score = "".join(f", score {value:.2f}" for value in score_if_known(evaluation).values())
        rich.print(f"{folder}: mean return {evaluation.returns.mean():.1f} in the test dynamics{score}")

    flat = tyro.conf.arg(name="")
    command.__annotations__ = {
        "settings": Annotated[RunSettings, flat],
        "config": Annotated[config_class, flat],
        "return": None,
    }
    command.__doc__ = (sys.modules[config_class.__module__].__doc__ or "").split("\n\n")[0]
    return command


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    commands: Mapping[str, Any] = {name: _command(name, config_class) for name, (config_class, _) in AGENTS.items()}
    try:
        tyro.extras.subcommand_cli_from_dict(dict(commands), args=arguments, description=__doc__)
    except (ValueError, OSError, FloatingPointError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped: give the same command again to continue from the last checkpoint")


if __name__ == "__main__":
    main()
