"""More runs of an agent that has an entry: what was trained later, or on another robot, joins it.

What is here: `joined`. Called by `board`. It must not know files, nor how a submission is verified.
"""

import re
from typing import Final

import pydantic

from dynagen_bench.evaluation.result import first_error
from dynagen_bench.evaluation.submission import FILE_NAME, Run, Submission, submission_content

SAME: Final = (
    "agent",
    "track",
    "checkpoint",
    "privileged",
    "authors",
    "description",
    "paper",
    "code",
    "hardware",
    "versions",
)
"""What is said once of all runs of an entry."""


def joined(entry: Submission, more: Submission) -> Submission:
    """The runs of an entry and those of a submission, as one submission.

    Each run keeps the commit that made it, or that none is told; hours are added, and commands put one after the other.

    Raises:
        ValueError: the two do not say the same of their runs, have a run of the same robot and seed, train on one robot
            in different ways, or are too much for one submission; one line.
    """
    for field in SAME:
        ours, theirs = getattr(entry, field), getattr(more, field)
        if ours != theirs:
            raise ValueError(
                f"{FILE_NAME}: {field}: it is {theirs!r}, the entry has {ours!r}, and it is said once of all runs: "
                "mend it where it is a slip; else give the agent another name, or replace the entry"
            )
    _check_runs(entry, more)
    runs = [*_with_commit(entry), *_with_commit(more)]
    commits = {run.commit for run in runs}
    one = commits.pop() if len(commits) == 1 else None
    update = {
        "format_version": max(entry.format_version, more.format_version),
        "runs": [run.model_copy(update={"commit": None}) for run in runs] if one else runs,
        "commit": one,
        "hours": entry.hours + more.hours,
        "commands": list(dict.fromkeys([*entry.commands, *more.commands])),
    }
    try:
        whole = Submission.model_validate(entry.model_copy(update=update).model_dump())
    except pydantic.ValidationError as error:
        raise ValueError(f"{FILE_NAME}: with the entry's runs, {first_error(error)}") from error
    submission_content(whole)  # raises where it would be too large to be read again
    return whole


def _check_runs(entry: Submission, more: Submission) -> None:
    """Raise ValueError for a run that is there, and for one that is no other seed of those on its robot."""
    there = {(run.robot, run.seed) for run in entry.runs}
    steps = {run.robot: run.gradient_steps for run in entry.runs}
    for number, run in enumerate(more.runs):
        if (run.robot, run.seed) in there:
            raise ValueError(
                f"{FILE_NAME}: runs.{number}: the entry has a run of {run.robot} with seed {run.seed}: leave it out, "
                "or replace the entry"
            )
        if steps.get(run.robot, run.gradient_steps) != run.gradient_steps:
            raise ValueError(
                f"{FILE_NAME}: runs.{number}: it has {run.gradient_steps} gradient steps, the entry's on {run.robot} "
                f"have {steps[run.robot]}: train it as long, or give the agent another name"
            )
    for robot in sorted({run.robot for run in more.runs} & {run.robot for run in entry.runs}):
        ours, theirs = (_commands(submission, robot) for submission in (entry, more))
        if ours and theirs and ours != theirs:
            raise ValueError(
                f"{FILE_NAME}: commands: those on {robot} differ in more than the seed, "
                f"{min(theirs - ours or ours - theirs)!r} is not on both sides: train in the same way, or give the "
                "agent another name"
            )


def _commands(submission: Submission, robot: str) -> set[str]:
    """The commands that name a robot, but for their seeds, and their threads, which move the last bits alone."""
    told = (command for command in submission.commands if robot in command)
    return {re.sub(r" --(seed|threads)[ =]\d+|(?<=seed)\d+", "", command) for command in told}


def _with_commit(submission: Submission) -> list[Run]:
    """Its runs, each with the commit that is said of all."""
    return [run.model_copy(update={"commit": run.commit or submission.commit}) for run in submission.runs]
