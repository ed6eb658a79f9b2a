"""Runs → a submission folder: `python -m agents.submit runs/dadt-Hopper-seed* --output my-dadt --authors "A. Name"`.

What is here: reading finished run folders and writing what the leaderboard takes. Called from the command line and by
the demo. It must not know any agent by name, nor the leaderboard.
"""

import dataclasses
import os
import platform
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
import rich
import tyro

from agents import AGENTS
from agents.run_folder import RunSettings, read_curve, read_json
from dynagen_bench.evaluation.result import EpisodeRecord, first_error
from dynagen_bench.evaluation.submission import CurvePoint, Run, Submission, write_submission
from dynagen_bench.evaluation.traces import Traces, load_traces


def submit(
    runs: Annotated[list[Path], tyro.conf.Positional],
    output: Path,
    authors: list[str],
    name: str | None = None,
    description: str | None = None,
    checkpoint: Literal["last", "best"] = "last",
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
        hardware: what the runs were trained on; this machine if left out.
        paper: https link.
        code: https link.

    Raises:
        FileNotFoundError: a folder is no finished run.
        ValueError: the runs do not belong together, or a text is not what the format allows.
    """
    if not runs:
        raise ValueError("no runs given: name at least one run folder")
    found = [_read_run(folder, checkpoint) for folder in runs]
    configs, records = [config for config, _ in found], [record for _, record in found]
    traces = [_traces(folder, checkpoint, record) for folder, record in zip(runs, records, strict=True)]
    agent = _the_same("agent", [config["agent"] for config in configs])
    commit = _the_same("commit", [config["commit"] for config in configs])
    for robot in {config["settings"]["robot"] for config in configs}:
        _the_same(f"config for {robot}", [c["config"] for c in configs if c["settings"]["robot"] == robot])
    try:
        submission = Submission(
            format_version=2,
            agent=name or agent,
            authors=authors,
            description=" ".join((description or _summary(agent), _training_line(configs))),
            paper=paper,
            code=code,
            commit=commit if commit and not commit.endswith("-dirty") else None,
            track="zero-shot",
            checkpoint=checkpoint,
            privileged="own-history",  # all agents see the last K steps of the episode, and no other
            hardware=hardware or f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
            hours=sum(record["hours"] for record in records),
            versions=_the_same("versions", [record["versions"] for record in records]),
            commands=[_command(config) for config in configs],
            runs=[_run(*run) for run in zip(runs, records, traces, strict=True)],
        )
    except pydantic.ValidationError as error:
        raise ValueError(f"not a submission: {first_error(error)}") from error
    return write_submission(output, submission, traces)


def _read_run(folder: Path, checkpoint: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """config.json and the evaluation of a finished run."""
    for file in ("config.json", "evaluation.json", "evaluation-best.json"):
        if not (folder / file).is_file():
            raise FileNotFoundError(f"{folder} is no finished run, it has no {file}: train it to the end first")
    config, last = read_json(folder / "config.json"), read_json(folder / "evaluation.json")
    if last["gradient_steps"] != config["config"]["steps"]:
        found, wanted = last["gradient_steps"], config["config"]["steps"]
        raise ValueError(f"{folder} was evaluated at step {found} of {wanted}: train it to the end first")
    if checkpoint == "last":
        return config, last
    return config, read_json(folder / "evaluation-best.json") | {
        "hours": last["hours"]
    }  # found in the whole run's time


def _traces(folder: Path, checkpoint: str, record: dict[str, Any]) -> Traces:
    """The traces of the checkpoint's evaluation."""
    evaluation = EpisodeRecord.model_validate(record["evaluation"]).evaluation()
    name = "evaluation.safetensors" if checkpoint == "last" else "evaluation-best.safetensors"
    return load_traces(folder / name, evaluation.robot, evaluation.lengths)


def _run(folder: Path, record: dict[str, Any], traces: Traces) -> Run:
    evaluation = EpisodeRecord.model_validate(record["evaluation"])
    curve = [CurvePoint(gradient_steps=step, mean_return=value) for step, value in read_curve(folder, "test_return")]
    return Run(
        robot=evaluation.robot,
        seed=record["seed"],
        gradient_steps=record["gradient_steps"],
        evaluation=evaluation,
        trace=traces.sha256,
        curve=curve,
    )


def _the_same(what: str, values: list[Any]) -> Any:
    for value in values:
        if value != values[0]:
            raise ValueError(f"{what} differs between the runs, {values[0]!r} and {value!r}: submit them apart")
    return values[0]


def _summary(agent: str) -> str:
    """The first line of the agent's file."""
    return (sys.modules[AGENTS[agent][1].__module__].__doc__ or agent).split("\n")[0]


def _training_line(configs: list[dict[str, Any]]) -> str:
    """How the runs were trained, where it differs from the paper's way."""
    steps = sorted({config["config"]["steps"] for config in configs})
    line = f"Trained for {' or '.join(f'{count:,}' for count in steps)} gradient steps"
    for every in sorted({config["settings"]["every"] for config in configs} - {1}):
        line += f", on a part of the data alone (one in {every} snapshots)"
    return line + "."


def _command(config: dict[str, Any]) -> str:
    """The command that trains a run again: what differs from the defaults, and the precision, which is a machine's."""
    agent, settings = config["agent"], config["settings"]
    defaults = dataclasses.asdict(RunSettings(settings["robot"]))
    changed = {key: settings[key] for key in ("seed", "every") if settings[key] != defaults[key]}
    usual = dataclasses.asdict(AGENTS[agent][0]().for_robot(settings["robot"])) | {"precision": None}
    changed |= {key: value for key, value in config["config"].items() if value != usual.get(key)}
    words = (f"--{key.replace('_', '-')} {value}" for key, value in changed.items())
    return " ".join([f"python -m agents.train {agent} --robot {settings['robot']}", *words])


def main(arguments: list[str] | None = None) -> None:
    """The command line; an error that a user can mend is one line."""
    try:
        path = tyro.cli(submit, args=arguments)
    except (ValueError, FileNotFoundError) as error:
        sys.exit(f"error: {error}")
    rich.print(f"written: {path}")


if __name__ == "__main__":
    main()
