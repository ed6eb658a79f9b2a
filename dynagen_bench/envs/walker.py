"""Walker: two legs, in the plane."""

from gymnasium.envs.mujoco import walker2d_v5

from dynagen_bench.envs.rules import Rules, upright_healthy
from dynagen_bench.envs.single import RandomDynamics


class Walker(RandomDynamics, walker2d_v5.Walker2dEnv):
    """Two legs of three links each that walk forward in the x-z plane: Gymnasium's Walker2d-v5 with drawn dynamics.

    A control step is 4 substeps of 0.002 s, 0.008 s; an episode has at most 200 of them.

    Actions, (6,) float32, torque as a share of the motor's 100 N m:

    | index | action | low | high | joint | unit |
    | --- | --- | --- | --- | --- | --- |
    | 0, 1, 2 | torque on the right thigh, leg, foot | -1 | 1 | thigh_, leg_, foot_joint | 100 N m |
    | 3, 4, 5 | torque on the left thigh, leg, foot | -1 | 1 | thigh_, leg_, foot_left_joint | 100 N m |

    Observations, (17,) float64:

    | index | observation | source | unit |
    | --- | --- | --- | --- |
    | 0 | height of the torso | qpos[1], rootz | m |
    | 1 | pitch of the torso | qpos[2], rooty | rad |
    | 2, 3, 4 | angles of the right thigh, leg, foot | qpos[3:6] | rad |
    | 5, 6, 7 | angles of the left thigh, leg, foot | qpos[6:9] | rad |
    | 8, 9 | forward and upward velocity of the torso | qvel[0:2], clipped to ±10 | m/s |
    | 10 | pitch rate of the torso | qvel[2], clipped to ±10 | rad/s |
    | 11, 12, 13 | angular velocities of the right thigh, leg, foot | qvel[3:6], clipped to ±10 | rad/s |
    | 14, 15, 16 | angular velocities of the left thigh, leg, foot | qvel[6:9], clipped to ±10 | rad/s |

    Reward of a step: `v + 1 − 0.001‖a‖²`, with v the root's displacement along x over the step's duration (m/s), 1 only
    if the new state is healthy, and a the action clipped to its range.

    The episode terminates at a state that is not healthy: height not inside 0.8 to 2 m, or pitch not inside ±1 rad.

    Start: standing, each element of qpos and qvel moved by Uniform(−0.005, 0.005), m, rad, m/s and rad/s.

    Beside Gymnasium's Walker2d-v5: observation, reward, termination and start of the nominal robot are the same.
    """

    robot = "Walker"
    substeps = 4
    default_rules = Rules(
        healthy=upright_healthy, healthy_z_range=(0.8, 2.0), healthy_angle_range=(-1.0, 1.0), velocity_limit=10.0
    )
