"""DynaGen Bench: offline dynamics generalization, from drawn bodies to a replayed leaderboard."""

from dynagen_bench.envs import register_environments

register_environments()
