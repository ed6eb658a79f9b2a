"""N environments of one robot as Gymnasium's `VectorEnv`, stepped together on `mujoco.batch`.

What is here: episodes for `BatchPhysics`: who resets and when, seeds, truncation, infos, frames. `gymnasium.make_vec`
calls it, by the names at the end of this file. It must not know physics or rewards, nor data or agents.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, apply_dynamics, load_dynamics
from dynagen_bench.envs.batch import BatchPhysics, Transition, checked_actions
from dynagen_bench.envs.robots import ROBOT_CLASSES
from dynagen_bench.envs.rules import Array, position_info, reward_info
from dynagen_bench.envs.specs import PlainSpec

HORIZON: Final = 200
"""Steps after which an episode is truncated (paper, section 5.1)."""

SPREAD: Final = "spread"
"""Value of `index`: sub-environment i runs dynamics i mod (size of the split)."""

NO_LIMIT: Final = -1
"""Value of `max_episode_steps`, as of `gymnasium.make`."""

Infos = dict[str, Any]

_NONE: Final[NDArray[np.intp]] = np.array([], dtype=np.intp)


class RandomDynamicsVector(VectorEnv[Array, NDArray[np.floating[Any]], NDArray[Any]]):
    """N sub-environments of one robot, each with dynamics of its own; no process, no copy of an environment.

    Every sub-environment gives the bits of the single environment with its seed: observations (N, S) float64, rewards
    (N,) float64, terminations and truncations (N,) bool, and infos as `gymnasium.vector.SyncVectorEnv` batches them.
    A step that MuJoCo reports as unstable ends the episode of that sub-environment alone, with reward 0 and
    `infos["unstable"]`.

    Attributes:
        dynamics_indices: (N,) int64, index of each sub-environment's dynamics in the split; -1 for a user's own, and
            where none is drawn yet.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012, Gymnasium's declaration
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": ["rgb_array", "depth_array", "rgbd_tuple"],
    }
    spec: EnvSpec | None = PlainSpec()  # type: ignore[assignment] # a descriptor of that type

    def __init__(
        self,
        robot: str,
        num_envs: int = 1,
        split: str | None = None,
        index: int | str | None = SPREAD,
        indices: Sequence[int] | None = None,
        dynamics: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        """Make the sub-environments.

        Args:
            robot: one of `ids.ROBOTS`.
            num_envs: N.
            split: `train`, `test` or `nominal`; `train` if nothing is given.
            index: `spread` gives sub-environment i the dynamics i mod (size of the split); a number gives all of them
                that one; None draws one at every reset, from the sub-environment's own generator, as the single
                environment does.
            indices: sub-environment i runs dynamics `indices[i mod len(indices)]` of the split.
            dynamics: a user's own, instead of split, index and indices: factors as plain data for all, or a list of
                such, sub-environment i taking the i-th modulo the list's length.
            max_episode_steps: steps after which an episode is truncated; None for the benchmark's 200, -1 for no limit,
                as of `gymnasium.make`.
            autoreset_mode: `NextStep`, `SameStep` or `Disabled`, or Gymnasium's `AutoresetMode`.
            threads: physics threads, 0 for the processors it may use; the bits are the same at any number.
            render_mode: `rgb_array`, `depth_array` or `rgbd_tuple`.
            kwargs: as for the single environment: fields of `Rules` that act in this robot, and Gymnasium's
                rendering arguments.

        Raises:
            ValueError: an unknown robot, split, index, mode or element; fewer than one sub-environment; more indices or
                dynamics than sub-environments; `dynamics` beside a choice from the benchmark's own; a number of steps
                or threads that is none.
            TypeError: an unknown keyword, or one that would not act.
        """
        ids.check_robot(robot)
        self.num_envs = num_envs = ids.check_count("num_envs", num_envs)
        steps = ids.whole_number(HORIZON if max_episode_steps is None else max_episode_steps)
        if steps is None or (steps < 1 and steps != NO_LIMIT):
            raise ValueError(
                f"max_episode_steps is {max_episode_steps!r}: give a whole number from 1 on, {NO_LIMIT} for no limit, "
                "or None"
            )
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode is {render_mode!r}: choose from {', '.join(self.metadata['render_modes'])}")
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *modes):
            raise ValueError(f"autoreset_mode is {autoreset_mode!r}: choose from {', '.join(modes)}")
        mode = AutoresetMode(autoreset_mode)
        own = _as_list(dynamics)
        self._choice = _choose(num_envs, split, index, indices, own)
        self._redraw = own is None and indices is None and index is None
        split = "train" if split is None else split
        if own is None:
            self._pool = [load_dynamics(robot, split, i) for i in range(ids.SPLIT_SIZES[split])]
        else:
            self._pool = [Dynamics.from_json(factors) for factors in own]
        self.dynamics_indices = np.full(num_envs, -1) if own is not None or self._redraw else self._choice.copy()

        # one single environment: it checks the keywords, has the spaces, and draws any state that is put into it
        self._single = ROBOT_CLASSES[robot](split="nominal", render_mode=render_mode, **kwargs)
        drawn = [self._pool[i] for i in self._choice]
        self.physics = BatchPhysics(robot, drawn, threads, self._single.rules)
        self._tendons = [self.physics.bind(f"ten_{x}") for x in ("length", "velocity")] if self._single.tendons else []
        self.metadata = {
            **self.metadata,
            "autoreset_mode": mode,
            "render_fps": self._single.metadata["render_fps"],
        }
        self.render_mode = render_mode
        self.single_observation_space = self._single.observation_space
        self.single_action_space = self._single.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._max_steps = math.inf if steps == NO_LIMIT else steps
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._ended = np.ones(num_envs, dtype=np.bool_)
        self._some_ended = True
        self._observations = np.zeros(self.observation_space.shape or ())
        self._started = False

    @property
    def dynamics(self) -> list[Dynamics]:
        """The factors of each sub-environment's body, N of them, now; see the single environment's."""
        return [self._pool[i] for i in self._choice]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, Infos]:
        """Start an episode in every sub-environment, or in those that `options={"reset_mask": ...}` (N,) names.

        Args:
            seed: sub-environment i starts from seed + i, or from the i-th of a list; None goes on with its generator.
            options: `reset_mask`, (N,) bool, is read; nothing else.

        Raises:
            ValueError: a seed of another form, a list of another length, or a mask of another shape or type, or that
                names none.
            gymnasium.error.Error: a seed that is no whole number from 0 on; nothing has been reset.
        """
        first = ids.whole_number(seed)
        seeds = self._seeds(seed) if first is None else [first + i for i in range(self.num_envs)]
        if first is not None:
            super().reset(seed=first)
        rows = self._masked(options)
        new = [(i, seeding.np_random(seeds[i])[0]) for i in rows if self._rngs[i] is None or seeds[i] is not None]
        for i, rng in new:
            self._rngs[i] = rng
        self._started = True
        infos: Infos = {}
        self._start(rows, infos)
        self._some_ended = bool(self._ended.any())
        return self._observations.copy(), infos

    def _seeds(self, given: Any) -> list[int | None]:
        """The seed of each sub-environment of a list of them, or None for all."""
        if given is None:
            return [None] * self.num_envs
        if not isinstance(given, Sequence | np.ndarray):
            raise ValueError(f"seed is {given!r}: give a whole number, a list of {self.num_envs}, or None")
        if len(given) != self.num_envs:
            raise ValueError(f"{len(given)} seeds given: give {self.num_envs}, one per sub-environment, or one number")
        plain = [ids.whole_number(seed) for seed in given]
        # what is neither a whole number nor None is left for Gymnasium to refuse
        return [seed if number is None else number for seed, number in zip(given, plain, strict=True)]

    def _masked(self, options: Mapping[str, Any] | None) -> NDArray[np.intp]:
        if not options or "reset_mask" not in options:
            return np.arange(self.num_envs)
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"reset_mask has shape {mask.shape}, type {mask.dtype} and {np.count_nonzero(mask)} set: give "
                f"({self.num_envs},) bool with at least one set"
            )
        if not self._started and not mask.all():
            raise ValueError("the first reset starts every sub-environment: give no reset_mask")
        return np.flatnonzero(mask)

    def _start(self, rows: NDArray[np.intp], infos: Infos) -> None:
        """Begin episodes in sub-environments (M,): their observations, and into `infos` what is said of them."""
        rngs = [rng for rng in (self._rngs[i] for i in rows) if rng is not None]
        if self._redraw:
            drawn = [int(rng.integers(len(self._pool))) for rng in rngs]
            self.dynamics_indices[rows] = self._choice[rows] = drawn
            self.physics.assign(rows, [self._pool[i] for i in drawn])
        self._observations[rows] = self.physics.start(rows, rngs)
        self._steps[rows] = 0
        self._ended[rows] = False
        if self._tendons:
            self.physics.derive(rows)
        said = self._positions(rows, self.physics.states[rows]) | {"dynamics_index": self.dynamics_indices[rows]}
        self._tell(infos, rows, said)

    def step(
        self, actions: NDArray[np.floating[Any]]
    ) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Advance every sub-environment by one control step with actions (N, A).

        In mode `NextStep` a sub-environment that has ended is reset instead: its action is not used, its reward is 0.
        In mode `SameStep` one that ends is reset at once, its last observation and info are in `infos["final_obs"]`
        and `infos["final_info"]`.

        Raises:
            ValueError: actions of another shape, or not finite; no physics has run.
            gymnasium.error.ResetNeeded: before the first reset, and in mode `Disabled` after an end.
        """
        if not self._started:
            raise gymnasium.error.ResetNeeded("the sub-environments have not started: call reset() before step()")
        mode, rows = self.metadata["autoreset_mode"], None
        waiting = np.flatnonzero(self._ended) if self._some_ended else _NONE
        if self._some_ended and mode is AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded(
                f"sub-environments {waiting[:5].tolist()} have ended: reset them with options={{'reset_mask': ...}}"
            )
        if self._some_ended:  # else the physics checks the actions, all of which it gets
            actions = checked_actions(actions, self.action_space.shape or ())
            rows = np.flatnonzero(~self._ended)
        rewards = np.zeros(self.num_envs)
        terminations, truncations = (np.zeros(self.num_envs, dtype=np.bool_) for _ in range(2))
        infos: Infos = {}
        if rows is None or len(rows):
            where = _all_or(rows)
            result = self.physics.step(actions if rows is None else actions[rows], rows)
            rewards[where], terminations[where] = result.rewards, result.terminated
            self._steps[where] += 1
            truncations[where] = self._steps[where] >= self._max_steps
            self._observations[where] = result.observations
            self._tell_of_step(infos, rows, result)
        self._ended = terminations | truncations
        if len(waiting):
            self._start(waiting, infos)
        self._some_ended = bool(self._ended.any())
        if self._some_ended and mode is AutoresetMode.SAME_STEP:
            infos = self._restart(np.flatnonzero(self._ended), infos)
            self._some_ended = False
        return self._observations.copy(), rewards, terminations, truncations, infos

    def _tell_of_step(self, infos: Infos, rows: NDArray[np.intp] | None, result: Transition) -> None:
        """Put into `infos` what is said of a step of sub-environments (M,), or of all."""
        said = self._positions(rows, result.states) | result.velocities | reward_info(result.terms)
        if self._tendons:
            # MuJoCo has reset these; the old state stands, and may be one that the batch would reset again
            for row in np.flatnonzero(result.unstable):
                old = np.split(result.states[row], [self.physics.qpos.shape[1]])
                self._single.set_state(*old)  # type: ignore[no-untyped-call]
                data = self._single.data  # of another body: its tendons lie and move as those of any draw
                said["tendon_length"][row], said["tendon_velocity"][row] = data.ten_length, data.ten_velocity
        self._tell(infos, rows, said)
        if result.unstable.any():
            bad = np.arange(self.num_envs)[_all_or(rows)][result.unstable]
            self._tell(infos, bad, {"unstable": np.ones(len(bad), dtype=np.bool_)})

    def _positions(self, rows: NDArray[np.intp] | None, states: Array) -> Infos:
        said: Infos = dict(position_info(self._single.rules, states, self.physics.reference_qpos))
        if self._tendons:
            said["tendon_length"], said["tendon_velocity"] = (field[_all_or(rows)].copy() for field in self._tendons)
        return said

    def _tell(self, infos: Infos, rows: NDArray[np.intp] | None, said: Infos) -> None:
        """Put values (M, ...) of sub-environments (M,), or of all, into infos, with Gymnasium's masks `_key`."""
        if rows is None:
            masks = np.ones((len(said), self.num_envs), dtype=np.bool_)  # a row each: no two share an element
            for mask, (key, values) in zip(masks, said.items(), strict=True):
                infos[key], infos[f"_{key}"] = values if values.ndim else np.full(self.num_envs, values), mask
            return
        for key, values in said.items():
            if key not in infos:
                infos[key] = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
                infos[f"_{key}"] = np.zeros(self.num_envs, dtype=np.bool_)
            infos[key][rows], infos[f"_{key}"][rows] = values, True

    def _restart(self, rows: NDArray[np.intp], infos: Infos) -> Infos:
        """Move what is said of ended sub-environments (M,) to `final_info`, and begin their next episodes."""
        finals = np.full(self.num_envs, None, dtype=object)
        for i in rows:
            finals[i] = self._observations[i].copy()
        mask = self._ended.copy()
        final_info, rest = _divided(infos, mask)
        rest |= {"final_obs": finals, "_final_obs": mask, "final_info": final_info, "_final_info": mask.copy()}
        self._start(rows, rest)
        return rest

    def render(self) -> tuple[Any, ...] | None:
        """A frame of every sub-environment, or None without a render mode."""
        return None if self.render_mode is None else tuple(self.render_one(i) for i in range(self.num_envs))

    def render_one(self, number: int) -> Any:
        """A frame of one sub-environment, of its present state (the single environment's are one substep behind).

        Raises:
            ValueError: there is no such sub-environment.
        """
        if not 0 <= number < self.num_envs:
            raise ValueError(f"there is no sub-environment {number}: choose from 0 to {self.num_envs - 1}")
        # no camera sees a mass, but one that tracks follows the centre of all of them
        apply_dynamics(self._single.robot, self._single.model, self._pool[self._choice[number]])
        self._single.set_state(self.physics.qpos[number], self.physics.qvel[number])  # type: ignore[no-untyped-call]
        return self._single.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the renderer."""
        self._single.close()  # type: ignore[no-untyped-call]


def _all_or(rows: NDArray[np.intp] | None) -> Any:
    """What indexes sub-environments (M,), or all of them without a copy."""
    return slice(None) if rows is None else rows


def _divided(infos: Infos, mask: NDArray[np.bool_]) -> tuple[Infos, Infos]:
    """Infos of the sub-environments that a mask (N,) names, and of the others: what is not said is 0 and masked."""
    parts: tuple[Infos, Infos] = {}, {}
    for key in [key for key in infos if not key.startswith("_")]:
        for part, chosen in zip(parts, (mask, ~mask), strict=True):
            said = infos[f"_{key}"] & chosen
            if said.any():
                part[key] = np.where(said.reshape(-1, *[1] * (infos[key].ndim - 1)), infos[key], 0)
                part[key], part[f"_{key}"] = part[key].astype(infos[key].dtype), said
    return parts


def _as_list(dynamics: Any) -> Sequence[Mapping[str, Any]] | None:
    """A user's own dynamics one by one; what is neither a list nor one of them is left for `from_json` to refuse."""
    if dynamics is None or (isinstance(dynamics, Sequence) and not isinstance(dynamics, str)):
        return dynamics
    return [dynamics]


