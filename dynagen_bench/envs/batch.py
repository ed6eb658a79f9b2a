"""Many simulations of one robot, each with dynamics of its own, stepped together on a C thread pool.

What is here: `BatchPhysics`, the transition function of `single` for N states at once. Collection and evaluation call
it. It must not know episodes: who resets, and when, is its caller's.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from dynagen_bench.dynamics import Dynamics, apply_dynamics, compile_nominal
from dynagen_bench.envs.robots import ROBOT_CLASSES
from dynagen_bench.envs.rules import Array, initial_state, observe, reward
from dynagen_bench.envs.single import BAD_STATE_WARNINGS


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


class BatchPhysics:
    """N simulations of one robot; simulation i has the i-th dynamics.

    Gives the bits of N single environments, at any number of threads: the same rules on the same substeps.

    Attributes:
        qpos: (N, nq) float64, live: writing it sets the states.
        qvel: (N, nv) float64, live.
        action_limit: (A,) float64, the highest action; every robot's lowest is its negative.
    """

    def __init__(self, robot: str, dynamics: Sequence[Dynamics], threads: int = 0) -> None:
        """Compile one model a distinct dynamics. `threads` 0 takes all processors.

        Raises:
            ValueError: an unknown robot, no dynamics, or dynamics that name elements the robot does not have.
        """
        if not dynamics:
            raise ValueError("no dynamics given: a batch needs at least one")
        robot_class = ROBOT_CLASSES[robot]
        self.robot = robot
        self.rules = robot_class.default_rules
        self._touch = self.rules.contact_cost_weight > 0
        models: dict[int, mujoco.MjModel] = {}
        for drawn in dynamics:
            if id(drawn) not in models:
                models[id(drawn)] = compile_nominal(robot, contact_forces=self._touch)
                apply_dynamics(robot, models[id(drawn)], drawn)
        self._models = [models[id(drawn)] for drawn in dynamics]
        self._substeps = robot_class.substeps
        self._dt = self._models[0].opt.timestep * self._substeps
        self._low, self.action_limit = self._models[0].actuator_ctrlrange.T
        self._batch = Batch(self._models[0], nsim=len(dynamics), nthread=threads)
        self._batch.set_models(self._models)
        self.qpos: Array = self._batch.bind("qpos")
        self.qvel: Array = self._batch.bind("qvel")
        self._ctrl: Array = self._batch.bind("ctrl")
        self._warmstart: Array = self._batch.bind("qacc_warmstart")
        self._forces: Array | None = self._batch.bind("cfrc_ext") if self._touch else None

    def __len__(self) -> int:
        return int(self._batch.nsim)

    @property
    def warnings(self) -> NDArray[np.integer[Any]]:
        """(N, kinds): how often MuJoCo has warned of each kind of trouble since the batch was made."""
        counts: NDArray[np.integer[Any]] = self._batch.warning[:, :, 1]
        return counts

    def start(self, simulations: NDArray[np.integer[Any]], rngs: Sequence[np.random.Generator]) -> Array:
        """Put simulations (M,) at the start of an episode, each drawn from its own generator.

        Returns the observations, (M, S) float64: those of a single environment reset with the generator's seed.
        """
        reference, velocities = self._models[0].qpos0, self._models[0].nv
        for simulation, rng in zip(simulations, rngs, strict=True):
            self.qpos[simulation], self.qvel[simulation] = initial_state(self.rules, reference, velocities, rng)
        return observe(self.rules, self.qpos[simulations], self.qvel[simulations])

    def step(
        self, actions: NDArray[np.floating[Any]], simulations: NDArray[np.integer[Any]] | None = None
    ) -> Transition:
        """Advance simulations (M,), or all N, by one control step with actions (M, A).

        Raises:
            ValueError: actions of another shape, or not finite; no physics has run.
        """
        rows = np.arange(len(self)) if simulations is None else simulations
        ctrl = np.asarray(actions, dtype=np.float64)
        if ctrl.shape != (len(rows), self._ctrl.shape[1]):
            raise ValueError(f"actions have shape {ctrl.shape}: give {(len(rows), self._ctrl.shape[1])}")
        if not np.isfinite(ctrl).all():
            bad = int(np.flatnonzero(~np.isfinite(ctrl).all(axis=1))[0])
            raise ValueError(f"action {bad} is not finite: {ctrl[bad]}")
        ctrl = np.clip(ctrl, self._low, self.action_limit)
        before = self.qpos[rows], self.qvel[rows]
        unstable = self._advance(rows, ctrl)
        if unstable.any():
            self.qpos[rows[unstable]], self.qvel[rows[unstable]] = before[0][unstable], before[1][unstable]
        qpos, qvel = self.qpos[rows], self.qvel[rows]
        velocity = (qpos[:, 0] - before[0][:, 0]) / self._dt
        healthy = self.rules.healthy(self.rules, qpos, qvel)
        forces = None if self._forces is None else self._forces[rows]
        total = reward(self.rules, velocity, healthy, ctrl, forces).total
        ended = ~healthy if self.rules.terminate_when_unhealthy else np.zeros_like(healthy)
        observations = observe(self.rules, qpos, qvel)
        return Transition(observations, np.where(unstable, 0.0, total), ended | unstable, unstable)

    def _advance(self, rows: NDArray[np.integer[Any]], ctrl: Array) -> NDArray[np.bool_]:
        self._warmstart[rows] = 0.0
        self._ctrl[rows] = ctrl
        before = self.warnings[:, BAD_STATE_WARNINGS].sum(axis=1)
        stage = mujoco.mjtStage.mjSTAGE_ACC if self._touch else mujoco.mjtStage.mjSTAGE_NONE
        everyone = len(rows) == len(self)
        self._batch.step(ids=None if everyone else rows, nstep=self._substeps, stage=stage)
        after = self.warnings[:, BAD_STATE_WARNINGS].sum(axis=1)
        unstable: NDArray[np.bool_] = (after != before)[rows]
        return unstable
