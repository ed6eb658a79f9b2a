"""Many simulations of one robot, each with dynamics of its own, stepped together on a C thread pool.

What is here: `BatchPhysics`, the transition function of `single` for N states at once. Collection and evaluation call
it. It must not know episodes: who resets, and when, is its caller's.
"""

import os
import weakref
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, apply_dynamics, compile_nominal
from dynagen_bench.envs.robots import ROBOT_CLASSES
from dynagen_bench.envs.rules import Array, Reward, Rules, Values, initial_state, observe, reward, velocity_info
from dynagen_bench.envs.single import BAD_STATE

THREADS_VARIABLE: Final = "DYNAGEN_THREADS"
"""Environment variable: what 0 physics threads means. A job of `dynagen_bench.jobs` has it at 1."""

_ALIVE: Final[weakref.WeakSet["BatchPhysics"]] = weakref.WeakSet()
_INHERITED: Final[list["BatchPhysics"]] = []


def _keep_inherited() -> None:
    """In a forked process: a pool's threads are not there, and the end of its batch would wait for them for ever."""
    _INHERITED.extend(_ALIVE)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_inherited)


class Transition(NamedTuple):
    """What a step of M simulations gives."""

    observations: Array
    """(M, S) float64, at the new states."""
    rewards: Array
    """(M,) float64."""
    terminated: NDArray[np.bool_]
    """(M,): the new state ends the episode."""
    unstable: NDArray[np.bool_]
    """(M,): MuJoCo reported a bad state; the old state stands, the reward is 0 and the episode is over."""
    states: Array
    """(M, X) float64, the new states: qpos, then qvel."""
    velocities: dict[str, Values]
    """`x_velocity`, and `y_velocity` where the root is free: (M,) float64, m/s."""
    terms: Reward
    """Terms of the rewards; of an unstable step they are those before its reward was set to 0."""


