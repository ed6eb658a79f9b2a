"""Runs that are one run, whatever their files are called: told by what their episodes returned.

What is here: `check_copies`. Called by `board`, with returns that a replay found where there are traces. It must not
know tables, nor how a submission is verified.

A file's hash tells copies apart from nothing: a comment in it, or the last bit of one action, makes another. Two
policies that are not the same agree in hardly an episode's return to five digits; one that was disturbed at its first
step can go on as any other one does, and is not told from it (docs/submissions.md).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation.submission import FILE_NAME, Run, Submission
from leaderboard.entries import Entry, slug_of
from leaderboard.verify import TOLERANCE

SHARE: Final = 0.5
"""Runs of which more than this part of the episodes return the same are one run."""


def check_copies(folder: Path, submission: Submission, entries: Sequence[Entry]) -> None:
    """Raise ValueError for a run that the submission has twice, or that another entry has.

    An agent's own runs may stand in two entries of a track: of its last checkpoints, and of its best ones. An entry of
    the submission's own name is that submission, or what it replaces.
    """
    others = [
        (f"the entry {entry.slug!r}", run)
        for entry in entries
        if entry.slug != slug_of(submission) and _origin(entry.submission) != _origin(submission)
        for run in entry.submission.runs
    ]
    for number, run in enumerate(submission.runs):
        before = [(f"the same agent's with seed {other.seed}", other) for other in submission.runs[:number]]
        for where, other in [*before, *others]:
            same = same_episodes(run, other)
            if same > SHARE:
                raise ValueError(
                    f"{folder / FILE_NAME}: {run.robot} with seed {run.seed}: {same:.0%} of its episodes are those of "
                    f"{where}: give a run once, and under the name of the agent that made it"
                )


def _origin(submission: Submission) -> tuple[object, ...]:
    return submission.agent, submission.authors, submission.track


def same_episodes(run: Run, other: Run) -> float:
    """The part of two runs' episodes that return the same, to what another machine's rounding may change; 0 to 1.

    Of runs without traces nothing is known but numbers that were sent in: 0.
    """
    if run.robot != other.robot or run.trace is None or other.trace is None:
        return 0.0
    ours, theirs = (np.array(one.evaluation.returns) for one in (run, other))
    if ours.shape != theirs.shape:
        return 0.0
    return float((np.abs(ours - theirs) <= TOLERANCE * (HORIZON + np.abs(theirs))).mean())
