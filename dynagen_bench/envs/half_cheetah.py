"""HalfCheetah: a torso on two legs, in the plane; it never falls out of its episode."""

from gymnasium.envs.mujoco import half_cheetah_v5

from dynagen_bench.envs.rules import Rules
from dynagen_bench.envs.single import RandomDynamics


class HalfCheetah(RandomDynamics, half_cheetah_v5.HalfCheetahEnv):
    """A torso on two legs that runs forward in the x-z plane: Gymnasium's HalfCheetah-v5 with drawn dynamics.

    A control step is 5 substeps of 0.01 s, 0.05 s; an episode has 200 of them.

    Actions, (6,) float32, torque as a share of each motor's own maximum:

    | index | action | low | high | joint | unit |
    | --- | --- | --- | --- | --- | --- |
    | 0, 1, 2 | torque on the back thigh, shin, foot | -1 | 1 | bthigh, bshin, bfoot | 120, 90, 60 N m |
    | 3, 4, 5 | torque on the front thigh, shin, foot | -1 | 1 | fthigh, fshin, ffoot | 120, 60, 30 N m |

    Observations, (17,) float64:

    | index | observation | source | unit |
    | --- | --- | --- | --- |
    | 0 | height of the torso | qpos[1], rootz | m |
    | 1 | pitch of the torso | qpos[2], rooty | rad |
    | 2, 3, 4 | angles of the back thigh, shin, foot | qpos[3:6] | rad |
    | 5, 6, 7 | angles of the front thigh, shin, foot | qpos[6:9] | rad |
    | 8, 9 | forward and upward velocity of the torso | qvel[0:2] | m/s |
    | 10 | pitch rate of the torso | qvel[2] | rad/s |
    | 11, 12, 13 | angular velocities of the back thigh, shin, foot | qvel[3:6] | rad/s |
    | 14, 15, 16 | angular velocities of the front thigh, shin, foot | qvel[6:9] | rad/s |

    Reward of a step: `v − 0.1‖a‖²`, with v the root's displacement along x over the step's duration (m/s) and a the
    action clipped to its range.

    The episode terminates only after an unstable step.

    Start: standing, qpos moved by Uniform(−0.1, 0.1) and qvel by 0.1 · Normal(0, 1), each element.

    Beside Gymnasium's HalfCheetah-v5: observation, reward, termination and start of the nominal robot are the same.
    """

    robot = "HalfCheetah"
    substeps = 5
    default_rules = Rules(
        ctrl_cost_weight=0.1,
        healthy_reward=0.0,
        terminate_when_unhealthy=False,
        reset_noise_scale=0.1,
        normal_velocity_noise=True,
    )
