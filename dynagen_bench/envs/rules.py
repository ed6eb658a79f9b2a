"""Observation, reward and termination as functions of physics states, for one state or many.

What is here: `Rules` (the numbers of one robot) and the functions that read them. Called by the single environment
with a state (X,), qpos and then qvel, and by the batch with N of them, (N, X): both use the same lines. Below `...` is
either nothing or N. It must not know MuJoCo, Gymnasium, dynamics or episodes.
"""

import dataclasses
import functools
import math
import numbers
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = NDArray[np.floating[Any]] | np.floating[Any]
Flags = NDArray[np.bool_] | np.bool_
Healthy = Callable[["Rules", Array], Flags]


def always_healthy(rules: "Rules", states: Array) -> Flags:
    """Of a robot without a condition of health: every state is healthy."""
    return np.ones(len(states), dtype=np.bool_) if states.ndim > 1 else np.bool_(True)


def upright_healthy(rules: "Rules", states: Array) -> Flags:
    """Planar robots: height, pitch and all else strictly inside their ranges (Gymnasium Hopper-v5, Walker2d-v5)."""
    low, high = rules.upright_range(states.shape[-1])
    inside: Flags = ((low < states) & (states < high))[..., 1:].all(axis=-1)
    return inside


def height_healthy(rules: "Rules", states: Array) -> Flags:
    """Robots with a free root: finite, and the height inside its range, ends included (Gymnasium Ant-v5)."""
    height = states.T[2]
    inside: Flags = np.isfinite(states).all(axis=-1)
    inside &= (rules.healthy_z_range[0] <= height) & (height <= rules.healthy_z_range[1])
    return inside


@dataclasses.dataclass(frozen=True)
class Rules:
    """The numbers of one robot's task; fields that Gymnasium's v5 robot has too keep its name and meaning.

    Raises:
        ValueError: a flag is none, a number is not finite, or a range is none or empty.
    """

    healthy: Healthy = always_healthy
    """Which states are healthy: called as `rules.healthy(rules, states)`."""
    forward_reward_weight: float = 1.0
    """Reward for a metre a second along x."""
    ctrl_cost_weight: float = 1e-3
    """Cost of the squared norm of the control that reaches the actuators, ‖a‖²."""
    healthy_reward: float = 1.0
    """Reward of a step that ends healthy."""
    contact_cost_weight: float = 0.0
    """Cost of the squared norm of the clipped contact forces and torques."""
    contact_force_range: tuple[float, float] = (-1.0, 1.0)
    """Range to which contact forces are clipped, N and N m."""
    terminate_when_unhealthy: bool = True
    """The episode ends at a state that is not healthy."""
    healthy_state_range: tuple[float, float] = (-math.inf, math.inf)
    """Healthy values of every element of (qpos[2:], qvel), m, rad, m/s and rad/s; of planar robots."""
    healthy_z_range: tuple[float, float] = (-math.inf, math.inf)
    """Healthy heights of the root, m."""
    healthy_angle_range: tuple[float, float] = (-math.inf, math.inf)
    """Healthy pitch of the root, rad; of planar robots."""
    exclude_current_positions_from_observation: bool = True
    """The position along the ground is not observed."""
    hidden_positions: int = 1
    """How many first elements of qpos are the position along the ground."""
    velocity_limit: float = math.inf
    """Observed velocities are clipped to ± this, m/s and rad/s."""
    reset_noise_scale: float = 5e-3
    """An episode starts at the reference pose moved by Uniform(−scale, scale), m and rad, an element."""
    normal_velocity_noise: bool = False
    """The first velocities are scale · Normal(0, 1) and not Uniform(−scale, scale), m/s and rad/s."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, default = getattr(self, field.name), field.default
            if isinstance(default, bool):
                fits, wanted = isinstance(value, bool | np.bool_), "True or False"
            elif isinstance(default, tuple):
                fits, wanted = _is_range(value), "two numbers, the lower one first, as (0.7, inf)"
            elif field.name == "velocity_limit":
                fits, wanted = _is_number(value) and value > 0, "a number above 0, inf for no limit"
            elif field.name == "reset_noise_scale":
                fits, wanted = _is_number(value) and 0 <= value < math.inf, "a finite number from 0 on"
            else:
                fits, wanted = callable(default) or (_is_number(value) and math.isfinite(value)), "a finite number"
            if not fits:
                raise ValueError(f"{field.name} is {value!r}: give {wanted}")

    def upright_range(self, size: int) -> tuple[Array, Array]:
        """Lowest and highest healthy state of a planar robot, two arrays (X,), X = `size`; made once, then kept.

        Their first element, the position along the ground, has no meaning: nothing is asked of it.
        """
        if size not in self._upright_ranges:
            low, high = (np.full(size, limit) for limit in self.healthy_state_range)
            low[1], high[1] = self.healthy_z_range
            # two ranges hold the pitch: the inner end of each counts
            low[2] = max(low[2], self.healthy_angle_range[0])
            high[2] = min(high[2], self.healthy_angle_range[1])
            self._upright_ranges[size] = low, high
        return self._upright_ranges[size]

    @functools.cached_property
    def _upright_ranges(self) -> dict[int, tuple[Array, Array]]:
        return {}


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, numbers.Real) and not math.isnan(value)


def _is_range(value: Any) -> bool:
    """Two numbers in order, in a tuple, or in a list, which it is after JSON."""
    return isinstance(value, tuple | list) and len(value) == 2 and all(map(_is_number, value)) and value[0] < value[1]


RANGES: Final = ("healthy_state_range", "healthy_z_range", "healthy_angle_range")
"""Fields that say what is healthy."""

_READ: Final[Mapping[Healthy, tuple[str, ...]]] = {
    always_healthy: (),
    upright_healthy: RANGES,
    height_healthy: ("healthy_z_range",),
}
"""Which of them each kind of healthiness reads."""


def keyword_fields(rules: Rules) -> list[str]:
    """Names of the fields that a keyword argument sets in a robot of these rules: those that would act.

    Not `healthy`, which is a function; not `hidden_positions`, a fact of the robot's qpos that no task changes; not the
    ranges that its healthiness does not read, nor what becomes of the unhealthy where there are none. (Healthiness that
    is not of this file is taken to read all.)
    """
    left_out = {"healthy", "hidden_positions", *RANGES}.difference(_READ.get(rules.healthy, RANGES))
    if rules.healthy is always_healthy:
        left_out.add("terminate_when_unhealthy")
    return [field.name for field in dataclasses.fields(rules) if field.name not in left_out]


class Reward(NamedTuple):
    """Terms of a reward, each of the batch's shape; `ctrl` and `contact` are costs, not above 0."""

    forward: Values
    survive: Values
    ctrl: Values
    contact: Values
    """One 0 for all where contact costs nothing."""

    @property
    def total(self) -> Values:
        """The reward, (forward + survive) + (ctrl + contact); added in another order it would have other last bits."""
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


