"""Trajectory Transformer (Janner et al., 2021): `agent` is where to begin.

What is here, and used by no other agent: `trajectories` draws what it learns from, `discretization` makes tokens of it,
`token_transformer` predicts the next one, and `planning` searches for the best sequence of them.
"""

from agents.trajectory_transformer.agent import TrajectoryTransformer, TrajectoryTransformerConfig

__all__ = ["TrajectoryTransformer", "TrajectoryTransformerConfig"]
