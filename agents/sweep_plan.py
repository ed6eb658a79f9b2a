"""What a sweep is made of: command lines of `agents.train` with braces → runs, each with a folder of its own.

What is here: `SweepRun`, `plan` and `is_finished`. Called by `sweep`. Nothing is started here, and no data are read.

A run's folder is named as `agents.train` names it, dadt-Hopper-seed0, with the options that braces choose behind, as
-next-state-weight0.05.
"""

import contextlib
import dataclasses
import io
import itertools
import json
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from agents.braces import expand
from agents.config import TrainingConfig
from agents.recording import run_files
from agents.run_folder import TENSORBOARD, RunSettings, check_same_run, ends_run, facts_of, read_config, read_json
from agents.train import parse
from dynagen_bench.jobs import Job

MOST: Final = 10_000
"""Runs of one line; more are a slip of the pen."""

_IN_NAME: Final = {"agent", "robot", "seed", "every", "quality", "hold-out"}
"""Options that `RunSettings.folder` tells by itself."""

_OURS: Final = ("runs", "name", "threads")
"""Settings that a sweep fixes."""


@dataclasses.dataclass(frozen=True)
class SweepRun:
    """One run of a sweep.

    Attributes:
        name: of its folder.
        command: the command line of `agents.train` that it stands for.
        agent, config, settings: what `parse` reads in it, the config resolved for the robot.
    """

    name: str
    command: str
    agent: str
    config: TrainingConfig
    settings: RunSettings

    @property
    def description(self) -> dict[str, Any]:
        """Its agent, config and settings, but for where it is, as JSON types."""
        settings = {k: v for k, v in dataclasses.asdict(self.settings).items() if k != "runs"}
        content = {"agent": self.agent, "config": dataclasses.asdict(self.config), "settings": settings}
        described: dict[str, Any] = json.loads(json.dumps(content))
        return described

    @property
    def job(self) -> Job:
        """The run as a job."""
        return Job(
            name=self.name,
            function="agents.sweep:train_one",
            arguments=self.description | {"command": self.command},
            outputs=tuple(f"{self.name}/{file}" for file in run_files(self.agent)),
            total=self.config.steps,
        )


def plan(lines: Sequence[str]) -> list[SweepRun]:
    """The runs that command lines with braces stand for; nothing is started.

    Raises:
        ValueError: a line makes no sense, or two runs are the same or would share a folder.
    """
    planned = [one for line in lines for one in _runs_of(line)]
    if not planned:
        raise ValueError("no runs given: name at least one command line, such as 'dadt --robot Hopper --seed {0,1,2}'")
    names: dict[str, SweepRun] = {}
    same: dict[str, SweepRun] = {}
    for one in planned:
        what = json.dumps(_asked(one.description), sort_keys=True)
        if what in same:
            raise ValueError(f"the same run twice, {same[what].command!r} and {one.command!r}: leave one out")
        if one.name in names:
            other = names[one.name].command
            raise ValueError(
                f"{one.name} would be the folder of both {other!r} and {one.command!r}: write them as one line, with "
                "what differs in braces"
            )
        names[one.name] = same[what] = one
    return planned


def is_finished(one: SweepRun, runs: Path) -> bool:
    """Whether a run is complete in its folder, by a sweep or by `agents.train` itself.

    Raises:
        ValueError: the folder is of a run with another config or other settings, or of one that `agents.train` is at.
    """
    path = runs / one.name / "config.json"
    if not path.is_file():
        return False
    found = read_config(path.parent)
    there = {key: value for key, value in found.items() if key != "data"}  # which no command line tells
    check_same_run(path.parent, _asked(there), _asked(one.description), instead="--runs")
    files = [runs / output for output in one.job.outputs]
    if all(file.is_file() for file in files) and ends_run(read_json(files[-1]), one.config.steps):
        return True
    if (path.parent / TENSORBOARD).is_dir():  # a sweep trains elsewhere and moves no events here
        raise ValueError(
            f"{path.parent} was begun by agents.train and is not finished: go on with `{found.get('command')}`, or "
            "delete the folder"
        )
    return False


def _asked(description: Mapping[str, Any]) -> dict[str, Any]:
    """What a command line asks for, flat, but for what a sweep fixes."""
    return {key: value for key, value in facts_of(description).items() if key not in _OURS}


def _runs_of(line: str) -> list[SweepRun]:
    """The runs of one line."""
    commands = list(itertools.islice(expand(line), MOST + 1))
    if len(commands) > MOST:
        raise ValueError(f"{line!r} stands for more than {MOST:,} runs: give fewer")
    read = [_read(command) for command in commands]
    options = [_options(words) for words, _ in read]
    varied = {key for every in options for key in every if any(every[key] != other.get(key) for other in options)}
    found = []
    for (words, (agent, config, settings)), own in zip(read, options, strict=True):
        chosen = (f"-{key}{own[key]}" for key in own if key in varied - _IN_NAME)
        name = re.sub(r"[^\w.+-]", "_", settings.folder(agent).name + "".join(chosen))
        settings = dataclasses.replace(settings, name=name, threads=1)
        found.append(SweepRun(name, f"python -m agents.train {shlex.join(words)}", agent, config, settings))
    return found


def _read(command: str) -> tuple[list[str], tuple[str, TrainingConfig, RunSettings]]:
    """A command's words, and what they ask for; raises ValueError in one line that names the command."""
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(told):
            words = shlex.split(command)
            agent, config, settings = parse(words)
            config = config.for_robot(settings.robot)
    except ValueError as error:
        raise ValueError(f"in {command!r}: {error}") from error
    except SystemExit:
        lines = (line.strip(" │") for line in told.getvalue().split("For full helptext")[0].splitlines())
        reason = " ".join(line for line in lines if re.search(r"\w", line) and "─" not in line)  # no frame, no title
        raise ValueError(f"{command!r} is no command line of agents.train: {reason or 'it asks for help'}") from None
    defaults = RunSettings(settings.robot)
    for key in _OURS:
        if getattr(settings, key) != getattr(defaults, key):
            raise ValueError(f"in {command!r}: --{key} is the sweep's to choose, leave it out")
    return words, (agent, config, settings)


def _options(words: Iterable[str]) -> dict[str, str]:
    """Option → its value as written, "agent" being the first word."""
    options, option = dict[str, str](), "agent"
    for word in words:
        if word.startswith("--"):
            option, _, value = word[2:].partition("=")
            option = option.replace("_", "-")
            options[option] = value
        else:
            options[option] = "-".join(filter(None, (options.get(option), word)))
    return options
