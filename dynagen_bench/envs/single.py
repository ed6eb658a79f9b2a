"""One environment: Gymnasium's v5 robot on a model with drawn dynamics, stepped as one function of the state.

What is here: `RandomDynamics`, which goes in front of a v5 robot class, one file a robot. It must not know episodes'
horizon (Gymnasium's `TimeLimit` has it), data or agents.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import utils
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, apply_dynamics, compile_nominal, load_dynamics
from dynagen_bench.envs.rules import (
    Array,
    Rules,
    initial_state,
    keyword_fields,
    observe,
    position_info,
    reward,
    reward_info,
    velocity_info,
)
from dynagen_bench.envs.specs import PlainSpec

RENDER_KEYWORDS = (
    "render_mode",
    "width",
    "height",
    "camera_id",
    "camera_name",
    "default_camera_config",
    "max_geom",
    "visual_options",
)

BAD_STATE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""The warnings BADQPOS, BADQVEL, BADQACC; after one MuJoCo resets the simulation by itself, mid-episode."""


class RandomDynamics(MujocoEnv, utils.EzPickle):
    """The part that all robots share; a robot's class puts it before Gymnasium's.

    A step is a function of (dynamics, qpos, qvel, action) and of nothing else, bit for bit: the solver's warm start is
    cleared before it, and velocity and contact forces are taken at the new state. (Gymnasium's Ant and Humanoid take
    them from the last substep's start, one substep behind.)

    Attributes:
        robot: name of the robot, one of `ids.ROBOTS`.
        substeps: physics steps in a control step; Gymnasium's frame skip of that robot.
        default_rules: the task's numbers; keyword arguments override those that `keyword_fields` names.
        tendons: whether `info` has their lengths and velocities, as Gymnasium's class of the robot.
        base_keywords: what Gymnasium's class has to be told to give our observation.
    """

    robot: ClassVar[str]
    substeps: ClassVar[int]
    default_rules: ClassVar[Rules]
    tendons: ClassVar[bool] = False
    base_keywords: ClassVar[Mapping[str, Any]] = {}
    spec: EnvSpec | None = PlainSpec()  # type: ignore[assignment] # a descriptor of that type

    def __init__(
        self,
        split: str | None = None,
        index: int | None = None,
        dynamics: Mapping[str, Mapping[str, float]] | None = None,
        **kwargs: Any,
    ) -> None:
        """Make the environment.

        Args:
            split: `train`, `test` or `nominal`; `train` if neither it nor `dynamics` is given.
            index: number of the dynamics in its split; None draws one at every reset from the environment's generator.
            dynamics: a user's own factors as plain data, `{"body_mass": {"torso": 1.3}}`, instead of split and index.
            kwargs: fields of `Rules` that act in this robot, and Gymnasium's rendering arguments.

        Raises:
            ValueError: an unknown split, index or element, a keyword's value that is none, or `dynamics` beside `split`
                or `index`.
            TypeError: an unknown keyword, or one that would not act.
        """
        self.rules, base = keywords(type(self), kwargs)
        if dynamics is not None and (split is not None or index is not None):
            raise ValueError("give either dynamics= or split= and index=, not both")
        self._own = None if dynamics is None else Dynamics.from_json(dynamics)
        self._split = ids.check_split("train" if split is None else split)
        chosen = 0 if self._split == "nominal" and index is None else index
        self._index = None if chosen is None else ids.check_index(self._split, chosen)
        self.dynamics_index = -1

        hide = self.rules.exclude_current_positions_from_observation
        super().__init__(  # type: ignore[call-arg] # the next class is the robot's, which takes these
            frame_skip=self.substeps, exclude_current_positions_from_observation=hide, **self.base_keywords, **base
        )
        self._duration = float(self.dt)
        self._low, self._high = self.model.actuator_ctrlrange.T.copy()
        # live arrays, asked for once: asking MuJoCo's bindings costs as much as what is done with the answer
        self._qpos, self._qvel, self._forces = self.data.qpos, self.data.qvel, self.data.cfrc_ext
        self._ctrl, self._warmstart = self.data.ctrl, self.data.qacc_warmstart
        self._bad_states: NDArray[np.int32] = self.data.warning.number[BAD_STATE]
        # Gymnasium's class has stored its own arguments for pickling: ours replace them
        utils.EzPickle.__init__(self, split=split, index=index, dynamics=dynamics, **kwargs)

    def __getstate__(self) -> dict[str, Any]:
        """The arguments that made it, and the dynamics it has drawn; as of Gymnasium's, no state of the episode."""
        return super().__getstate__() | {"dynamics_index": self.dynamics_index}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make it again, with the dynamics that had been drawn."""
        super().__setstate__(state)
        if self._redraws and state["dynamics_index"] >= 0:
            self._apply_index(self.model, state["dynamics_index"])

    @property
    def dynamics(self) -> Dynamics:
        """The factors of the body it is now: no observation shows them, and an agent that reads them is privileged."""
        if self._own is not None:
            return self._own
        return Dynamics() if self.dynamics_index < 0 else load_dynamics(self.robot, self._split, self.dynamics_index)

    @property
    def _redraws(self) -> bool:
        """Whether each reset draws the dynamics."""
        return self._own is None and self._index is None

    def _initialize_simulation(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        # What Gymnasium derives (initial state, spaces, renderer) is made after this, from the changed model.
        # The framebuffer grows to the asked size, as in Gymnasium's method, which this one replaces.
        model = compile_nominal(self.robot)
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, self.width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, self.height)
        if self._own is not None:
            apply_dynamics(self.robot, model, self._own)
        elif self._index is not None:
            self._apply_index(model, self._index)
        return model, mujoco.MjData(model)

    def _apply_index(self, model: mujoco.MjModel, index: int) -> None:
        apply_dynamics(self.robot, model, load_dynamics(self.robot, self._split, index))
        self.dynamics_index = index

    def reset_model(self) -> Array:
        """Draw the dynamics where none is fixed, then the noisy initial state; returns the observation (S,)."""
        if self._redraws:
            self._apply_index(self.model, int(self.np_random.integers(ids.SPLIT_SIZES[self._split])))
        self.set_state(*initial_state(self.rules, self.init_qpos, self.model.nv, self.np_random))  # type: ignore[no-untyped-call]
        return self._get_obs()

    def _get_obs(self) -> Array:
        return observe(self.rules, self._state(), len(self._qpos))

    def _state(self) -> Array:
        """The physics state (X,): qpos, then qvel."""
        return np.concatenate((self._qpos, self._qvel))

    def _get_reset_info(self) -> dict[str, Any]:
        return self._info(self._state()) | {"dynamics_index": self.dynamics_index}

    def _info(self, state: Array) -> dict[str, Any]:
        """What `info` says of a state, at reset and after every step."""
        info: dict[str, Any] = position_info(self.rules, state, self.init_qpos)
        if self.tendons:
            info["tendon_length"] = self.data.ten_length.copy()
            info["tendon_velocity"] = self.data.ten_velocity.copy()
        return info

    def step(  # type: ignore[override] # Gymnasium declares numpy floats in info, and puts arrays there itself
        self, action: NDArray[np.floating[Any]]
    ) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance one control step.

        Args:
            action: (A,) in the action space; what lies outside it is clipped, as the actuators would.

        Returns:
            observation (S,) float64, reward, terminated, False, info. After an unstable step (MuJoCo's bad-state
            warnings) the episode ends where it was: the old state, reward 0, terminated, `info["unstable"]` True.

        Raises:
            ValueError: the action has another shape, or a value in it is not finite; no physics has run.
        """
        before = self._state()
        ctrl = self._control(action)
        stable = self._advance(ctrl)
        if not stable:
            self.set_state(*np.split(before, [self.model.nq]))  # type: ignore[no-untyped-call]
        state = self._state()
        healthy = self.rules.healthy(self.rules, state)
        velocities = velocity_info(self.rules, before, state, self._duration)
        forces = self._forces if self.rules.contact_cost_weight else None
        terms = reward(self.rules, velocities["x_velocity"], healthy, ctrl, forces)
        terminated = not stable or (self.rules.terminate_when_unhealthy and not healthy)
        info = self._info(state) | velocities | reward_info(terms)
        if not stable:
            info["unstable"] = True
        if self.render_mode == "human":
            self.render()
        observation = observe(self.rules, state, len(self._qpos))
        return observation, float(terms.total) if stable else 0.0, bool(terminated), False, info

    def render(self) -> Any:
        """A frame in the mode that the environment was made with, as Gymnasium's.

        Raises:
            RuntimeError: no GL library draws here; the message says how to choose one.
        """
        try:
            return super().render()  # type: ignore[no-untyped-call]
        except mujoco.FatalError as error:
            raise RuntimeError(
                f"no frame can be drawn ({error}): where there is no display, set MUJOCO_GL to egl or osmesa before "
                "Python starts"
            ) from error

    @property
    def is_healthy(self) -> bool:
        """Whether the present state is healthy by our rules, which `step` uses, as do the properties below."""
        return bool(self.rules.healthy(self.rules, self._state()))

    @property
    def healthy_reward(self) -> float:
        """The term of the reward for the present state."""
        return self.rules.healthy_reward * self.is_healthy

    def control_cost(self, action: NDArray[np.floating[Any]]) -> float:
        """What an action (A,) costs, clipped as `step` does; raises ValueError as it does."""
        return -float(reward(self.rules, np.float64(0.0), np.bool_(False), self._control(action)).ctrl)

    @property
    def contact_cost(self) -> float:
        """What the contact forces of the last step cost."""
        forces = self._forces if self.rules.contact_cost_weight else None
        return -float(reward(self.rules, np.float64(0.0), np.bool_(False), np.zeros_like(self._low), forces).contact)

    def _control(self, action: NDArray[np.floating[Any]]) -> Array:
        ctrl = np.asarray(action, dtype=np.float64)
        if ctrl.shape != self._low.shape:
            raise ValueError(f"action has shape {ctrl.shape}: {self.robot} takes {self._low.shape}")
        # the sum of finite numbers is finite, but for absurd ones, and cheaper to look at than an array of flags
        if not math.isfinite(sum(ctrl.tolist())) and not np.isfinite(ctrl).all():
            raise ValueError(f"action {ctrl} is not finite: give numbers from {self.robot}'s action space")
        clipped: Array = np.minimum(np.maximum(ctrl, self._low), self._high)
        return clipped

    def _advance(self, ctrl: Array) -> bool:
        """Run the substeps; True if MuJoCo reported no bad state."""
        self._warmstart[:] = 0.0
        self._ctrl[:] = ctrl
        if any(self._bad_states.tolist()):
            self._bad_states[:] = 0
        mujoco.mj_step(self.model, self.data, self.frame_skip)
        if self.rules.contact_cost_weight:
            mujoco.mj_forward(self.model, self.data)
            mujoco.mj_rnePostConstraint(self.model, self.data)
        return not any(self._bad_states.tolist())


def keywords(robot_class: type[RandomDynamics], given: Mapping[str, Any]) -> tuple[Rules, dict[str, Any]]:
    """The rules of a robot with what is given of them, and the rendering keywords among `given`.

    Raises:
        TypeError: an unknown keyword, or one that would not act in this robot.
        ValueError: the value of one is of another kind, or makes no sense.
    """
    rule_names = keyword_fields(robot_class.default_rules)
    unknown = sorted(set(given) - set(rule_names) - set(RENDER_KEYWORDS))
    if unknown:
        allowed = ", ".join(["split", "index", "dynamics", *RENDER_KEYWORDS, *rule_names])
        raise TypeError(f"{robot_class.robot} has no keyword {unknown[0]!r}: choose from {allowed}")
    rules = dataclasses.replace(robot_class.default_rules, **{k: given[k] for k in rule_names if k in given})
    return rules, {key: given[key] for key in RENDER_KEYWORDS if key in given}
