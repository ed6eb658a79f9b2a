"""Small data and small agents for the agents' tests."""

import dataclasses

import numpy as np
import torch

from agents import AGENTS
from agents.config import TrainingConfig, TransformerConfig
from agents.interface import Agent, Phased, RobotSpec
from dynagen_bench.datasets import Normalization, OfflineDataset, Windows, WindowSampler

SEQUENCE_AGENTS = [name for name, (config, _) in AGENTS.items() if config.sampler is TrainingConfig.sampler]
"""Those that are trained on windows as they are."""

TRANSFORMERS = [name for name in SEQUENCE_AGENTS if issubclass(AGENTS[name][0], TransformerConfig)]
"""Those of them that attend to tokens, with the architecture of the paper's Table 6."""

S, A, K = 11, 3, 5  # Hopper's state and action sizes, and a short context


def tiny_config(name: str, **changes) -> TransformerConfig:
    """An agent's config of a net that trains in a blink."""
    tiny = {"layers": 2, "heads": 2, "embedding": 16, "context": K, "batch_size": 8, "steps": 20, "warmup_steps": 5}
    tiny |= {"learning_rate": 1e-3, "precision": "float32"}
    fields = {field.name for field in dataclasses.fields(AGENTS[name][0])}  # an agent of one's own may have fewer
    return AGENTS[name][0](**({key: value for key, value in tiny.items() if key in fields} | changes))


def hopper_spec() -> RobotSpec:
    return RobotSpec("Hopper", np.ones(A, np.float32), Normalization(np.zeros(S, np.float32), np.ones(S, np.float32)))


def new_agent(name: str, seed: int = 0, step: int = 0, **changes) -> Agent:
    """An untrained agent; one that learns in phases is in that of `step`."""
    agent = AGENTS[name][1](tiny_config(name, **changes), hopper_spec(), torch.Generator().manual_seed(seed))
    if isinstance(agent, Phased):
        agent.begin(step)
    return agent


def stages() -> list[tuple[str, int]]:
    """Every sequence agent at its first step, and those that learn in phases at their last one too."""
    firsts = [(name, 0) for name in SEQUENCE_AGENTS]
    return firsts + [(name, tiny_config(name).steps - 1) for name, _ in firsts if isinstance(new_agent(name), Phased)]


def flat_dataset(observations, actions, rewards, split: str = "train", robot: str = "Hopper") -> OfflineDataset:
    """The flat form of episodes given as lists of (T + 1, S), (T, A) and (T,) arrays."""
    lengths = np.array([len(r) for r in rewards])
    last = [np.zeros((1, a.shape[1])) for a in actions]
    return OfflineDataset(
        robot=robot,
        split=split,
        observations=np.concatenate(observations).astype(np.float32),
        actions=np.concatenate([x for pair in zip(actions, last, strict=True) for x in pair]).astype(np.float32),
        rewards=np.concatenate([np.append(r, 0.0) for r in rewards]).astype(np.float32),
        returns_to_go=np.concatenate([np.append(np.cumsum(r[::-1])[::-1], 0.0) for r in rewards]).astype(np.float32),
        episode_starts=np.concatenate([[0], np.cumsum(lengths + 1)[:-1]]),
        episode_lengths=lengths,
        episode_dynamics=np.zeros(len(lengths), dtype=np.int64),
        episode_snapshots=np.full(len(lengths), 50_000),
        episode_returns=np.array([float(np.sum(r)) for r in rewards]),
        episode_seeds=np.arange(len(lengths)),
        episode_terminated=np.zeros(len(lengths), dtype=np.bool_),
    )


def random_dataset(lengths=(9, 3, 12), split: str = "train", seed: int = 0) -> OfflineDataset:
    """Episodes of noise, with Hopper's sizes."""
    rng = np.random.default_rng(seed)
    return flat_dataset(
        [rng.normal(size=(length + 1, S)) for length in lengths],
        [rng.uniform(-1, 1, size=(length, A)) for length in lengths],
        [rng.uniform(0, 3, size=length) for length in lengths],
        split,
    )


def random_windows(steps=(0, 7, 9, 11, 13, 20, 22, 23)) -> Windows:
    """Eight windows of `random_dataset`, some of them padded."""
    dataset = random_dataset()
    return WindowSampler(dataset, K, dataset.normalization()).windows_at(np.array(steps))
