"""The one training loop: `python -m agents.train dadt --robot Hopper --steps 20000 --seed 0`.

What is here: from a config to a run folder with curves, checkpoints and the official evaluation. Called from the
command line and by the demo. It must not know any agent by name: `TRAINABLE` has them.

A run is a function of (agent, config, seed, data), on one machine at one number of threads. The randomness of a step
is drawn from (seed, step) alone, so that a run that was killed continues from its last checkpoint with the parameters
of one that was not: give the same command again.
"""

import dataclasses
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast

import numpy as np
import torch
import tyro

from agents import TRAINABLE, check_agent
from agents.checkpoint import Checkpoint, load_checkpoint, package_versions, save_checkpoint
from agents.config import TrainingConfig
from agents.interface import Fitted, RobotSpec, Sampler
from agents.learner import Learner
from agents.recording import Record, progress_bar, recorder, score_if_known
from agents.run_folder import (
    ADAPTATION_CURVE,
    LEARNED,
    PREDICTION,
    TARGET_CURVE,
    Curves,
    RunSettings,
    check_same_run,
    claimed,
    commit_of_all,
    ends_run,
    git_commit,
    identity,
    read_curve,
    read_json,
    same_length,
    write_json,
)
from agents.threads import use_threads
from agents.validation import Validation, check_patience, has_stalled, set_apart
from dynagen_bench.datasets import Normalization, OfflineDataset, load_dataset
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.terminal import one_line_errors

Parsed: TypeAlias = tuple[str, TrainingConfig, RunSettings]
"""An agent's name, its config and the settings of a run."""


def train(
    name: str,
    config: TrainingConfig,
    settings: RunSettings,
    dataset: OfflineDataset,
    *,
    report: Callable[[int], None] = lambda step: None,
    command: str | None = None,
) -> Path:
    """Train an agent, or go on with its run, and evaluate it; returns the run folder.

    Args:
        name: of the agent.
        config: the agent's.
        settings: what is trained on and recorded.
        dataset: the train data of the settings' robot.
        report: called after each step with the number of steps done.
        command: the command line that asks for this, kept in config.json.

    Raises:
        ValueError: the data are not training data of the robot or not all finite, the run folder is of another run, or
            the settings do not suit the agent or the data.
        OSError: the disk is full; the checkpoint before is kept.
        FloatingPointError: the loss is no number any more; the message names the step, and the last checkpoint stays.
    """
    if dataset.split != "train" or dataset.robot != settings.robot:
        raise ValueError(
            f"the data are {dataset.robot} {dataset.split!r}: train on load_dataset({settings.robot!r}, 'train')"
        )
    config = config.for_robot(settings.robot)
    dataset, held = set_apart(dataset, settings.hold_out)
    config.check_data(dataset)
    folder = settings.folder(name)
    description = describe(name, config, settings, dataset) | {"command": command}
    with claimed(folder, description) as before:
        check_finite(dataset)
        normalization = dataset.normalization()
        learner = Learner(name, config, RobotSpec.of_robot(settings.robot, normalization), settings.seed)
        _resume(learner, folder)
        if before is not None and learner.step > 0:  # the steps that are there were made by its commit
            description["commit"] = commit_of_all([before.get("commit"), description["commit"]])
        check_patience(name, learner.agent, settings.patience)
        returns = [point for point in read_curve(folder, "validation_return") if point[0] <= learner.step]
        done = learner.step == config.steps or has_stalled(returns, settings.evaluate_every, settings.patience)
        record, result = recorder(learner, settings, folder)
        if done and _is_complete(folder, result, before, learner.step):
            return folder
        sampler = config.sampler(dataset, normalization)
        if learner.step == 0 and isinstance(learner.agent, Fitted):
            learner.agent.fit(sampler)
        validation = None if held is None else Validation(held, settings.hold_out, config, learner.spec)
        if not done:
            for stale in ("evaluation.json", PREDICTION, LEARNED, ADAPTATION_CURVE, TARGET_CURVE):
                (folder / stale).unlink(missing_ok=True)  # of a checkpoint that is not the last one any more
        if not done or before is None or not same_length(before, description):
            write_json(folder / "config.json", description)
        curves = Curves(folder, learner.step)
        try:
            _run(learner, sampler, validation, settings, folder, curves, record, report, done)
        finally:
            curves.close()
    return folder


