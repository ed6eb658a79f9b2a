"""The evaluation protocol: one policy, some dynamics, a fixed number of episodes in each, all at the same time.

What is here: `evaluate` and the reset seeds it takes; `returns_in`, the same in bodies of one's own. Called by users,
training and the demo. It must not know agents: a policy is whatever has the methods of `policy.Policy`.
"""

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import gymnasium
import gymnasium.utils.seeding
import mujoco
import numpy as np
import rich.console
import rich.progress
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.episodes import reset_seed
from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.evaluation.policy import Policy, RewardAware
from dynagen_bench.evaluation.result import Evaluation
from dynagen_bench.evaluation.traces import Recorder, Traces, physics_digest

EPISODES: Final = 10
"""Episodes in each dynamics (paper, section 5.1)."""

SEED: Final = 0
"""Seed of the official evaluation: every submission starts from the same states."""


@functools.cache
def action_space(robot: str) -> gymnasium.spaces.Box:
    """The action space of a robot, (A,) float32; raises ValueError for an unknown robot."""
    with gymnasium.make(ids.v0_env_id(robot)) as environment:
        space = environment.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    return space


def reset_seeds(
    robot: str, split: str, indices: Sequence[int], episodes: int = EPISODES, seed: int = SEED
) -> NDArray[np.int64]:
    """Reset seeds (dynamics, episodes), whole numbers of 31 bits; each a function of its own names and `seed` alone.

    Raises:
        ValueError: an unknown robot, split or index, no episode, or a seed that is no whole number from 0 on.
    """
    count = ids.check_count("episodes", episodes)
    start = ids.check_count("seed", seed, least=0)  # of None NumPy would make another seed each time
    names = [ids.make_id(robot, split, index) for index in indices]
    seeds = [[reset_seed(name, episode, seed=start) for episode in range(count)] for name in names]
    return np.array(seeds, dtype=np.int64).reshape(len(names), count)


def evaluate(
    policy: Policy,
    robot: str,
    split: str = "test",
    *,
    indices: Sequence[int] | None = None,
    episodes: int = EPISODES,
    seed: int = SEED,
    traces: bool = True,
    progress: bool = False,
) -> Evaluation:
    """Let a policy act in dynamics it is not told, and measure its returns.

    Every (dynamics, episode) is one lane of one batch, N = dynamics × episodes, and runs until it terminates or reaches
    the horizon; a finished lane is not stepped any more. Actions are taken as float32, the environments' action type,
    and clipped to the actuators' range: an episode has the return that a loop over `gymnasium.make` gives for its seed,
    also where a step is unstable, which ends it with reward 0.

    Args:
        policy: see `Policy`; asked with `deterministic=True`. If it has a method `observe` it is told its rewards, see
            `RewardAware`.
        robot: one of `ids.ROBOTS`.
        split: `test` for the official scores; `train` and `nominal` for one's own questions.
        indices: the dynamics of the split; None takes all of them.
        episodes: episodes in each dynamics.
        seed: the start states are a function of it; the official scores are those of the default.
        traces: keep what every episode did, from which the leaderboard replays it; at most 22 kB an episode.
        progress: show a progress bar on the error stream.

    Raises:
        TypeError: the policy has no `predict`, or one that cannot be called as `Policy.predict` is.
        ValueError: an unknown robot, split or index, no episode, a seed that is no whole number from 0 on, an answer
            that is not (actions, state), or actions of a wrong shape or not finite.
    """
    _check_policy(policy)
    chosen = tuple(name.index for name in ids.choose_ids(robot, split, indices))
    seeds = reset_seeds(robot, split, chosen, episodes, seed)
    drawn = [load_dynamics(robot, split, index) for index in chosen]
    told = f"evaluating in {robot} {split}" if progress else None
    returns, lengths, kept = _episodes(policy, robot, drawn, seeds, traces, told)
    return Evaluation(robot, split, chosen, returns, lengths, seeds, mujoco.__version__, physics_digest(robot), kept)


def returns_in(
    policy: Policy,
    robot: str,
    dynamics: Sequence[Mapping[str, Any]],
    *,
    episodes: int = EPISODES,
    seed: int = SEED,
    progress: bool = False,
) -> NDArray[np.float64]:
    """Let a policy act in bodies of one's own; returns (len(dynamics), episodes), undiscounted.

    As `evaluate`, but for the start states: they are those of `split="nominal"` in every body, so that what differs
    between two rows is the body alone. No score follows from them: its scale is that of the test bodies.

    Args:
        policy: see `evaluate`.
        robot: one of `ids.ROBOTS`.
        dynamics: factors of each body as `gymnasium.make(..., dynamics=)` takes them; `{}` is the nominal one.
        episodes: in each body.
        seed: the start states are a function of it.
        progress: show a progress bar on the error stream.

    Raises:
        TypeError, ValueError: as `evaluate`; no list of bodies, or an empty one; an unknown parameter or element.
    """
    _check_policy(policy)
    if not isinstance(dynamics, Sequence) or not dynamics:
        raise ValueError(f'dynamics is {dynamics!r}: give a list of bodies, as [{{"body_mass": {{"torso": 1.5}}}}]')
    seeds = np.repeat(reset_seeds(robot, "nominal", [0], episodes, seed), len(dynamics), axis=0)
    drawn = [Dynamics.from_json(factors) for factors in dynamics]
    told = f"evaluating in {len(drawn)} bodies of {robot}" if progress else None
    return _episodes(policy, robot, drawn, seeds, False, told)[0]


