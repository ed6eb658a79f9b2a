"""Reference agents, run from a checkout: `python -m agents.train dadt --robot Hopper`.

One file tells one paper; `train` is the one loop. Letters for shapes, everywhere in this package:

    B batch    K context length, steps the agent sees    T tokens    D embedding    H attention heads
    S state size    A action size    N parallel environments
"""

from typing import Any, Final

from agents.config import TrainingConfig
from agents.dadt import DADT, DADTConfig
from agents.dt import DecisionTransformer, DTConfig
from agents.transformer_bc import TransformerBC, TransformerBCConfig

__all__ = ["AGENTS"]

AGENTS: Final[dict[str, tuple[type[TrainingConfig], Any]]] = {
    "dadt": (DADTConfig, DADT),
    "dt": (DTConfig, DecisionTransformer),
    "transformer_bc": (TransformerBCConfig, TransformerBC),
}
"""Name → its config's class and its own (see `interface.Agent`)."""
