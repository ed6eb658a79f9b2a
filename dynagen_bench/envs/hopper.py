"""Hopper: one leg, in the plane."""

from gymnasium.envs.mujoco import hopper_v5

from dynagen_bench.envs.rules import Rules, upright_healthy
from dynagen_bench.envs.single import RandomDynamics


class Hopper(RandomDynamics, hopper_v5.HopperEnv):
    """One leg of four links that hops forward in the x-z plane: Gymnasium's Hopper-v5 with drawn dynamics.

    A control step is 4 substeps of 0.002 s, 0.008 s; an episode has at most 200 of them.

    Actions, (3,) float32, torque as a share of the motor's 200 N m:

    | index | action | low | high | joint | unit |
    | --- | --- | --- | --- | --- | --- |
    | 0 | torque on the thigh | -1 | 1 | thigh_joint | 200 N m |
    | 1 | torque on the leg | -1 | 1 | leg_joint | 200 N m |
    | 2 | torque on the foot | -1 | 1 | foot_joint | 200 N m |

    Observations, (11,) float64:

    | index | observation | source | unit |
    | --- | --- | --- | --- |
    | 0 | height of the torso | qpos[1], rootz | m |
    | 1 | pitch of the torso | qpos[2], rooty | rad |
    | 2, 3, 4 | angles of thigh, leg, foot | qpos[3:6] | rad |
    | 5 | forward velocity of the torso | qvel[0], clipped to ±10 | m/s |
    | 6 | upward velocity of the torso | qvel[1], clipped to ±10 | m/s |
    | 7 | pitch rate of the torso | qvel[2], clipped to ±10 | rad/s |
    | 8, 9, 10 | angular velocities of thigh, leg, foot | qvel[3:6], clipped to ±10 | rad/s |

    Reward of a step: `v + 1 − 0.001‖a‖²`, with v the root's displacement along x over the step's duration (m/s), 1 only
    if the new state is healthy, and a the action clipped to its range.

    The episode terminates at a state that is not healthy: height not above 0.7 m, pitch not inside ±0.2 rad, or an
    element of (qpos[2:], qvel) not inside ±100.

    Start: standing, each element of qpos and qvel moved by Uniform(−0.005, 0.005), m, rad, m/s and rad/s.

    Beside Gymnasium's Hopper-v5: observation, reward, termination and start of the nominal robot are the same.
    """

    robot = "Hopper"
    substeps = 4
    default_rules = Rules(
        healthy=upright_healthy,
        healthy_state_range=(-100.0, 100.0),
        healthy_z_range=(0.7, float("inf")),
        healthy_angle_range=(-0.2, 0.2),
        velocity_limit=10.0,
    )
