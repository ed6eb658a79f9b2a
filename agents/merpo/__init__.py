"""MerPO (Lin et al., 2022): `agent` is where to begin; `world_model` has the models of the dynamics."""

from agents.merpo.agent import MerPO, MerPOConfig

__all__ = ["MerPO", "MerPOConfig"]
