"""Runs → a submission folder: `python -m agents.submit runs/dadt-Hopper-seed* --output my-dadt --authors "A. Name"`.

What is here: reading finished run folders and writing what the leaderboard takes. Called from the command line and by
the demo. It must not know any agent by name, nor the leaderboard.
"""

import dataclasses
import math
import os
import platform
import sys
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import pydantic
import tyro

from agents import AGENTS
from agents.fine_tuning import PAPER, AdaptationSettings
from agents.recording import read_result
from agents.run_folder import (
    DATA,
    RunSettings,
    commit_of_all,
    is_committed,
    read_curve,
    read_finished,
    read_json,
    usual_config,
)
from dynagen_bench import ids
from dynagen_bench.datasets.subsets import ADAPTATION_EPISODES
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.result import first_error
from dynagen_bench.evaluation.submission import (
    FORMAT_VERSION,
    MAX_POINTS,
    CurvePoint,
    Run,
    Submission,
    write_submission,
)
from dynagen_bench.terminal import one_line_errors

Track = Literal["zero-shot", "adaptation"]


class FinishedRun(NamedTuple):
    """A run as it is submitted."""

    config: dict[str, Any]
    """config.json."""
    last: dict[str, Any]
    """evaluation.json, of the last checkpoint."""
    record: dict[str, Any]
    """The result that is submitted, which may be another."""
    evaluation: Evaluation
    """Of that result, with its traces."""
    curve: list[CurvePoint]


def submit(
    runs: Annotated[list[Path], tyro.conf.Positional],
    output: Path,
    authors: list[str],
    name: str | None = None,
    description: str | None = None,
    checkpoint: Literal["last", "best"] = "last",
    track: Track = "zero-shot",
    hardware: str | None = None,
    paper: str | None = None,
    code: str | None = None,
) -> Path:
    """Write a submission of runs of one agent; returns its file.

    Args:
        runs: run folders that training has finished, of one agent, any robots and seeds.
        output: the folder to write.
        authors: who made the agent.
        name: what the table calls it; the agent's name if left out.
        description: one line; the agent's own if left out. A part of the data and the number of steps are always told.
        checkpoint: `last` is official; `best` was chosen by its score in the test dynamics, as in the paper.
        track: `adaptation` submits what `agents.adapt` found, of the last checkpoints.
        hardware: what the runs were trained on; this machine if left out.
        paper: https link.
        code: https link.

    Raises:
        FileNotFoundError: a folder is no finished run, or it has no result of that track.
        ValueError: the runs do not belong together, were adapted on other episodes than the track's, or a text is not
            what the format allows.
    """
    if not runs:
        raise ValueError("no runs given: name at least one run folder")
    found = [_read_run(folder, checkpoint, track) for folder in runs]
    configs, records = [run.config for run in found], [run.record for run in found]
    agent = _the_same("agent", [config["agent"] for config in configs])
    commits = [_commit(run) for run in found]
    for robot in {config["settings"]["robot"] for config in configs}:
        of_robot = [config for config in configs if config["settings"]["robot"] == robot]
        _the_same(f"config for {robot}", [config["config"] for config in of_robot])
        for setting in DATA:
            _the_same(f"{setting} for {robot}", [config["settings"][setting] for config in of_robot])
    adaptation = _the_same("adaptation", [record.get("adaptation") for record in records])
    if adaptation is not None and adaptation["episodes"] != ADAPTATION_EPISODES:
        raise ValueError(
            f"the runs were adapted on {adaptation['episodes']} episodes of each test dynamics, and the track has a "
            f"fixed set of {ADAPTATION_EPISODES}: adapt them again without --episodes"
        )
    try:
        submission = Submission(
            format_version=FORMAT_VERSION,
            agent=name or agent,
            authors=authors,
            description=" ".join((description or _summary(agent), _training_line(found))),
            paper=paper,
            code=code,
            commit=commits[0] if len(set(commits)) == 1 else None,
            track=track,
            checkpoint=checkpoint,
            privileged=_privileged(agent, track),
            hardware=hardware or f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
            hours=sum(record["hours"] for record in records),
            versions=_the_same("versions", [record["versions"] for record in records]),
            commands=[command for run in found for command in _commands(run, checkpoint)],
            runs=[
                Run.from_evaluation(
                    run.evaluation,
                    seed=run.record["seed"],
                    gradient_steps=run.record["gradient_steps"],
                    curve=run.curve,
                    commit=commit if len(set(commits)) > 1 else None,
                )
                for run, commit in zip(found, commits, strict=True)
            ],
        )
    except pydantic.ValidationError as error:
        raise ValueError(f"not a submission: {first_error(error)}") from error
    return write_submission(output, submission, [run.evaluation.traces for run in found])


def _privileged(agent: str, track: Track) -> Literal["none", "own-history", "offline-context"]:
    """What an agent of `AGENTS` knows of a body: of the episode so far at most, and fine-tuned what its data tell."""
    if track == "adaptation":
        return "offline-context"
    return "none" if hasattr(AGENTS[agent][1], "memoryless") else "own-history"


