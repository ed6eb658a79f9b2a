"""What a SAC run is trained with. Read by the run, the command line and the data's metadata."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import pydantic

from dynagen_bench import ids


@dataclasses.dataclass(frozen=True)
class SACSettings:
    """What a run is trained with; the same for all dynamics of a robot."""

    total_steps: int = 1_000_000
    """Environment steps (DESIGN: the paper's own number is not given)."""
    snapshot_every: int = 50_000
    """Steps between snapshots; the first is the paper's warm-up of 50K steps."""
    environments: int = 64
    """Environments stepped at once: Python is paid once for all of them."""
    gradient_steps: int = 32
    """Updates after each step of all environments."""
    batch_size: int = 128
    policy_delay: int = 2
    """The actor is updated once in this many critic updates."""
    learning_rate: float = 3e-4
    gamma: float = 0.99
    hidden: int = 64
    """Width of the actor's two hidden layers; it is what the stored policies weigh."""
    critic_hidden: int = 64
    """Width of the critics' two hidden layers."""
    critic_layer_norm: bool = False
    """Layer normalisation in the critics, which keeps them calm at a high learning rate."""
    learning_starts: int = 10_000
    """Random steps before the first update."""
    seed: int = 0


_NEARER: Final = SACSettings(gradient_steps=64, learning_rate=1e-3, gamma=0.98)
"""One update a step, and looks less far ahead, which helps where the robot falls seldom or never, and harms Walker."""

SETTINGS: Final[Mapping[str, SACSettings]] = {
    "Walker": SACSettings(learning_rate=1e-3),
    "Hopper": SACSettings(),
    "HalfCheetah": _NEARER,
    "SlimHumanoid": SACSettings(),
    "Ant": dataclasses.replace(_NEARER, policy_delay=1),
}
"""Robot → what its 25 runs are trained with (docs/behaviour-policies.md says what else was tried)."""


def changed_settings(robot: str, changes: Sequence[str]) -> SACSettings:
    """The settings of a robot with changes such as `learning_rate=1e-3`.

    Raises:
        ValueError: an unknown robot or setting, or a value of another type.
    """
    settings = dataclasses.asdict(SETTINGS[ids.check_robot(robot)])
    for change in changes:
        name, _, value = change.partition("=")
        if name not in settings:
            raise ValueError(f"unknown setting {name!r}: choose from {', '.join(settings)}")
        try:
            # pydantic reads text as the field's type
            settings = dataclasses.asdict(pydantic.TypeAdapter(SACSettings).validate_python(settings | {name: value}))
        except pydantic.ValidationError:
            raise ValueError(f"{name} is {value!r}: give a value like {settings[name]!r}") from None
    return SACSettings(**settings)
