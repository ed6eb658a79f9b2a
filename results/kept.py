"""Runs that are kept in the repository: without weights and traces, which the commands that they tell make again.

What is here: `keep`, and reading what is kept: curves, scores, next-state errors, the steps of adaptation, times of the
compute benchmark. Called by the command line and the page. It must not know how anything looks.

    results/runs/reference/dadt-Hopper-seed0/
      config.json            resolved config, settings, command, commit, versions
      curves.csv             the learning curves
      evaluation.json        the official evaluation; not of the first runs, whose returns the board has
      prediction.json        next-state errors in the test dynamics, of what predicts
      evaluation-train.json  returns in train dynamics, beside the untrained agent's
      adaptation-curve.csv   returns by steps of fine-tuning, of runs that held out train dynamics
      target-curve.csv       returns by what was asked for, of such runs
    results/compute.json     group of tests/benchmarks/test_compute.py → name → seconds
"""

import csv
import json
import re
import shlex
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents import AGENTS
from agents.run_folder import (
    ADAPTATION_CURVE,
    LEARNED,
    PREDICTION,
    TARGET_CURVE,
    ends_run,
    identity,
    is_committed,
    read_config,
    read_json,
    write_json,
)
from agents.summary.runs import Run, read_runs
from dynagen_bench.datasets.scores import normalized_score
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.whole import exclusively, whole_folder
from leaderboard.statistics import Scores

FOLDER: Final = Path(__file__).parent

REFERENCE: Final = "reference"
"""The group of runs behind the board's entries and the table of errors; others are named by what they vary."""

EVALUATION: Final = "evaluation.json"
"""Of a run's last checkpoint, in its folder."""

_COPIED: Final = ("curves.csv", EVALUATION, PREDICTION, ADAPTATION_CURVE, TARGET_CURVE, LEARNED)

_OF_A_MACHINE: Final = ("runs", "name", "threads")
"""Settings that say where a run was made, and nothing about it but for its last bits."""


class Errors(NamedTuple):
    """Next-state errors of the runs of one agent on one robot."""

    agent: str
    robot: str
    values: NDArray[np.float64]
    """(R, M) mean square errors of R runs in M test dynamics."""
    unchanged: float | None = None
    """Error of the present state in place of a prediction; None of runs that were measured before it was."""


def keep(runs: Sequence[Path], group: str, folder: Path = FOLDER, replace: bool = False) -> list[Path]:
    """Copy what is kept of finished runs, anew what is kept of the same run already. Returns the folders.

    Args:
        runs: their folders.
        group: what they belong to.
        folder: with the groups in `runs/`.
        replace: another run of the same name is replaced, whatever it had.

    Raises:
        FileNotFoundError: a folder is no run that has trained.
        FileExistsError: another run of the same name is kept.
        ValueError: no run is given, two have one name, one is not finished, or not of committed code: nobody could make
            it again; or the group is no name of a folder.
    """
    if not runs:
        raise ValueError("no run is given: give the folders of finished runs, as runs/dadt-Hopper-seed0")
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", group):
        raise ValueError(f"the group is {group!r}: give words in small letters, as {REFERENCE} or low-quality")
    found = {run: _checked(run) for run in (given.resolve() for given in runs)}  # all of them before any is written
    names = [run.name for run in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"two of the runs are called {twice[0]}, and would be kept in one folder: rename one of them")
    places = {run: folder / "runs" / group / run.name for run in found}
    for run, place in places.items():
        if not replace and place.is_dir() and not _goes_on(found[run], read_config(place)):
            raise FileExistsError(
                f"{place} is another run, made by {read_config(place).get('command')!r}: give --replace, or another "
                "--group"
            )
    for run, place in places.items():
        with exclusively(place), whole_folder(place) as unfinished:
            write_json(unfinished / "config.json", _told(found[run]))
            for name in _COPIED:
                if (run / name).is_file():
                    shutil.copyfile(run / name, unfinished / name)
    return list(places.values())


