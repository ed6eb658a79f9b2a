"""Reference scores that one can compute with in the head."""

import pytest

from dynagen_bench.datasets import scores
from tests.evaluation.samples import write_references


@pytest.fixture
def references(tmp_path, monkeypatch):
    """Reference scores of all robots, see `samples.write_references`, in place of the committed ones."""
    file = tmp_path / "references" / "reference_scores.json"
    file.parent.mkdir()
    write_references(file)
    monkeypatch.setattr(scores, "REFERENCE_FILE", file)
    return file


@pytest.fixture
def torch_on_one_thread():
    """Small networks are slower on two."""
    pytest.importorskip("torch").set_num_threads(1)
