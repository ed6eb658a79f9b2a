"""A board of one's own, and reference scores that one can compute with in the head."""

import shutil

import pytest

from dynagen_bench.datasets import scores
from tests.evaluation.samples import traced, write_references
from tests.leaderboard.cheats import Cheat


@pytest.fixture(autouse=True)
def references(tmp_path, monkeypatch):
    """Reference scores of four robots (see `samples.write_references`); Walker's data have not been made."""
    file = tmp_path / "references" / "reference_scores.json"
    file.parent.mkdir()
    write_references(file, ("Hopper", "HalfCheetah", "SlimHumanoid", "Ant"))
    monkeypatch.setattr(scores, "REFERENCE_FILE", file)
    return file


@pytest.fixture
def board(tmp_path):
    """A folder for a board; it does not exist yet."""
    return tmp_path / "board"


@pytest.fixture(scope="session")
def honest(tmp_path_factory):
    """The folder of an honest submission; not to be written to."""
    folder = tmp_path_factory.mktemp("honest")
    traced(folder)
    return folder


@pytest.fixture
def cheat(honest, tmp_path):
    """A copy of it, to change."""
    shutil.copytree(honest, tmp_path / "mine")
    return Cheat(tmp_path / "mine")