def _resume(learner: Learner, folder: Path) -> None:
    """Bring a new learner to the last checkpoint of a run folder, if it has one.

    Raises:
        ValueError: the checkpoint is of another run, of other data, or of a later step than is asked for.
    """
    last = folder / "last.safetensors"
    if not last.is_file():
        return
    checkpoint = load_checkpoint(last, agent=learner.name, robot=learner.spec.robot)
    check_same_run(last, _identity(checkpoint), _identity(learner.checkpoint()), instead="--name")
    _check_same_data(folder, checkpoint.spec.normalization, learner.spec.normalization)
    learner.restore(checkpoint)
    if learner.step > learner.config.steps:
        raise ValueError(f"{folder} is at step {learner.step} already: give --steps {learner.step} or more")


def _identity(checkpoint: Checkpoint) -> dict[str, Any]:
    """What tells runs apart, as far as a checkpoint tells it."""
    config = dataclasses.asdict(checkpoint.config)
    return identity({"agent": checkpoint.agent, "config": config, "settings": {"seed": checkpoint.seed}})


def _check_same_data(folder: Path, there: Normalization, here: Normalization) -> None:
    """Raise ValueError if a run was trained on other observations: data of as many steps may be others.

    Another processor may round a mean otherwise, and goes on with the run.
    """
    pairs = ((there.mean, here.mean), (there.std, here.std))
    if not all(np.allclose(old, new, rtol=1e-4, atol=1e-5) for old, new in pairs):
        raise ValueError(
            f"{folder} is of another run, its data had observations of another mean or deviation: give another --name, "
            "or delete the folder"
        )


def _is_complete(folder: Path, result: Path, description: Mapping[str, Any] | None, step: int) -> bool:
    """Whether a run has its official result, of the step it is at, where its config.json says that it ends.

    And whether its curves have it: a kill between the two writes leaves them without it.
    """
    if description is None or not result.is_file():
        return False
    curve = read_curve(folder, "test_return" if result.name == "evaluation.json" else "test_error")
    if not curve or curve[-1][0] != step:
        return False
    found = read_json(result)
    return found["gradient_steps"] == step and ends_run(found, description["config"]["steps"])


def _run(
    learner: Learner,
    sampler: Sampler,
    validation: Validation | None,
    settings: RunSettings,
    folder: Path,
    curves: Curves,
    record: Record,
    report: Callable[[int], None],
    done: bool,
) -> None:
    """Take the steps that are left, if any, and make the official result, of a checkpoint that is there by then.

    After each step comes what is due of a line of the curves, an evaluation and a checkpoint.
    """
    steps, recent = learner.config.steps, list[dict[str, float]]()
    before, started = learner.seconds, time.monotonic()
    with progress_bar() as bars:
        bar = bars.add_task(folder.name, total=steps, completed=learner.step, note="")
        while not done:
            recent.append(learner.update(sampler))
            learner.seconds = before + time.monotonic() - started
            step, done = learner.step, learner.step == steps
            report(step)
            if done or (settings.evaluate_every and step % settings.evaluate_every == 0):
                bars.update(bar, note="evaluating")
                if validation is not None:
                    curves.add(step, validation.measure(learner.agent))
                returns = curves.points("validation_return")
                done = done or has_stalled(returns, settings.evaluate_every, settings.patience)
                if not done:
                    curves.add(step, record(official=False))
            if done or step % settings.log_every == 0:
                means = mean_of_each(recent)
                rate = learner.config.learning_rate_at(step - 1)
                curves.add(step, {**means, "learning_rate": rate, "seconds": learner.seconds})
                recent.clear()
                bars.update(bar, completed=step, note=f"loss {means['loss']:.4f}")
            if done or step % settings.checkpoint_every == 0:
                curves.save()
                save_checkpoint(folder / "last.safetensors", learner.checkpoint())
        bars.update(bar, note="evaluating")
        if validation is not None and not any(at == learner.step for at, _ in curves.points("validation_loss")):
            curves.add(learner.step, validation.measure(learner.agent))  # it ends where it was once killed
        curves.add(learner.step, record(official=True))
    curves.save()


