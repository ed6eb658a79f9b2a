"""What a SAC run is trained with. Read by the run, the command line and the data's metadata."""

import dataclasses


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
    """Width of the two hidden layers of actor and critics."""
    learning_starts: int = 10_000
    """Random steps before the first update."""
    seed: int = 0
