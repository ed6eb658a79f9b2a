"""Observation, reward and termination as functions of physics states, for one state or many.

What is here: `Rules` (the numbers of one robot) and the functions that read them. Called by the single environment; any
leading batch shape `...` goes through unchanged, so that N environments at once use the same lines. It must not know
MuJoCo, Gymnasium, dynamics or episodes.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Healthy = Callable[["Rules", Array, Array], NDArray[np.bool_]]


def always_healthy(rules: "Rules", qpos: Array, qvel: Array) -> NDArray[np.bool_]:
    """Healthiness of a robot that has none: True for each state."""
    return np.ones(qpos.shape[:-1], dtype=np.bool_)


def upright_healthy(rules: "Rules", qpos: Array, qvel: Array) -> NDArray[np.bool_]:
    """Planar robots: height, pitch and all states strictly inside their ranges (Gymnasium Hopper-v5, Walker2d-v5)."""
    low, high = rules.healthy_state_range
    inside: NDArray[np.bool_] = np.asarray(((low < qpos[..., 2:]) & (qpos[..., 2:] < high)).all(axis=-1))
    inside &= ((low < qvel) & (qvel < high)).all(axis=-1)
    height, pitch = qpos[..., 1], qpos[..., 2]
    inside &= (rules.healthy_z_range[0] < height) & (height < rules.healthy_z_range[1])
    inside &= (rules.healthy_angle_range[0] < pitch) & (pitch < rules.healthy_angle_range[1])
    return inside


def height_healthy(rules: "Rules", qpos: Array, qvel: Array) -> NDArray[np.bool_]:
    """Robots with a free root: finite, and the height inside its range, ends included (Gymnasium Ant-v5)."""
    inside: NDArray[np.bool_] = np.asarray(np.isfinite(qpos).all(axis=-1) & np.isfinite(qvel).all(axis=-1))
    height = qpos[..., 2]
    inside &= (rules.healthy_z_range[0] <= height) & (height <= rules.healthy_z_range[1])
    return inside


@dataclasses.dataclass(frozen=True)
class Rules:
    """The numbers of one robot's task; fields that Gymnasium's v5 robot has too keep its name and meaning."""

    healthy: Healthy = always_healthy
    """Which states are healthy: called as `rules.healthy(rules, qpos, qvel)`."""
    forward_reward_weight: float = 1.0
    """Reward for a metre a second along x."""
    ctrl_cost_weight: float = 1e-3
    """Cost of the squared norm of the control that reaches the actuators."""
    healthy_reward: float = 1.0
    """Reward of a step that ends healthy."""
    contact_cost_weight: float = 0.0
    """Cost of the squared norm of the clipped contact forces."""
    contact_force_range: tuple[float, float] = (-1.0, 1.0)
    """Range to which contact forces are clipped, N and N m."""
    terminate_when_unhealthy: bool = True
    healthy_state_range: tuple[float, float] = (-math.inf, math.inf)
    healthy_z_range: tuple[float, float] = (-math.inf, math.inf)
    """Healthy heights of the root, m."""
    healthy_angle_range: tuple[float, float] = (-math.inf, math.inf)
    """Healthy pitch of the root, rad."""
    exclude_current_positions_from_observation: bool = True
    hidden_positions: int = 1
    """How many first elements of qpos are the position along the ground."""
    velocity_limit: float = math.inf
    """Observed velocities are clipped to ± this, m/s and rad/s."""
    reset_noise_scale: float = 5e-3
    """An episode starts at the reference pose moved by Uniform(−scale, scale), m and rad, an element."""
    normal_velocity_noise: bool = False
    """The first velocities are scale · Normal(0, 1) and not Uniform(−scale, scale), m/s and rad/s."""


class Reward(NamedTuple):
    """Terms of a reward, each of the batch's shape; `total` is their sum in this order."""

    forward: Array
    survive: Array
    ctrl: Array
    contact: Array

    @property
    def total(self) -> Array:
        """The reward: forward + survive − control cost − contact cost."""
        return self.forward + self.survive + (self.ctrl + self.contact)


def initial_state(
    rules: Rules, reference_qpos: Array, velocities: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw the start of an episode, qpos (nq,) and qvel (nv,), as Gymnasium's `reset_model` does and in its order."""
    scale = rules.reset_noise_scale
    qpos = reference_qpos + rng.uniform(low=-scale, high=scale, size=reference_qpos.size)
    if rules.normal_velocity_noise:
        return qpos, scale * rng.standard_normal(velocities)
    return qpos, rng.uniform(low=-scale, high=scale, size=velocities)


def observe(rules: Rules, qpos: Array, qvel: Array) -> Array:
    """Observation (..., S) of states qpos (..., nq), qvel (..., nv): positions but the first ones, then velocities."""
    hidden = rules.hidden_positions if rules.exclude_current_positions_from_observation else 0
    velocity = np.clip(qvel, -rules.velocity_limit, rules.velocity_limit)
    return np.concatenate([qpos[..., hidden:], velocity], axis=-1)


def reward(
    rules: Rules, velocity: Array, healthy: NDArray[np.bool_], ctrl: Array, contact_forces: Array | None = None
) -> Reward:
    """Reward of steps.

    Args:
        rules: the robot's numbers.
        velocity: (...), displacement of the root along x over the step's duration, m/s.
        healthy: (...), of the new states.
        ctrl: (..., A), the control that reached the actuators.
        contact_forces: (..., nbody, 6), N m and N at the new state (`cfrc_ext`); None where they cost nothing.
    """
    contact = np.zeros_like(velocity)
    if contact_forces is not None:
        clipped = np.clip(contact_forces, *rules.contact_force_range)
        contact = -rules.contact_cost_weight * _sum_of_squares(clipped.reshape(*clipped.shape[:-2], -1))
    return Reward(
        forward=rules.forward_reward_weight * velocity,
        survive=rules.healthy_reward * healthy.astype(np.float64),
        ctrl=-rules.ctrl_cost_weight * _sum_of_squares(ctrl),
        contact=contact,
    )


def _sum_of_squares(values: Array) -> Array:
    # einsum adds one row in the same order whatever the number of rows: a batch gives the bits of its members
    total: Array = np.einsum("...i,...i->...", values, values)
    return total
