"""Verification: what a submission claims against what its traces do when they are stepped again.

What is here: `verify`, one `RunCheck` a run, and the label that follows. Called by `board` and the command line. It
must not know boards, tables or pages.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.submission import FILE_NAME, Run, Submission, read_traces
from dynagen_bench.evaluation.traces import physics_digest
from leaderboard.entries import LABELS, Label
from leaderboard.verify_replay import Replay, replay

TOLERANCE: Final = 1e-5
"""Where a run was made by other arithmetic (another `physics` digest or MuJoCo), a replayed number x may differ from
the stored one by 1e-5 · (1 + |x|), and a return R from the claimed one by 1e-5 · (200 + |R|). A change of the last bit
of a state grew to at most 3e-7 in the ten steps of a segment, measured on random actions in all robots."""

MAX_FAULTS: Final = 20
"""Faults of a run that are said; of more, only how many there are."""


class RunCheck(NamedTuple):
    """What was found of one run."""

    run: Run
    label: Label
    returns: NDArray[np.float64]
    """(dynamics, episodes): those of the replay, or the claimed ones of a run without traces."""
    physics: str | None
    """Digest of the arithmetic that gave these returns and the trace's states; None where they are of two machines."""
    transitions: int
    """Steps that were replayed."""
    seconds: float
    faults: tuple[str, ...]
    """One line each, naming file, field and episode; none if all is right."""


def verify(
    folder: Path, submission: Submission, done: Callable[[RunCheck], None] = lambda check: None
) -> list[RunCheck]:
    """Replay the runs of the submission in `folder` that have traces; `done` is called with each as it is ready.

    The submission has been read from there, and is of the official protocol (`entries.read_official`). One run's traces
    are in memory at a time, about 1 MB.
    """
    checks = []
    for number, run in enumerate(submission.runs):
        started = time.perf_counter()
        checks.append(_check_run(folder, number, run)._replace(seconds=time.perf_counter() - started))
        done(checks[-1])
    return checks


def label_of(checks: list[RunCheck]) -> Label:
    """The label of an entry: the least of its runs'."""
    return min((check.label for check in checks), key=LABELS.index)


def _check_run(folder: Path, number: int, run: Run) -> RunCheck:
    evaluation = run.evaluation.evaluation()
    if run.trace is None:
        return RunCheck(run, "self-reported", evaluation.returns, evaluation.physics, 0, 0.0, ())
    try:
        traces = read_traces(folder, run)
    except (FileNotFoundError, ValueError) as error:
        return RunCheck(run, "self-reported", evaluation.returns, evaluation.physics, 0, 0.0, (str(error),))
    here = physics_digest(run.robot)
    exact = evaluation.mujoco == mujoco.__version__ and evaluation.physics == here
    found = replay(evaluation, traces)
    same = np.array_equal(found.starts, found.first_states) and np.array_equal(found.ends, found.stored_ends)
    tolerance = 0.0 if exact or same else TOLERANCE
    claims = 0.0 if exact else TOLERANCE
    faults = list(_faults(folder, number, run, evaluation, found, tolerance, claims))
    if len(faults) > MAX_FAULTS:
        faults = [*faults[:MAX_FAULTS], f"{folder / FILE_NAME}: runs.{number}: and {len(faults) - MAX_FAULTS} more"]
    label: Label = "self-reported" if faults else "replayed (tolerance)" if tolerance else "replayed"
    returns = found.returns.reshape(evaluation.returns.shape)
    physics = here if exact or same else None
    return RunCheck(run, label, returns, physics, int(evaluation.lengths.sum()), 0.0, tuple(faults))


def _faults(
    folder: Path, number: int, run: Run, evaluation: Evaluation, found: Replay, tolerance: float, claims: float
) -> Iterator[str]:
    """At most one line an episode: the first thing that is wrong with its trace, else with its claimed return.

    `tolerance` is of states, `claims` of claimed returns; 0 where they have to be exact.
    """
    lengths = evaluation.lengths.ravel()
    starts = _differences(found.first_states, found.starts, tolerance)
    ends = _differences(found.stored_ends, found.ends, tolerance)
    allowed = claims * (HORIZON + np.abs(found.returns))
    claimed = evaluation.returns.ravel()
    for episode, length in enumerate(lengths.tolist()):
        row, column = divmod(episode, evaluation.seeds.shape[1])
        trace = f"{folder / run.trace_name}: {evaluation.labels[row]} episode {column}"
        field = f"{folder / FILE_NAME}: runs.{number}.evaluation"
        bad = np.flatnonzero((found.episodes == episode) & (ends > 0))
        terminal = np.flatnonzero(found.terminated[episode, : length - 1])
        if starts[episode] > 0:
            seed = int(evaluation.seeds[row, column])
            yield f"{trace}: states: the first is not the reset of seed {seed}, it is off by {starts[episode]:.2g}"
        elif len(bad):
            first = int(found.first_steps[bad[0]])
            last = min(first + 9, length - 1)
            yield f"{trace}: actions or states: steps {first} to {last} end elsewhere, off by {ends[bad[0]]:.2g}"
        elif len(terminal):
            yield (
                f"{field}.lengths.{row}.{column}: the episode goes on to {length} steps, "
                f"but its step {terminal[0]} led to a terminal state"
            )
        elif length < HORIZON and not found.terminated[episode, length - 1]:
            yield f"{field}.lengths.{row}.{column}: the episode ends after {length} steps in no terminal state"
        elif not np.abs(claimed[episode] - found.returns[episode]) <= allowed[episode]:
            yield (
                f"{field}.returns.{row}.{column}: {claimed[episode]} is claimed, the replay returns "
                f"{found.returns[episode]}"
            )


def _differences(stored: NDArray[np.float64], found: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """By how much rows (M, X) differ at most, where that is more than the tolerance; 0 for rows that agree."""
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(stored - found)
        allowed = difference <= tolerance * (1.0 + np.abs(found))
    differences = np.where(allowed | (stored == found), 0.0, np.nan_to_num(difference, nan=np.inf))
    worst: NDArray[np.float64] = differences.max(axis=1)
    return worst
