"""The table of robots: the one place that lists their classes."""

from typing import Final

from dynagen_bench.envs.ant import Ant
from dynagen_bench.envs.half_cheetah import HalfCheetah
from dynagen_bench.envs.hopper import Hopper
from dynagen_bench.envs.single import RandomDynamics
from dynagen_bench.envs.slim_humanoid import SlimHumanoid
from dynagen_bench.envs.walker import Walker

ROBOT_CLASSES: Final[dict[str, type[RandomDynamics]]] = {
    robot_class.robot: robot_class for robot_class in (Walker, Hopper, HalfCheetah, SlimHumanoid, Ant)
}
