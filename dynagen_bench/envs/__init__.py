"""The environments: five robots whose bodies differ, registered with Gymnasium by a table and a loop."""

import gymnasium

from dynagen_bench import ids
from dynagen_bench.envs.batch import BatchPhysics, Transition
from dynagen_bench.envs.robots import ROBOT_CLASSES
from dynagen_bench.envs.rules import Rules
from dynagen_bench.envs.single import RandomDynamics
from dynagen_bench.envs.vector import HORIZON, RandomDynamicsVector

__all__ = [
    "HORIZON",
    "ROBOT_CLASSES",
    "BatchPhysics",
    "RandomDynamics",
    "RandomDynamicsVector",
    "Rules",
    "Transition",
    "register_environments",
]


def register_environments() -> None:
    """Register `{robot}-RandDyn-v0` and the 25 short ids of every robot; doing it twice changes nothing."""
    for robot, robot_class in ROBOT_CLASSES.items():
        entry_point = f"{robot_class.__module__}:{robot_class.__name__}"
        names: dict[str, dict[str, str | int]] = {ids.v0_env_id(robot): {}}
        names |= {name.env_id: {"split": name.split, "index": name.index} for name in ids.dynamics_ids(robot)}
        for env_id, kwargs in names.items():
            if env_id not in gymnasium.registry:
                gymnasium.register(
                    env_id,
                    entry_point=entry_point,
                    vector_entry_point=f"{RandomDynamicsVector.__module__}:{robot}",
                    max_episode_steps=HORIZON,
                    kwargs=kwargs,
                )
