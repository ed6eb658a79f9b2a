"""Histograms of returns, and what is said where there are no data."""

import re
import shutil

import pytest

from dynagen_bench.collection.contents import dataset_folder
from dynagen_bench.pictures.returns import BINS, HEIGHT, distributions, load_returns
from tests.tiny_data import three_step_episodes


@pytest.mark.usefixtures("tiny_data")
def test_every_body_with_data_has_a_row():
    found = distributions(load_returns("Hopper"))
    assert len(found.rows) == 25
    assert [row.label for row in found.rows][18:21] == ["train18", "train19", "test0"]
    assert found.missing == []
    assert all("12 episodes" in row.words for row in found.rows)


def test_data_that_are_not_here_are_missing():
    found = distributions(load_returns("Ant"))
    assert found.rows == []
    assert found.missing == ["train", "test"]


def test_damaged_data_are_not_taken_for_missing_ones(tiny_data, tmp_path, monkeypatch):
    shutil.copytree(tiny_data, tmp_path / "minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    (dataset_folder("dynagen/Hopper-RandDyn/test3-v0") / "data" / "main_data.hdf5").unlink()
    with pytest.raises(ValueError, match=r"test3-v0 is damaged: it has no main_data\.hdf5"):
        load_returns("Hopper")


def test_a_histogram_by_hand():
    found = distributions({"train": three_step_episodes()})  # returns 7 and 24, one each
    assert [text for _, text in found.ticks] == ["5", "10", "15", "20", "25"]
    assert [row.median for row in found.rows] == ["7", "24"]
    assert found.rows[0].median_at == pytest.approx(BINS * 2 / 20)
    heights = [float(y) for y in re.findall(r"V([\d.]+)h1", found.rows[0].path)]
    assert heights == [0.0 if i == 6 else HEIGHT for i in range(BINS)]
    assert found.missing == ["test"]
