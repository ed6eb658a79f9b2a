"""DynaGen Bench: offline dynamics generalization, from drawn bodies to a replayed leaderboard.

Importing it registers the environments. These are the public names; the rest may change between versions.
"""

import importlib.metadata

from dynagen_bench.datasets import (
    Normalization,
    OfflineDataset,
    TransitionSampler,
    WindowSampler,
    load_adaptation,
    load_dataset,
    reference_scores,
)
from dynagen_bench.dynamics import Dynamics, draw_dynamics, load_dynamics
from dynagen_bench.envs import register_environments
from dynagen_bench.evaluation import Evaluation, Policy, action_space, evaluate, returns_in
from dynagen_bench.ids import ROBOTS

__all__ = [
    # bodies
    "ROBOTS",
    "Dynamics",
    "draw_dynamics",
    "load_dynamics",
    # data
    "Normalization",
    "OfflineDataset",
    "TransitionSampler",
    "WindowSampler",
    "load_adaptation",
    "load_dataset",
    "reference_scores",
    # scores
    "Evaluation",
    "Policy",
    "action_space",
    "evaluate",
    "returns_in",
    # the package
    "__version__",
]

__version__ = importlib.metadata.version("dynagen-bench")

register_environments()
