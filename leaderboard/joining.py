"""More runs of an agent that has an entry: what was trained later, or on another robot, joins it.

What is here: `joined`. Called by `board`. It must not know files, nor how a submission is verified.
"""

from typing import Final

from dynagen_bench.evaluation.submission import FILE_NAME, Run, Submission

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

    Each run keeps the commit that made it; hours are added, and commands put one after the other.

    Raises:
        ValueError: the two do not say the same of their runs, or have a run of the same robot and seed; one line.
    """
    for field in SAME:
        ours, theirs = getattr(entry, field), getattr(more, field)
        if ours != theirs:
            raise ValueError(
                f"{FILE_NAME}: {field}: it is {theirs!r}, the entry has {ours!r}: write the same, or replace the entry"
            )
    there = {(run.robot, run.seed) for run in entry.runs}
    for number, run in enumerate(more.runs):
        if (run.robot, run.seed) in there:
            raise ValueError(
                f"{FILE_NAME}: runs.{number}: the entry has a run of {run.robot} with seed {run.seed}: leave it out, "
                "or replace the entry"
            )
    commits = {*entry.commits, *more.commits}
    runs = [*_with_commit(entry), *_with_commit(more)] if len(commits) > 1 else [*entry.runs, *more.runs]
    return entry.model_copy(
        update={
            "runs": runs,
            "commit": entry.commit if len(commits) <= 1 else None,
            "hours": entry.hours + more.hours,
            "commands": list(dict.fromkeys([*entry.commands, *more.commands])),
        }
    )


def _with_commit(submission: Submission) -> list[Run]:
    """Its runs, each with the commit that is said of all."""
    return [run.model_copy(update={"commit": run.commit or submission.commit}) for run in submission.runs]
