"""The page of a robot's data says what is in the data."""

import re

import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.datasets import OfflineDataset
from dynagen_bench.datasets.cards import PAPER_RETURNS, Stored, data_card, read_curves, write_data_card


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


STORED = [
    Stored("dynagen/Hopper-RandDyn/train0-v0", 1000, 123456, 2_500_000, "0123456789abcdef" * 4, True, "4.0.0"),
    Stored("dynagen/Hopper-RandDyn/train1-v0", 8, 9, 500_000, "f" * 64, False, "4.0.1"),
]


def test_card_has_hand_computed_numbers_beside_the_papers():
    card = data_card("Hopper", {"train": data_of("train", 2), "test": data_of("test", 5)}, STORED)
    assert "| content | 28 episodes, 28 steps |" in card
    assert "| test3 | 31.00 | 34.00 | 32.50 | dynamics 23 | 12.70 | 668.36 | 542.72 |" in card
    assert "| train1 | 11.0 | 11.3 | 12.5 | 13.7 | 14.0 | 12.5 | 1.0 | 25 % |" in card
    assert "|  | 50 | 100 |" in card
    assert "| test4 | 42 | 44 |" in card  # means 41.5 and 43.5, rounded to even


def test_card_says_what_is_on_disk_and_whether_it_is_official():
    card = data_card("Hopper", {"train": data_of("train", 2), "test": data_of("test", 5)}, STORED)
    # 28 one-step episodes have 56 rows of 11 + 3 + 1 + 1 float32
    assert "| size | 3 MB as 2 Minari datasets, 0 MB as flat float32 arrays |" in card
    assert "| physics | MuJoCo 4.0.0, 4.0.1 |" in card
    assert "| official | 1 of 2 have the manifest's hash |" in card
    assert "| `dynagen/Hopper-RandDyn/train0-v0` | 1,000 | 123,456 | 2.5 | `0123456789abcdef` | yes |" in card
    assert "| `dynagen/Hopper-RandDyn/train1-v0` | 8 | 9 | 0.5 | `ffffffffffffffff` | no |" in card


def test_card_says_what_the_parts_are():
    card = data_card("Hopper", {"train": data_of("train", 2), "test": data_of("test", 5)}, STORED)
    # 30 % of eight episodes are two, those that return 1 and 2, both of train0
    assert "2 episodes, 2 steps, the worst of all train dynamics together" in card
    assert "None returns more than 2.0; 1 dynamics have none:" in card
    assert "|  | train0 |\n| --- | ---: |\n| episodes | 2 |" in card
    assert "| test2 | 21 | 22 | 23 | 24 |" in card  # of four episodes, all


def test_data_of_another_split_is_refused():
    with pytest.raises(ValueError, match="data of Hopper train given as Hopper test"):
        data_card("Hopper", {"test": data_of("train", 5)}, STORED)


def test_a_card_is_written_with_its_charts_beside_it(tiny_data, tmp_path, capsys):
    write_data_card("Hopper", tmp_path / "pages" / "about.md")
    names = sorted(path.name for path in (tmp_path / "pages").iterdir())
    assert names == ["about.md", "hopper-curves.svg", "hopper-returns.svg"]
    card = (tmp_path / "pages" / "about.md").read_text(encoding="utf-8")
    links = re.findall(r"!\[.+\]\((.+)\)", card)
    assert sorted([*links, "about.md"]) == names
    assert card.count("| no |") == 25  # tiny data are not the official ones
    write_data_card("Hopper")
    assert capsys.readouterr().out == card


def test_learning_curves_are_those_of_the_runs():
    curves = read_curves("Hopper")
    assert list(curves) == [name.label for name in ids.dynamics_ids("Hopper")]
    assert curves["train0"][0] == [50_000.0 * (k + 1) for k in range(20)]
    assert curves["train0"][1][:2] == [216.666, 211.016]


def test_missing_curves_and_data_name_the_command(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no learning curve at .*train0.csv: .* `dynagen collect Hopper`"):
        read_curves("Hopper", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"no data of Hopper-RandDyn-train0 at .* `dynagen data build Hopper`"):
        write_data_card("Hopper")


def test_papers_table_is_complete():
    assert {robot: len(rows) for robot, rows in PAPER_RETURNS.items()} == dict.fromkeys(PAPER_RETURNS, 5)
    assert len(PAPER_RETURNS) == 5
    assert all(row.min < row.max for rows in PAPER_RETURNS.values() for row in rows)
