"""Ant: four legs, in three dimensions."""

from typing import ClassVar

from gymnasium.envs.mujoco import ant_v5

from dynagen_bench.envs.rules import Rules, height_healthy
from dynagen_bench.envs.single import RandomDynamics


class Ant(RandomDynamics, ant_v5.AntEnv):
    """A torso on four legs of two links each: Gymnasium's Ant-v5 with drawn dynamics, contact forces not observed.

    A control step is 5 substeps of 0.01 s, 0.05 s; an episode has at most 200 of them.

    Actions, (8,) float32, torque as a share of the motor's 150 N m:

    | index | action | low | high | joint | unit |
    | --- | --- | --- | --- | --- | --- |
    | 0, 1 | torque on hip and ankle, back right | -1 | 1 | hip_4, ankle_4 | 150 N m |
    | 2, 3 | torque on hip and ankle, front left | -1 | 1 | hip_1, ankle_1 | 150 N m |
    | 4, 5 | torque on hip and ankle, front right | -1 | 1 | hip_2, ankle_2 | 150 N m |
    | 6, 7 | torque on hip and ankle, back left | -1 | 1 | hip_3, ankle_3 | 150 N m |

    Observations, (27,) float64:

    | index | observation | source | unit |
    | --- | --- | --- | --- |
    | 0 | height of the torso | qpos[2], root | m |
    | 1 to 4 | orientation of the torso, quaternion w, x, y, z | qpos[3:7], root | 1 |
    | 5 to 12 | angles of hip and ankle: front left, front right, back left, back right | qpos[7:15] | rad |
    | 13, 14, 15 | velocity of the torso along x, y, z | qvel[0:3] | m/s |
    | 16, 17, 18 | angular velocity of the torso, in its own frame | qvel[3:6] | rad/s |
    | 19 to 26 | angular velocities of the joints, in the order of their angles | qvel[6:14] | rad/s |

    Reward of a step: `v + 1 − 0.5‖a‖² − 0.0005‖clip(c, −1, 1)‖²`, with v the root's displacement along x over the
    step's duration (m/s), 1 only if the new state is healthy, a the action clipped to its range, and c the external
    forces and torques on the bodies at the new state (`cfrc_ext`, N and N m).

    The episode terminates at a state that is not healthy: not finite, or the torso's height outside 0.2 to 1 m.

    Start: standing, qpos moved by Uniform(−0.1, 0.1) and qvel by 0.1 · Normal(0, 1), each element.

    Beside Gymnasium's Ant-v5: the 78 elements of the contact forces are not observed; v and c are those of the new
    state, and so functions of the transition, where Gymnasium's are of the state at which the last substep begins.
    """

    robot = "Ant"
    substeps = 5
    default_rules = Rules(
        healthy=height_healthy,
        ctrl_cost_weight=0.5,
        contact_cost_weight=5e-4,
        healthy_z_range=(0.2, 1.0),
        hidden_positions=2,
        reset_noise_scale=0.1,
        normal_velocity_noise=True,
    )
    base_keywords: ClassVar = {"include_cfrc_ext_in_observation": False}