def mean_of_each(lines: list[dict[str, float]]) -> dict[str, float]:
    """The mean of each number, over the lines that have it: an agent in phases has others in another phase."""
    names = dict.fromkeys(name for line in lines for name in line)
    return {name: float(np.mean([line[name] for line in lines if name in line])) for name in names}


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


def describe(name: str, config: TrainingConfig, settings: RunSettings, dataset: OfflineDataset) -> dict[str, Any]:
    """What config.json says of a run; of its threads how many there are."""
    given = {key: value for key, value in dataclasses.asdict(settings).items() if key != "runs"}
    return {
        "agent": name,
        "config": dataclasses.asdict(config),
        "settings": {**given, "threads": torch.get_num_threads()},
        "data": {"episodes": len(dataset.episode_lengths), "data_steps": dataset.num_steps},
        "versions": package_versions(),
        "commit": git_commit(),
    }


def _command(name: str, config_class: type[TrainingConfig]) -> Any:
    """The subcommand of one agent: the run's settings and the config's fields, side by side."""

    def command(settings: RunSettings, config: TrainingConfig) -> Parsed:
        return name, config, settings

    flat = tyro.conf.arg(name="")
    command.__annotations__ = {
        "settings": Annotated[RunSettings, flat],
        "config": Annotated[config_class, flat],
        "return": Parsed,
    }
    command.__doc__ = (sys.modules[config_class.__module__].__doc__ or "").split("\n\n")[0]
    return command


def parse(arguments: Sequence[str]) -> Parsed:
    """The agent's name, its config and the settings that a command line asks for.

    Raises:
        ValueError: an unknown agent, or a config or settings that make no sense.
        SystemExit: what is no command line of this program, which is told on the error stream, or asks for help.
    """
    program, parsed = "python -m agents.train", None
    if arguments and not arguments[0].startswith("-"):
        name, *options = arguments
        check_agent(name, TRAINABLE)
        parsed = tyro.cli(_command(name, TRAINABLE[name][0]), prog=f"{program} {name}", args=options)
    else:  # asks for help, or shall be told what is missing
        commands = {name: _command(name, config_class) for name, (config_class, _) in TRAINABLE.items()}
        about = "Train an agent on the data of a robot. A stopped run continues when the same command is given again."
        parsed = tyro.extras.subcommand_cli_from_dict(commands, prog=program, args=arguments, description=about)
    return cast(Parsed, parsed)


def run(parsed: Parsed, command: str, report: Callable[[int], None] = lambda step: None) -> Path:
    """Load the data and train what `parse` has read; returns the run folder. Raises what `train` does."""
    name, config, settings = parsed
    if config.steps < config.warmup_steps:
        highest = config.learning_rate_at(config.steps - 1)
        print(
            f"warning: warmup_steps is {config.warmup_steps}, steps {config.steps}: the learning rate comes to "
            f"{highest:g} and not to {config.learning_rate:g}; --warmup-steps sets it",
            file=sys.stderr,
        )
    use_threads(settings.threads)
    dataset = load_dataset(settings.robot, "train", every=settings.every, quality=settings.quality)
    return train(name, config, settings, dataset, report=report, command=command)


def _say(folder: Path) -> None:
    """Print a finished run's result."""
    if not (folder / "evaluation.json").is_file():  # it predicts
        error = read_json(folder / PREDICTION)["prediction"]["mean"]
        print(f"{folder}: mean square error {error:.5f} of the next states in the test dynamics")
        return
    record = read_json(folder / "evaluation.json")
    evaluation = Evaluation.from_json(record["evaluation"])
    score = "".join(f", score {value:.2f}" for value in score_if_known(evaluation).values())
    print(f"{folder}: mean return {evaluation.returns.mean():.1f} in the test dynamics{score}")


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    given = sys.argv[1:] if arguments is None else arguments
    left = "give the same command again, it goes on from the last checkpoint, one every --checkpoint-every steps"
    with one_line_errors(also=(FloatingPointError,), stopped=left):
        _say(run(parse(given), f"python -m agents.train {shlex.join(given)}"))


if __name__ == "__main__":
    main()