def observe(rules: Rules, states: Array, positions: int) -> Array:
    """Observations (..., S) of states (..., X), of which the first `positions` are qpos; a copy.

    Positions but the first ones, then velocities.
    """
    hidden = rules.hidden_positions if rules.exclude_current_positions_from_observation else 0
    observations = states[..., hidden:].copy()
    if rules.velocity_limit != math.inf:
        velocities = observations[..., positions - hidden :]
        np.maximum(velocities, -rules.velocity_limit, out=velocities)
        np.minimum(velocities, rules.velocity_limit, out=velocities)
    return observations


def position_info(rules: Rules, states: Array, reference_qpos: Array) -> dict[str, Values]:
    """What `info` says of states (..., X): keys of Gymnasium's v5 robots, values (...), m.

    A planar robot has its place along the ground and its height above the reference pose; one with a free root has
    both coordinates and the distance from the origin.
    """
    elements = states.T
    x, second = elements[0], elements[1]  # the second is the height of a planar robot's root, y of a free one
    if rules.hidden_positions == 1:
        return {"x_position": x, "z_distance_from_origin": second - reference_qpos[1]}
    return {"x_position": x, "y_position": second, "distance_from_origin": np.sqrt(x * x + second * second)}


def velocity_info(rules: Rules, before: Array, after: Array, duration: float) -> dict[str, Values]:
    """What `info` says of steps of `duration` seconds between states (..., X): mean velocities (...), m/s."""
    velocities = {"x_velocity": (after.T[0] - before.T[0]) / duration}
    if rules.hidden_positions > 1:
        velocities["y_velocity"] = (after.T[1] - before.T[1]) / duration
    return velocities


def reward_info(terms: "Reward") -> dict[str, Values]:
    """What `info` says of a reward: its terms."""
    return {
        "reward_forward": terms.forward,
        "reward_ctrl": terms.ctrl,
        "reward_survive": terms.survive,
        "reward_contact": terms.contact,
    }


def reward(rules: Rules, velocity: Values, healthy: Flags, ctrl: Array, contact_forces: Array | None = None) -> Reward:
    """Reward of steps.

    Args:
        rules: the robot's numbers.
        velocity: (...), displacement of the root along x over the step's duration, m/s.
        healthy: (...), of the new states.
        ctrl: (..., A), the control that reached the actuators.
        contact_forces: (..., nbody, 6), N m and N at the new state (`cfrc_ext`); None where they cost nothing.
    """
    contact: Values = _NOTHING
    if contact_forces is not None:
        clipped = np.clip(contact_forces, *rules.contact_force_range)
        contact = -rules.contact_cost_weight * _sum_of_squares(clipped.reshape(*clipped.shape[:-2], -1))
    ctrl_cost = -rules.ctrl_cost_weight * _sum_of_squares(ctrl)
    return Reward(rules.forward_reward_weight * velocity, rules.healthy_reward * healthy, ctrl_cost, contact)


_NOTHING: Final = np.float64(0.0)


def _sum_of_squares(values: Array) -> Values:
    # einsum adds one row in the same order whatever the number of rows: a batch gives the bits of its members
    total: Values = np.einsum("...i,...i->...", values, values)
    return total
