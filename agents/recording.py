"""What is seen and kept of a run: its progress, and what it can do, measured now and then and in the end.

What is here: who acts is evaluated in the test dynamics and who predicts is tested on their data, by what it is and not
by its name; the files that this leaves. Called by `train`, and by whoever reads or shows a run. It must not know the
training loop.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Protocol

import rich.console
import rich.progress

from agents import TRAINABLE
from agents.checkpoint import package_versions, save_checkpoint
from agents.interface import Agent
from agents.learner import Learner
from agents.prediction import PREDICTION, record_prediction
from agents.run_folder import RunSettings, read_json, write_json
from dynagen_bench.datasets import load_dataset
from dynagen_bench.evaluation import Evaluation, evaluate
from dynagen_bench.evaluation.traces import save_traces


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
    traces = evaluation.traces
    assert traces is not None, "evaluate records traces unless told not to"
    record = {
        "agent": learner.name,
        "seed": learner.seed,
        "gradient_steps": learner.step,
        "stopped_early": official and learner.step < learner.config.steps,
        "hours": learner.seconds / 3600,
        "versions": package_versions(),
        "evaluation": evaluation.to_json(),
    }
    mean_return = float(evaluation.returns.mean())  # orders as the score does, and needs no reference scores
    best = folder / "evaluation-best.json"
    if not best.is_file() or mean_return > Evaluation.from_json(read_json(best)["evaluation"]).returns.mean():
        best.unlink(missing_ok=True)  # a kill before the third file leaves none of two steps: this is measured again
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
