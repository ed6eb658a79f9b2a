"""SlimHumanoid: Gymnasium's Humanoid with a short observation, and no end when it falls."""

from typing import ClassVar

from gymnasium.envs.mujoco import humanoid_v5

from dynagen_bench.envs.rules import Rules, height_healthy
from dynagen_bench.envs.single import RandomDynamics


class SlimHumanoid(RandomDynamics, humanoid_v5.HumanoidEnv):
    """A torso with two legs and two arms in three dimensions: Gymnasium's Humanoid-v5 with drawn dynamics, made slim.

    Observation and reward are those of Wang et al. (2019), as the paper takes them: no inertias, forces or velocities of
    mass centres are observed, contact costs nothing, and a fall does not end the episode.

    A control step is 5 substeps of 0.003 s, 0.015 s; an episode has 200 of them.

    Actions, (17,) float32, torque in units of each motor's gear:

    | index | action | low | high | joint | unit |
    | --- | --- | --- | --- | --- | --- |
    | 0, 1, 2 | torque on the abdomen about y, z, x | -0.4 | 0.4 | abdomen_y, abdomen_z, abdomen_x | 100 N m |
    | 3, 4, 5, 6 | torque on the right hip about x, z, y and the knee | -0.4 | 0.4 | right_hip_x, _z, _y, right_knee | 100, 100, 300, 200 N m |
    | 7, 8, 9, 10 | torque on the left hip about x, z, y and the knee | -0.4 | 0.4 | left_hip_x, _z, _y, left_knee | 100, 100, 300, 200 N m |
    | 11, 12, 13 | torque on the right shoulder, twice, and elbow | -0.4 | 0.4 | right_shoulder1, right_shoulder2, right_elbow | 25 N m |
    | 14, 15, 16 | torque on the left shoulder, twice, and elbow | -0.4 | 0.4 | left_shoulder1, left_shoulder2, left_elbow | 25 N m |

    Observations, (45,) float64:

    | index | observation | source | unit |
    | --- | --- | --- | --- |
    | 0 | height of the torso | qpos[2], root | m |
    | 1 to 4 | orientation of the torso, quaternion w, x, y, z | qpos[3:7], root | 1 |
    | 5, 6, 7 | angles of the abdomen about z, y, x | qpos[7:10] | rad |
    | 8 to 11 | angles of the right hip about x, z, y and the knee | qpos[10:14] | rad |
    | 12 to 15 | angles of the left hip about x, z, y and the knee | qpos[14:18] | rad |
    | 16, 17, 18 | angles of the right shoulder, twice, and elbow | qpos[18:21] | rad |
    | 19, 20, 21 | angles of the left shoulder, twice, and elbow | qpos[21:24] | rad |
    | 22, 23, 24 | velocity of the torso along x, y, z | qvel[0:3] | m/s |
    | 25, 26, 27 | angular velocity of the torso, in its own frame | qvel[3:6] | rad/s |
    | 28 to 44 | angular velocities of the joints, in the order of their angles | qvel[6:23] | rad/s |

    Reward of a step: `1.25 v − 0.1‖a‖² + 5·[1 ≤ z ≤ 2]`, with v the root's displacement along x over the step's duration
    (m/s), z the torso's height at the new state (m) and a the action clipped to its range.

    The episode terminates only after an unstable step.

    Start: standing, each element of qpos and qvel moved by Uniform(−0.01, 0.01), m, rad, m/s and rad/s.

    Beside Gymnasium's Humanoid-v5: the observation has 45 elements of its 348, v is that of the root and not of the mass
    centre, the bonus includes the ends of its range, contact costs nothing, and the episode does not terminate.
    """

    robot = "SlimHumanoid"
    substeps = 5
    default_rules = Rules(
        healthy=height_healthy,
        forward_reward_weight=1.25,
        ctrl_cost_weight=0.1,
        healthy_reward=5.0,
        healthy_z_range=(1.0, 2.0),
        terminate_when_unhealthy=False,
        hidden_positions=2,
        reset_noise_scale=1e-2,
    )
    tendons = True
    base_keywords: ClassVar = {
        "include_cinert_in_observation": False,
        "include_cvel_in_observation": False,
        "include_qfrc_actuator_in_observation": False,
        "include_cfrc_ext_in_observation": False,
    }