def _choose(
    num_envs: int,
    split: str | None,
    index: int | str | None,
    indices: Sequence[int] | None,
    dynamics: Sequence[Mapping[str, Any]] | None,
) -> NDArray[np.int64]:
    """For each sub-environment (N,) which dynamics of the pool it starts with; checks what the user asks for."""
    if dynamics is not None:
        if split is not None or index not in (SPREAD, None) or indices is not None:
            raise ValueError("give either dynamics= or split=, index= and indices=, not both")
        return _repeated("dynamics", range(len(dynamics)), num_envs)
    split = ids.check_split("train" if split is None else split)
    if indices is not None:
        if index != SPREAD:
            raise ValueError("give either index= or indices=, not both")
        return _repeated("indices", ids.check_indices(split, indices), num_envs)
    if isinstance(index, str):
        if index != SPREAD:
            raise ValueError(f"index is {index!r}: give a number, None, or {SPREAD!r}")
        return np.arange(num_envs) % ids.SPLIT_SIZES[split]
    return np.full(num_envs, 0 if index is None else ids.check_index(split, index))


def _repeated(what: str, numbers: Sequence[int], num_envs: int) -> NDArray[np.int64]:
    if not 1 <= len(numbers) <= num_envs:
        raise ValueError(f"{len(numbers)} {what} given for {num_envs} sub-environments: give 1 to {num_envs}")
    return np.resize(np.array(numbers, dtype=np.int64), num_envs)


ENTRY_POINTS: Final[dict[str, Callable[..., RandomDynamicsVector]]] = {
    robot: functools.partial(RandomDynamicsVector, robot) for robot in ROBOT_CLASSES
}


def __getattr__(robot: str) -> Callable[..., RandomDynamicsVector]:
    """`dynagen_bench.envs.vector:Hopper`: what an environment's specification names, which has to be text."""
    if robot in ENTRY_POINTS:
        return ENTRY_POINTS[robot]
    raise AttributeError(f"module {__name__!r} has no attribute {robot!r}")