def _told(about: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of a run's config.json."""
    settings = {key: value for key, value in about["settings"].items() if key not in _OF_A_MACHINE}
    return {**about, "settings": settings, "command": _plain(about.get("command"))}


def _goes_on(about: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Whether a run is the one before, made again or continued."""
    return identity(about) == identity(before) and about["config"]["steps"] >= before["config"]["steps"]


def _checked(run: Path) -> dict[str, Any]:
    """The config.json of a run that can be kept; raises as `keep` does."""
    if not (run / "config.json").is_file() or not (run / "curves.csv").is_file():
        raise FileNotFoundError(f"{run} is no run, it has no config.json and curves.csv: train it first")
    about = read_config(run)
    commit = about.get("commit")
    if not is_committed(commit):
        raise ValueError(f"{run} was made by {commit or 'no commit'}: commit the code and train it again")
    _check_finished(run, about)
    return about


def _plain(command: str | None) -> str | None:
    """A command without the options that say where a run was made."""
    where = [f"--{setting}" for setting in _OF_A_MACHINE]
    words = shlex.split(command or "")
    kept = [
        word
        for before, word in zip(["", *words], words, strict=False)
        if before not in where and word.partition("=")[0] not in where
    ]
    return shlex.join(kept) or None


def _check_finished(run: Path, about: Mapping[str, Any]) -> None:
    """Raise ValueError if a run has no official result of its last step, or of where held-out dynamics ended it.

    And if its next-state errors, or its returns in train dynamics, are those of another step.
    """
    steps, result = about["config"]["steps"], run / (EVALUATION if about["agent"] in AGENTS else PREDICTION)
    official = read_json(result) if result.is_file() else {}
    last = official.get("gradient_steps", 0)
    if not ends_run(official, steps):
        raise ValueError(f"{run} has a result of step {last} of {steps}: train it to the end first")
    for file, command in ((run / PREDICTION, "agents.predict"), (run / LEARNED, "agents.evaluate")):
        if file.is_file() and (measured := read_json(file)["gradient_steps"]) != last:
            raise ValueError(f"{file} is of step {measured}, the run is at step {last}: run {command} again")


def keep_compute(benchmark: Path, folder: Path = FOLDER) -> Path:
    """Take the times out of pytest-benchmark's JSON of `tests/benchmarks/test_compute.py`.

    What is kept: name of the test → name of the agent → least processor seconds of a gradient step, or of a step of
    acting in ten episodes.

    Raises:
        ValueError: the file has not both of these tests.
    """
    try:
        found = {
            run["name"]: run["extra_info"]["seconds"]
            for run in json.loads(benchmark.read_text(encoding="utf-8"))["benchmarks"]
            if run["fullname"].startswith("tests/benchmarks/test_compute.py")
        }
    except (ValueError, KeyError, TypeError):  # no JSON, or other JSON
        found = {}
    if found.keys() != {"test_gradient_steps", "test_acting_in_ten_episodes"}:
        raise ValueError(f"{benchmark} has no whole run of tests/benchmarks/test_compute.py: give one that has")
    write_json(folder / "compute.json", found)
    return folder / "compute.json"


def kept_runs(group: str, folder: Path = FOLDER) -> list[Run]:
    """The runs of a group by name; none if there is no such group."""
    return read_runs(folder / "runs" / group)


def check_seeds(group: str, runs: Sequence[Run], fact: str) -> None:
    """Check that runs of one value of a fact, on one robot, differ in their seed and in nothing else.

    They are taken for seeds of one another in every mean and in every claim.

    Raises:
        ValueError: two of them have the same seed, or another setting; the message names both and the difference.
    """
    first: dict[tuple[str, str], Run] = {}
    seeds: dict[tuple[str, str, int], str] = {}
    for run in runs:
        value = str(run.facts.get(fact)), run.facts["robot"]
        other = first.setdefault(value, run)
        differing = [key for key in {**other.facts, **run.facts} if other.facts.get(key) != run.facts.get(key)]
        if differing:
            raise ValueError(
                f"{other.name} and {run.name} of the group {group!r} differ in {', '.join(differing)}: keep one of "
                "them in a group of its own"
            )
        same = seeds.setdefault((*value, run.seed), run.name)
        if same != run.name:
            raise ValueError(f"{same} and {run.name} of the group {group!r} have the same seed: keep one of them")


def beside_reference(runs: Sequence[Run], reference: Sequence[Run], fact: str) -> list[Run]:
    """The runs, and the reference runs that differ from one of them in a fact and their seed, and in nothing else.

    What is varied has a value in the reference runs already: that one is trained and kept once.
    """
    alike = [_facts_but(run, fact) for run in runs]
    return [*runs, *(run for run in reference if _facts_but(run, fact) in alike)]


def _facts_but(run: Run, fact: str) -> dict[str, Any]:
    return {key: value for key, value in run.facts.items() if key != fact}


def kept_scores(group: str, folder: Path = FOLDER) -> dict[str, Scores]:
    """Agent → robot → (R, M) official scores of a group's runs in each test dynamics, of their last checkpoints.

    Raises:
        FileNotFoundError: a run was kept without its evaluation.
    """
    found: dict[str, dict[str, list[NDArray[np.float64]]]] = {}
    for run in kept_runs(group, folder):
        file = folder / "runs" / group / run.name / EVALUATION
        if not file.is_file():
            raise FileNotFoundError(f"{file.parent} has no {EVALUATION}: keep the run again, with it")
        evaluation = Evaluation.from_json(read_json(file)["evaluation"])
        scores = normalized_score(evaluation.robot, evaluation.returns.mean(axis=1))
        found.setdefault(run.facts["agent"], {}).setdefault(evaluation.robot, []).append(scores)
    return {agent: {robot: np.stack(of) for robot, of in robots.items()} for agent, robots in found.items()}


def kept_errors(group: str = REFERENCE, folder: Path = FOLDER) -> list[Errors]:
    """The next-state errors of a group's runs, by agent and robot.

    Raises:
        ValueError: runs on one robot were measured in other data, or runs of one agent at other steps.
    """
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for path in sorted((folder / "runs" / group).glob(f"*/{PREDICTION}")):
        record = read_json(path)
        found.setdefault((record["agent"], record["prediction"]["robot"]), []).append(record)
    data: dict[str, tuple[str, Any]] = {}
    for (agent, robot), records in found.items():
        ways = {json.dumps([record["every"], record["episodes"], record["gradient_steps"]]) for record in records}
        if len(ways) > 1:
            raise ValueError(f"the errors of {agent} on {robot} were measured in different ways: {sorted(ways)}")
        own = [records[0]["every"], records[0]["episodes"]]
        other, theirs = data.setdefault(robot, (agent, own))
        if own != theirs:
            raise ValueError(
                f"the errors of {other} and {agent} on {robot} were measured in other data, every and episodes "
                f"{theirs} and {own}: run agents.predict of both alike"
            )
    return [
        Errors(agent, robot, np.array([record["prediction"]["errors"] for record in records]), _unchanged(records))
        for (agent, robot), records in found.items()
    ]


def _unchanged(records: Sequence[dict[str, Any]]) -> float | None:
    told = [record["prediction"]["unchanged"] for record in records if "unchanged" in record["prediction"]]
    return float(np.mean(told[0])) if told else None


def kept_learning(group: str = REFERENCE, folder: Path = FOLDER) -> list[dict[str, Any]]:
    """What `agents.evaluate` found of a group's runs, by the runs' names."""
    return [read_json(path) for path in sorted((folder / "runs" / group).glob(f"*/{LEARNED}"))]


def held_out_curves(group: str, name: str, folder: Path = FOLDER) -> dict[str, dict[float, float]]:
    """Name of a run → steps of fine-tuning, or what was asked for → mean return in the train dynamics it held out.

    Args:
        group: of runs.
        name: of the curve, `ADAPTATION_CURVE` or `TARGET_CURVE`.
        folder: with the group's runs.
    """
    found = {}
    for path in sorted((folder / "runs" / group).glob(f"*/{name}")):
        with path.open(newline="", encoding="utf-8") as file:
            _, *lines = csv.reader(file)
        found[path.parent.name] = {float(at): float(mean) for at, mean, *_ in lines}
    return found


def compute_times(folder: Path = FOLDER) -> Mapping[str, Mapping[str, float]]:
    """What `keep_compute` kept; nothing if it has not."""
    path = folder / "compute.json"
    return read_json(path) if path.is_file() else {}
