"""Reference agents, run from a checkout: `python -m agents.train dadt --robot Hopper`.

One file or folder tells one paper; `train` is the one loop. Letters for shapes, everywhere in this package:

    B batch    K context length, steps the agent sees    T tokens    D embedding    H attention heads
    S state size    A action size    N parallel environments    M members, or dynamics
"""

import difflib
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from agents.cadm import CaDM, CaDMConfig
from agents.config import TrainingConfig
from agents.dadt import DADT, DADTConfig
from agents.dt import DecisionTransformer, DTConfig
from agents.dt_plus import DTPlus, DTPlusConfig
from agents.focal import FOCAL, FOCALConfig
from agents.lstm import LSTM, LSTMConfig
from agents.merpo import MerPO, MerPOConfig
from agents.mlp import MLP, MLPConfig
from agents.mlp_bc import MLPBC, MLPBCConfig
from agents.trajectory_transformer import TrajectoryTransformer, TrajectoryTransformerConfig
from agents.transformer_bc import TransformerBC, TransformerBCConfig

if TYPE_CHECKING:
    from agents.interface import Agent

__all__ = ["AGENTS", "PREDICTORS", "TRAINABLE", "check_agent", "load"]

AGENTS: Final[dict[str, tuple[type[TrainingConfig], Any]]] = {
    "dadt": (DADTConfig, DADT),
    "dt": (DTConfig, DecisionTransformer),
    "dt_plus": (DTPlusConfig, DTPlus),
    "focal": (FOCALConfig, FOCAL),
    "merpo": (MerPOConfig, MerPO),
    "trajectory_transformer": (TrajectoryTransformerConfig, TrajectoryTransformer),
    "transformer_bc": (TransformerBCConfig, TransformerBC),
    "mlp_bc": (MLPBCConfig, MLPBC),
}
"""Name → its config's class and its own (see `interface.Agent`)."""

PREDICTORS: Final[dict[str, tuple[type[TrainingConfig], Any]]] = {
    "cadm": (CaDMConfig, CaDM),
    "lstm": (LSTMConfig, LSTM),
    "mlp": (MLPConfig, MLP),
}
"""The same for what predicts the next state and does not act (see `interface.Predictor`): the paper's Figure 4."""

TRAINABLE: Final = AGENTS | PREDICTORS
"""All that `train` trains and a checkpoint may be of."""


def check_agent(name: str, among: Collection[str]) -> None:
    """Raise ValueError, with what was perhaps meant, if `name` is none of those that are known."""
    if name not in among:
        near = difflib.get_close_matches(name.lower(), among, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown agent {name!r}: choose one of {', '.join(among)}{hint}")


def load(name: str | Path, robot: str | None = None) -> "Agent":
    """An agent that was trained before; its `policy()` acts.

    Args:
        name: a run folder, of which the last checkpoint is taken, or a checkpoint; with a robot, an agent's name.
        robot: the robot whose stored weights (`agents/pretrained/`) are wanted.

    Raises:
        FileNotFoundError: there is nothing of that name; for a robot's, the message tells what is stored.
        ValueError: the file is no checkpoint, or not one of an agent.
    """
    from agents.pretrained import load_agent  # here: it needs the dicts above

    return load_agent(name, robot)