class BatchPhysics:
    """N simulations of one robot; simulation i has the i-th dynamics.

    Gives the bits of N single environments, at any number of threads: the same rules on the same substeps.

    Attributes:
        states: (N, X) float64, qpos and then qvel, live: writing it sets the states.
        qpos: (N, nq) float64, live, the first part of `states`.
        qvel: (N, nv) float64, live, the rest of it.
        reference_qpos: (nq,) float64, the robot's pose before the noise of a start.
        action_limit: (A,) float64, the highest action; every robot's lowest is its negative.
        threads: that it is stepped on, the caller's own among them.
    """

    def __init__(self, robot: str, dynamics: Sequence[Dynamics], threads: int = 0, rules: Rules | None = None) -> None:
        """Compile one model a distinct dynamics.

        Args:
            robot: one of `ids.ROBOTS`.
            dynamics: one per simulation; the same object for several of them is compiled once.
            threads: physics threads, 0 for as many as `DYNAGEN_THREADS` says, or as there are processors that this
                process may run on; the bits are the same at any number.
            rules: the task's numbers, the robot's own if None.

        Raises:
            ValueError: an unknown robot, no dynamics, dynamics that name elements the robot does not have, or a number
                of threads that is none, here or in `DYNAGEN_THREADS`.
        """
        if not dynamics:
            raise ValueError("no dynamics given: a batch needs at least one")
        self.threads = ids.check_count("threads", threads, least=0) or _allowed_threads()
        robot_class = ROBOT_CLASSES[ids.check_robot(robot)]
        self.robot = robot
        self.rules = robot_class.default_rules if rules is None else rules
        self._touch = self.rules.contact_cost_weight != 0
        self._compiled: dict[int, tuple[Dynamics, mujoco.MjModel]] = {}
        self._models = [self._model(drawn) for drawn in dynamics]
        model = self._models[0]
        self._substeps = robot_class.substeps
        self._stage = mujoco.mjtStage.mjSTAGE_ACC if self._touch else mujoco.mjtStage.mjSTAGE_NONE
        self._duration = float(model.opt.timestep * self._substeps)
        self._low, self.action_limit = model.actuator_ctrlrange.T.copy()
        self.reference_qpos: Array = model.qpos0.copy()
        self._batch = Batch(model, nsim=len(dynamics), nthread=self.threads)
        self._batch.set_models(self._models)
        # whose threads they are; the caller's own goes along
        self._process = None if self.threads == 1 else os.getpid()
        _ALIVE.add(self)
        # a row of the batch's state begins with the time, qpos and qvel: one copy takes a whole physics state
        self.states: Array = self._batch.state[:, 1 : 1 + model.nq + model.nv]
        self.qpos: Array = self._batch.bind("qpos")
        self.qvel: Array = self._batch.bind("qvel")
        self._ctrl: Array = self._batch.bind("ctrl")
        self._warmstart: Array = self._batch.bind("qacc_warmstart")
        self._forces: Array | None = self._batch.bind("cfrc_ext") if self._touch else None
        self._bad_states: NDArray[np.integer[Any]] = self._batch.warning[:, BAD_STATE, 1]  # live

    def __len__(self) -> int:
        return int(self._batch.nsim)

    def bind(self, field: str) -> Array:
        """A live, read-only (N, ...) array of a field that MuJoCo derives; a step leaves it one substep behind."""
        derived: Array = self._batch.bind(field)
        return derived

    def derive(self, simulations: NDArray[np.integer[Any]]) -> None:
        """Bring what is bound up to date with the states of simulations (M,); raises RuntimeError as `step` does."""
        self._check_process()
        self._batch.forward(simulations, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def assign(self, simulations: NDArray[np.integer[Any]], dynamics: Sequence[Dynamics]) -> None:
        """Give simulations (M,) other dynamics; their states stay."""
        for simulation, drawn in zip(simulations, dynamics, strict=True):
            self._models[simulation] = self._model(drawn)
        self._batch.set_models(self._models)

    def _model(self, dynamics: Dynamics) -> mujoco.MjModel:
        if id(dynamics) not in self._compiled:
            model = compile_nominal(self.robot, contact_forces=self._touch)
            apply_dynamics(self.robot, model, dynamics)
            self._compiled[id(dynamics)] = dynamics, model  # kept with the model: an id is of a living object
        return self._compiled[id(dynamics)][1]

    def start(self, simulations: NDArray[np.integer[Any]], rngs: Sequence[np.random.Generator]) -> Array:
        """Put simulations (M,) at the start of an episode, each drawn from its own generator.

        Returns the observations, (M, S) float64: those of a single environment reset with the generator's seed.
        """
        positions, velocities = len(self.reference_qpos), self.qvel.shape[1]
        for simulation, rng in zip(simulations, rngs, strict=True):
            qpos, qvel = initial_state(self.rules, self.reference_qpos, velocities, rng)
            self.qpos[simulation], self.qvel[simulation] = qpos, qvel
        return observe(self.rules, self.states[simulations], positions)

    def step(
        self, actions: NDArray[np.floating[Any]], simulations: NDArray[np.integer[Any]] | None = None
    ) -> Transition:
        """Advance simulations (M,), in ascending order, or all N, by one control step with actions (M, A).

        Raises:
            ValueError: actions of another shape, or not finite; no physics has run.
            RuntimeError: this is a fork of the process that made it, without its several threads.
        """
        self._check_process()
        # a slice copies a third as fast again as an array of all indices does, and most steps are of all
        rows: Any = slice(None) if simulations is None else simulations
        count = len(self) if simulations is None else len(simulations)
        ctrl = checked_actions(actions, (count, len(self._low)))
        ctrl = np.minimum(np.maximum(ctrl, self._low), self.action_limit)
        before = self.states[rows].copy()
        self._warmstart[rows] = 0.0
        self._ctrl[rows] = ctrl
        self._batch.step(ids=simulations, nstep=self._substeps, stage=self._stage)
        unstable = self._unstable(rows)
        if unstable is not None:
            restored = self.states[rows]
            restored[unstable] = before[unstable]
            self.states[rows] = restored
        states = self.states[rows].copy()
        healthy = np.asarray(self.rules.healthy(self.rules, states))
        velocities = velocity_info(self.rules, before, states, self._duration)
        forces = None if self._forces is None else self._forces[rows]
        terms = reward(self.rules, velocities["x_velocity"], healthy, ctrl, forces)
        rewards = np.asarray(terms.total, dtype=np.float64)
        terminated = ~healthy if self.rules.terminate_when_unhealthy else np.zeros_like(healthy)
        if unstable is None:
            unstable = np.zeros(count, dtype=np.bool_)
        else:
            rewards[unstable] = 0.0
            terminated |= unstable
        observations = observe(self.rules, states, len(self.reference_qpos))
        return Transition(observations, rewards, terminated, unstable, states, velocities, terms)

    def _check_process(self) -> None:
        if self._process not in (None, os.getpid()):
            raise RuntimeError(
                f"{self.robot}: these simulations were made before the process was forked, and their threads stayed "
                "behind: make them in the process that steps them, with threads=1, or start it by 'spawn'"
            )

    def _unstable(self, rows: Any) -> NDArray[np.bool_] | None:
        """Which of the simulations (M,) just stepped have had a bad state, or None for none.

        The counts are set back: MuJoCo begins them anew when it resets a simulation, so that they need not grow.
        """
        if not self._bad_states.any():
            return None
        unstable: NDArray[np.bool_] = np.asarray(self._bad_states.any(axis=1))[rows]
        self._bad_states[:] = 0
        return unstable


def _allowed_threads() -> int:
    """What `THREADS_VARIABLE` says, or the number of processors that this process may run on: MuJoCo's 0 is all."""
    if told := os.environ.get(THREADS_VARIABLE):
        return ids.check_count(THREADS_VARIABLE, int(told) if told.isdecimal() else told)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def checked_actions(actions: NDArray[np.floating[Any]], shape: tuple[int, ...]) -> Array:
    """The actions (M, A) as float64; raises ValueError if they have another shape, or one of them is not finite."""
    # in C order, whatever is given: einsum adds the elements of other orders in another order, to other last bits
    checked = np.asarray(actions, dtype=np.float64, order="C")
    if checked.shape != shape:
        raise ValueError(f"actions have shape {checked.shape}: give {shape}")
    if not np.isfinite(checked).all():
        bad = int(np.flatnonzero(~np.isfinite(checked).all(axis=1))[0])
        raise ValueError(f"action {bad} is not finite: {checked[bad]}")
    return checked