def _read_run(folder: Path, checkpoint: str, track: Track) -> FinishedRun:
    """What a finished run has of a track."""
    if (checkpoint, track) == ("best", "adaptation"):
        raise ValueError("only the last checkpoint is fine-tuned: give --checkpoint last with --track adaptation")
    config, last = read_finished(folder, AGENTS)
    name = "adaptation" if track == "adaptation" else "evaluation" if checkpoint == "last" else "evaluation-best"
    if track == "adaptation" and not (folder / f"{name}.json").is_file():
        raise FileNotFoundError(f"{folder} has no {name}.json: make it with `python -m agents.adapt {folder}`")
    record = read_json(folder / f"{name}.json")
    if record.get("trained_steps", last["gradient_steps"]) != last["gradient_steps"]:
        at, now = record["trained_steps"], last["gradient_steps"]
        raise ValueError(f"{folder} was adapted at step {at} and trained to {now} since: adapt it again")
    if checkpoint == "best":  # found in the whole run's time
        record["hours"] = last["hours"]
    evaluation = read_result(folder / f"{name}.json")
    points = [] if track == "adaptation" else read_curve(folder, "test_return")  # it is of agents without fine-tuning
    points = points[:: -max(1, math.ceil(len(points) / MAX_POINTS))][::-1]  # as many as are taken, the last among them
    curve = [CurvePoint(gradient_steps=step, mean_return=value) for step, value in points]
    return FinishedRun(config, last, record, evaluation, curve)


def _commit(run: FinishedRun) -> str | None:
    """A commit that anybody can check out and make the result by, or None.

    A run may be older than what has adapted it, and the later commit has both.
    """
    trained = run.config["commit"]
    commit = commit_of_all([trained, run.record.get("commit", trained)])
    return commit if is_committed(commit) else None


def _the_same(what: str, values: list[Any]) -> Any:
    for value in values:
        if value != values[0]:
            one, other = _where_they_differ(values[0], value)
            raise ValueError(f"{what} differs between the runs, {one!r} and {other!r}: submit them apart")
    return values[0]


def _where_they_differ(one: Any, other: Any) -> tuple[Any, Any]:
    """Of two records the fields that differ, anything else as it is."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return one, other
    fields = [field for field in one | other if one.get(field) != other.get(field)]
    return {field: one.get(field) for field in fields}, {field: other.get(field) for field in fields}


def _summary(agent: str) -> str:
    """The first line of the agent's file."""
    return (sys.modules[AGENTS[agent][1].__module__].__doc__ or f"{agent}.").split("\n")[0]


def _training_line(runs: list[FinishedRun]) -> str:
    """How the runs were trained, where it differs from the paper's way."""
    settings = [run.config["settings"] for run in runs]
    steps = sorted({run.last["gradient_steps"] for run in runs})
    line = f"Trained for {' or '.join(f'{count:,}' for count in steps)} gradient steps"
    for every in sorted({one["every"] for one in settings} - {1}):
        line += f", on a part of the data alone (one in {every} snapshots)"
    for quality in sorted({one["quality"] for one in settings} - {1}):
        line += f", on the {100 * quality:g}% of the episodes with the lowest returns"
    for count in sorted({one["hold_out"] for one in settings} - {0}):
        line += f", {count} of the {ids.SPLIT_SIZES['train']} train dynamics held out"
    for patience in sorted({run.config["settings"]["patience"] for run in runs if run.last.get("stopped_early")}):
        line += f", stopped early after {patience} evaluations without a better return in those"
    for adaptation in [run.record["adaptation"] for run in runs if "adaptation" in run.record][:1]:
        how = f"fine-tuned for {adaptation['steps']:,} on" if adaptation["steps"] else "given"
        line += f", then {how} {adaptation['episodes']} episodes of each test dynamics"
    return line + "."


def _commands(run: FinishedRun, checkpoint: str) -> list[str]:
    """The commands that make a run's result again: what differs from the defaults, and a machine's precision."""
    agent, settings = run.config["agent"], run.config["settings"]
    defaults = RunSettings(settings["robot"])
    wanted = ["seed", "every", "quality", "hold_out", "patience", "threads"]
    if checkpoint == "best":  # when it looks decides which that is
        wanted.append("evaluate_every")
    changed = _changed({key: settings[key] for key in wanted}, dataclasses.asdict(defaults))
    if "patience" in changed:  # and where it stops
        changed["evaluate_every"] = settings["evaluate_every"]
    usual = usual_config(agent, settings["robot"], run.config["config"]["steps"])
    usual |= {"steps": AGENTS[agent][0].steps, "precision": None}
    options = _options(changed | _changed(run.config["config"], usual))
    commands = [" ".join([f"python -m agents.train {agent} --robot {settings['robot']}", *options])]
    if "adaptation" in run.record:
        named = ("seed", "every", "quality", "hold_out")
        folder = dataclasses.replace(defaults, **{key: settings[key] for key in named}).folder(agent)
        # the paper has no number of steps: ours may be another in the commit that has adapted the run
        usual = dataclasses.asdict(AdaptationSettings()) | PAPER | {"threads": 0}
        threads = {"threads": run.record.get("threads", 0)}  # 0: it was made at several numbers, or before it was told
        options = _options(_changed(run.record["adaptation"] | threads, usual))
        commands.append(" ".join([f"python -m agents.adapt {folder.as_posix()}", *options]))
    return commands


def _changed(values: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value != defaults.get(key)}


def _options(values: dict[str, Any]) -> list[str]:
    return [f"--{key.replace('_', '-')} {value}" for key, value in values.items()]


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    with one_line_errors():
        path = tyro.cli(submit, prog="python -m agents.submit", args=arguments)
        print(f"written: {path}")


if __name__ == "__main__":
    main()
