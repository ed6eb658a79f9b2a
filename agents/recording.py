"""What is seen and kept of a run: its progress, and what it can do, measured now and then and in the end.

What is here: who acts is evaluated in the test dynamics and who predicts is tested on their data, by what it is and not
by its name; the files that this leaves. Called by `train`, `adapt`, `predict` and `submit`. It must not know the
training loop.
"""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import rich.console
import rich.progress

from agents import TRAINABLE
from agents.checkpoint import Checkpoint, package_versions, save_checkpoint
from agents.interface import Agent, Predictor
from agents.learner import Learner
from agents.prediction import EPISODES, PredictionErrors, prediction_errors
from agents.run_folder import PREDICTION, RunSettings, read_json, write_json
from dynagen_bench.datasets import OfflineDataset, load_dataset
from dynagen_bench.evaluation import Evaluation, evaluate
from dynagen_bench.evaluation.traces import load_traces, save_traces


class Record(Protocol):
    """Measures the agent in training and returns what the curves show; an official result is kept."""

    def __call__(self, *, official: bool) -> dict[str, float]:
        """Measure it now."""


def recorder(learner: Learner, settings: RunSettings, folder: Path) -> tuple[Record, Path]:
    """What measures the agent, and the file of its result: who acts is evaluated, who predicts is tested by data."""
    if isinstance(learner.agent, Agent):
        return functools.partial(record_evaluation, learner, folder), folder / "evaluation.json"
    test = load_dataset(settings.robot, "test", every=settings.every)
    return functools.partial(record_prediction, learner, folder, test, settings.every), folder / PREDICTION


def run_files(name: str) -> tuple[str, ...]:
    """What a finished run of an agent or predictor has in its folder, the result last, but for TensorBoard's events."""
    files = ["config.json", "curves.csv", "last.safetensors"]
    if not issubclass(TRAINABLE[name][1], Agent):
        return (*files, PREDICTION)
    results = (f"{kind}.{end}" for kind in ("evaluation-best", "evaluation") for end in ("safetensors", "json"))
    return (*files, "best.safetensors", *results)


def record_evaluation(learner: Learner, folder: Path, official: bool) -> dict[str, float]:
    """Evaluate in the test dynamics, keep it if it is the best so far or official, and return what the curves show."""
    assert isinstance(learner.agent, Agent), f"{learner.name} does not act"
    evaluation = evaluate(learner.agent.policy(), learner.spec.robot, split="test")
    facts = {
        "agent": learner.name,
        "seed": learner.seed,
        "gradient_steps": learner.step,
        "stopped_early": official and learner.step < learner.config.steps,
        "hours": learner.seconds / 3600,
        "versions": package_versions(),
    }
    mean_return = float(evaluation.returns.mean())  # orders as the score does, and needs no reference scores
    best = folder / "evaluation-best.json"
    if not best.is_file() or mean_return > Evaluation.from_json(read_json(best)["evaluation"]).returns.mean():
        best.unlink(missing_ok=True)  # a kill before the third file leaves none of two steps: this is measured again
        save_checkpoint(folder / "best.safetensors", dataclasses.replace(learner.checkpoint(), optimizer={}))
        write_result(best, facts, evaluation)
    if official:
        write_result(folder / "evaluation.json", facts, evaluation)
    return {"test_return": mean_return, **score_if_known(evaluation)}


def write_result(file: Path, facts: Mapping[str, Any], evaluation: Evaluation) -> None:
    """Write an evaluation's traces, then the JSON with what it is of, which says that they are there."""
    assert evaluation.traces is not None, "evaluate records traces unless told not to"
    save_traces(file.with_suffix(".safetensors"), evaluation.traces)
    write_json(file, {**facts, "evaluation": evaluation.to_json()})


def read_result(file: Path) -> Evaluation:
    """The evaluation in a JSON file of a run, with its traces, which lie beside it.

    Raises:
        ValueError: one line, the files are not what `write_result` writes.
    """
    evaluation = Evaluation.from_json(read_json(file)["evaluation"])
    traces = load_traces(file.with_suffix(".safetensors"), evaluation.robot, evaluation.lengths)
    return dataclasses.replace(evaluation, traces=traces)


def record_prediction(
    learner: Learner, folder: Path, test: OfflineDataset, every: int, *, official: bool
) -> dict[str, float]:
    """Measure a predictor in training, keep it if it is official, and return what the curves show."""
    assert isinstance(learner.agent, Predictor), f"{learner.name} neither acts nor predicts"
    errors = prediction_errors(learner.agent, test, learner.spec.normalization, learner.config.context, progress=False)
    if official:
        write_prediction(folder, learner.checkpoint(), errors, every, EPISODES)
    return {"test_error": errors.mean}


def write_prediction(
    folder: Path, checkpoint: Checkpoint, errors: PredictionErrors, every: int, episodes: int | None
) -> None:
    """Write `prediction.json` in a run folder.

    Args:
        folder: the run's.
        checkpoint: that was measured.
        errors: its errors in the test dynamics.
        every: the part of the data that they are of, one in this many snapshots.
        episodes: at most this many of each dynamics; None stands for all.
    """
    record = {
        "agent": checkpoint.agent,
        "seed": checkpoint.seed,
        "gradient_steps": checkpoint.step,
        "hours": checkpoint.seconds / 3600,
        "context": checkpoint.config.context,
        "every": every,
        "episodes": episodes,
        "versions": package_versions(),
        "prediction": errors.to_json(),
    }
    write_json(folder / PREDICTION, record)


def score_if_known(evaluation: Evaluation) -> dict[str, float]:
    """The official score as `test_score`; nothing for a robot whose reference scores are not made yet."""
    try:
        return {"test_score": evaluation.score}
    except ValueError:
        return {}


def progress_bar() -> rich.progress.Progress:
    """A bar of steps with a field `note`, on the error stream."""
    return rich.progress.Progress(
        "{task.description}",
        rich.progress.BarColumn(),
        rich.progress.MofNCompleteColumn(),
        rich.progress.TimeRemainingColumn(),
        "{task.fields[note]}",
        console=rich.console.Console(stderr=True),
    )