def _episodes(
    policy: Policy, robot: str, drawn: Sequence[Dynamics], seeds: NDArray[np.int64], traces: bool, told: str | None
) -> tuple[NDArray[np.float64], NDArray[np.int64], Traces | None]:
    """Run the episodes of seeds (M, E), a row a body: returns and lengths (M, E), and traces if they are wanted."""
    physics = BatchPhysics(robot, [dynamics for dynamics in drawn for _ in range(seeds.shape[1])])
    with rich.progress.Progress(console=rich.console.Console(stderr=True), disable=told is None) as bar:
        task = bar.add_task(told or "", total=HORIZON)
        observations = physics.start(np.arange(len(physics)), reset_generators(seeds))
        recorder = Recorder(physics.states, len(physics.action_limit)) if traces else None
        returns, lengths = _run_lanes(policy, physics, observations, recorder, lambda: bar.advance(task))
        bar.update(task, completed=HORIZON)
    kept = None if recorder is None else recorder.traces(lengths)
    return returns.reshape(seeds.shape), lengths.reshape(seeds.shape), kept


def reset_generators(seeds: NDArray[np.int64]) -> list[np.random.Generator]:
    """The generators that `env.reset(seed=...)` makes of seeds of any shape: a lane starts in the same state."""
    return [gymnasium.utils.seeding.np_random(int(seed))[0] for seed in seeds.flat]


def _run_lanes(
    policy: Policy,
    physics: BatchPhysics,
    observations: NDArray[np.float64],
    recorder: Recorder | None,
    advance: Callable[[], None],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Run the episode that has started in each lane; gives their returns (N,) float64 and lengths (N,) int64."""
    lanes = len(physics)
    shape = (lanes, *action_space(physics.robot).shape)
    returns, lengths = np.zeros(lanes), np.zeros(lanes, dtype=np.int64)
    running = np.arange(lanes)
    state, starts = None, np.ones(lanes, dtype=np.bool_)
    for step in range(HORIZON):
        # a copy, because a policy may keep or change what it is given
        answer = policy.predict(observations.copy(), state=state, episode_start=starts.copy(), deterministic=True)
        actions, state = _parts(answer, step)
        taken = _checked_actions(actions, shape, step)[running]
        result = physics.step(taken, running)
        if recorder is not None:
            recorder.add(step, running, taken, result.states, result.terminated)
        observations[running] = result.observations
        rewards = np.zeros(lanes)
        rewards[running] = result.rewards
        returns += rewards
        lengths[running] += 1
        if isinstance(policy, RewardAware):
            policy.observe(rewards)
        starts[:] = False
        advance()
        running = running[~result.terminated]
        if len(running) == 0:
            break
    return returns, lengths


def _check_policy(policy: Policy) -> None:
    """Raise TypeError, in one line, where there is no `predict`, or it takes other arguments than it is given."""
    if not isinstance(policy, Policy):
        raise TypeError(
            f"{type(policy).__name__} has no method predict(observation, ...): see dynagen_bench.evaluation.Policy"
        )
    try:
        signature = inspect.signature(policy.predict)
    except ValueError:  # it is not written in Python, and does not tell
        return
    try:
        signature.bind(None, state=None, episode_start=None, deterministic=True)
    except TypeError as error:
        raise TypeError(
            f"{type(policy).__name__}.predict{signature} cannot be called as predict(observation, state=..., "
            f"episode_start=..., deterministic=True) ({error}): see dynagen_bench.evaluation.Policy"
        ) from None


def _parts(answer: Any, step: int) -> tuple[Any, Any]:
    """Actions and state of a policy's answer, or one line that says what it gave instead."""
    if isinstance(answer, tuple | list) and len(answer) == 2:
        return answer[0], answer[1]
    form = f"{len(answer)} values" if isinstance(answer, tuple | list) else f"one {type(answer).__name__}"
    raise ValueError(
        f"step {step}: predict gave {form}: it must return two, (actions, state), state None if it has none"
    )


def _checked_actions(actions: Any, shape: tuple[int, ...], step: int) -> NDArray[np.float32]:
    """The policy's actions (N, A) as float32, or one line that says what is wrong with them."""
    try:
        given = np.asarray(actions)
    except (ValueError, TypeError, RuntimeError) as error:  # rows of different lengths; a tensor with a gradient
        raise ValueError(
            f"step {step}: the policy's actions are no array ({str(error).splitlines()[0]}), it must give numbers of "
            f"shape {shape}"
        ) from error
    if given.shape != shape or given.dtype.kind not in "fiu":
        raise ValueError(
            f"step {step}: the policy gave actions of shape {given.shape} and type {given.dtype}, "
            f"it must give numbers of shape {shape}"
        )
    with np.errstate(over="ignore"):  # a number too large for float32 becomes infinite and is refused below
        taken = given.astype(np.float32)
    if not np.isfinite(taken).all():
        row = int(np.flatnonzero(~np.isfinite(taken).all(axis=1))[0])
        raise ValueError(f"step {step}: the policy's action in row {row} is not finite: {given[row]}")
    return taken
