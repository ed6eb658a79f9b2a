"""The page of a robot's data says what is in the data."""

import numpy as np
import pytest

from dynagen_bench.datasets import OfflineDataset
from dynagen_bench.datasets.cards import PAPER_RETURNS, data_card


def data_of(split: str, dynamics: int) -> OfflineDataset:
    """One-step episodes: two snapshots a dynamics, two episodes each; dynamics d returns 10 d + 1, 2, 3, 4."""
    episodes = 4 * dynamics
    index = np.repeat(np.arange(dynamics), 4)
    returns = 10.0 * index + np.tile([1.0, 2.0, 3.0, 4.0], dynamics)
    return OfflineDataset(
        robot="Hopper",
        split=split,
        observations=np.zeros((2 * episodes, 11), np.float32),
        actions=np.zeros((2 * episodes, 3), np.float32),
        rewards=np.zeros(2 * episodes, np.float32),
        returns_to_go=np.zeros(2 * episodes, np.float32),
        episode_starts=2 * np.arange(episodes),
        episode_lengths=np.ones(episodes, np.int64),
        episode_dynamics=index,
        episode_snapshots=np.tile([50_000, 50_000, 100_000, 100_000], dynamics),
        episode_returns=returns,
        episode_seeds=np.arange(episodes),
        episode_terminated=np.tile([True, False, False, False], dynamics),
    )


def test_card_has_hand_computed_numbers_beside_the_papers():
    card = data_card("Hopper", {"train": data_of("train", 2), "test": data_of("test", 5)})
    assert "28 episodes, 28 steps" in card
    assert "| test3 | 31.00 | 34.00 | 32.50 | dynamics 23 | 12.70 | 668.36 | 542.72 |" in card
    assert "| train1 | 11.0 | 11.3 | 12.5 | 13.7 | 14.0 | 12.5 | 1.0 | 25 % |" in card
    assert "|  | 50 | 100 |" in card
    assert "| test4 | 42 | 44 |" in card  # means 41.5 and 43.5, rounded to even


def test_data_of_another_split_is_refused():
    with pytest.raises(ValueError, match="data of Hopper train given as Hopper test"):
        data_card("Hopper", {"test": data_of("train", 5)})


def test_papers_table_is_complete():
    assert {robot: len(rows) for robot, rows in PAPER_RETURNS.items()} == dict.fromkeys(PAPER_RETURNS, 5)
    assert len(PAPER_RETURNS) == 5
    assert all(row.min < row.max for rows in PAPER_RETURNS.values() for row in rows)
