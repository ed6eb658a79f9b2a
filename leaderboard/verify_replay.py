"""Stepping the episodes of a trace again, all of their segments at the same time.

What is here: `replay`. Called by `verify`. It must not know what was claimed, nor what counts as a fault.
"""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.rollout import reset_generators
from dynagen_bench.evaluation.traces import INTERVAL, Traces, stored_states


class Replay(NamedTuple):
    """What N episodes did when they were stepped again; E segments in all, an episode's one after another."""

    starts: NDArray[np.float64]
    """(N, X), the states that the seeds give."""
    first_states: NDArray[np.float64]
    """(N, X), the trace's own first states."""
    episodes: NDArray[np.int64]
    """(E,), the episode of each segment."""
    first_steps: NDArray[np.int64]
    """(E,), at which of its steps each segment begins."""
    ends: NDArray[np.float64]
    """(E, X), where each segment led from its stored state."""
    stored_ends: NDArray[np.float64]
    """(E, X), the trace's next stored state."""
    terminated: NDArray[np.bool_]
    """(N, HORIZON): the step led to a terminal state; False after the episode's length."""
    returns: NDArray[np.float64]
    """(N,), the rewards added in the order of the steps, as `evaluate` does."""


def replay(evaluation: Evaluation, traces: Traces) -> Replay:
    """Step every segment of the traces of an evaluation from its stored state, in the evaluation's dynamics.

    A step is a function of (dynamics, state, action) alone, so that E segments are E lanes of one batch and take ten
    steps of it, whatever the episodes' lengths; if every segment ends where the next one begins, the episodes are what
    the seeds and actions give.
    """
    lengths = evaluation.lengths.ravel()
    segments = stored_states(lengths) - 1
    episodes = np.repeat(np.arange(len(lengths)), segments)
    numbers = np.arange(len(episodes)) - np.repeat(np.cumsum(segments) - segments, segments)
    # of the episodes before it, each has one stored state more than segments
    rows = np.arange(len(episodes)) + episodes
    drawn = [load_dynamics(evaluation.robot, evaluation.split, index) for index in evaluation.indices]
    # A batch of its own for each run, because it notices a bad state of a lane by a count that has to begin at 0
    physics = BatchPhysics(evaluation.robot, [drawn[i // evaluation.seeds.shape[1]] for i in episodes])
    lanes = np.arange(len(lengths))
    physics.start(lanes, reset_generators(evaluation.seeds))
    starts = physics.states[lanes].copy()
    physics.states[:] = traces.states[rows]
    with _no_warnings_on_disk():
        rewards, terminated = _step(physics, episodes, INTERVAL * numbers, lengths, traces.actions)
    returns = np.zeros(len(lengths))
    for step in range(HORIZON):
        returns += rewards[:, step]
    first = traces.states[np.cumsum(segments + 1) - segments - 1]
    ends = physics.states.copy()
    return Replay(starts, first, episodes, INTERVAL * numbers, ends, traces.states[rows + 1], terminated, returns)


def _step(
    physics: BatchPhysics,
    episodes: NDArray[np.int64],
    first_steps: NDArray[np.int64],
    lengths: NDArray[np.int64],
    actions: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Run all segments (E,) to their ends; rewards and terminations, (N, HORIZON)."""
    rewards = np.zeros((len(lengths), HORIZON))
    terminated = np.zeros((len(lengths), HORIZON), dtype=np.bool_)
    before = np.cumsum(lengths) - lengths  # actions of the episodes before each
    for step in range(INTERVAL):
        steps = first_steps + step
        lanes = np.flatnonzero(steps < lengths[episodes])
        at = episodes[lanes], steps[lanes]
        result = physics.step(actions[before[at[0]] + at[1]], lanes)
        rewards[at], terminated[at] = result.rewards, result.terminated
    return rewards, terminated


@contextlib.contextmanager
def _no_warnings_on_disk() -> Iterator[None]:
    """MuJoCo writes a warning of each bad state to a file in the working folder; a trace must not make us write."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
