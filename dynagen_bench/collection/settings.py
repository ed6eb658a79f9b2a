"""What a SAC run is trained with. Read by the run, the command line and the data's metadata."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final, get_type_hints

import pydantic

from dynagen_bench import ids


@dataclasses.dataclass(frozen=True)
class SACSettings:
    """What a run is trained with; the same for all dynamics of a robot.

    Raises:
        ValueError: a number that no run can be trained with, or whose snapshots would not be those it says.
    """

    total_steps: int = 1_000_000
    """Environment steps; the paper does not give its number."""
    snapshot_every: int = 50_000
    """Environment steps between snapshots; the first is taken after 50K, the paper's warm-up."""
    environments: int = 64
    """Environments stepped at once, which share the overhead of Python."""
    gradient_steps: int = 32
    """Updates after each step of all environments."""
    batch_size: int = 128
    """Transitions in an update; 256 learn no better here and take 1.6 times as long (docs/behaviour-policies.md)."""
    policy_delay: int = 2
    """The actor is updated once in this many critic updates."""
    learning_rate: float = 3e-4
    gamma: float = 0.99
    hidden: int = 64
    """Width of the actor's two hidden layers; it sets the size of the stored policies."""
    critic_hidden: int = 64
    """Width of the critics' two hidden layers."""
    critic_layer_norm: bool = False
    """Layer normalisation in the critics, which keeps them stable at a high learning rate."""
    learning_starts: int = 10_000
    """Random steps before the first update."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            may_be_zero = name in ("learning_starts", "critic_layer_norm", "seed")
            if not 0 <= value < math.inf or (value == 0 and not may_be_zero):
                raise ValueError(f"{name} is {value!r}: give a number {'from 0 on' if may_be_zero else 'above 0'}")
        if self.gamma > 1:
            raise ValueError(f"gamma is {self.gamma!r}: give a number above 0, at most 1")
        if not self.environments <= self.snapshot_every <= self.total_steps:
            # they step together: one step of all must not pass two snapshots, and a run stores at least one
            raise ValueError(
                f"environments is {self.environments}, snapshot_every {self.snapshot_every} and total_steps "
                f"{self.total_steps}: give none that is larger than the next"
            )


_NEARER: Final = SACSettings(gradient_steps=64, learning_rate=1e-3, gamma=0.98)
"""One update per step and a shorter horizon, which helps where the robot falls seldom or never, and harms Walker."""

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
        ValueError: an unknown robot or setting, a value of another type, or numbers that make no run.
    """
    if ids.check_robot(robot) not in SETTINGS:
        raise ValueError(f"{robot} has no settings of its SAC runs: add them to SETTINGS in {__file__}")
    settings = dataclasses.asdict(SETTINGS[robot])
    types = get_type_hints(SACSettings)
    for change in changes:
        name, _, value = change.partition("=")
        if name not in settings:
            raise ValueError(f"unknown setting {name!r}: choose from {', '.join(settings)}")
        try:
            settings[name] = pydantic.TypeAdapter(types[name]).validate_python(value)  # reads text as the field's type
        except pydantic.ValidationError:
            raise ValueError(f"{name} is {value!r}: give a value like {settings[name]!r}") from None
    return SACSettings(**settings)
