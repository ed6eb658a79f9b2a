"""The evaluation protocol: policies act in dynamics that they are not told, and their returns become scores."""

from dynagen_bench.evaluation.baselines import RandomPolicy, data_returns
from dynagen_bench.evaluation.policy import Policy, RewardAware
from dynagen_bench.evaluation.result import Evaluation
from dynagen_bench.evaluation.rollout import EPISODES, SEED, action_space, evaluate, reset_seeds, returns_in

__all__ = [
    "EPISODES",
    "SEED",
    "Evaluation",
    "Policy",
    "RandomPolicy",
    "RewardAware",
    "action_space",
    "data_returns",
    "evaluate",
    "reset_seeds",
    "returns_in",
]
