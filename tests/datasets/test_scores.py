"""Reference scores and the official scale."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.datasets import Reference, normalized_score, reference_scores, scores


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Reference scores of Hopper: test i has returns −10 + i to 100 + 10 i; train data have more and do not count."""
    path = tmp_path / "reference_scores.json"
    references = {name.label: Reference(-500.0, 900.0, 0.0) for name in ids.dynamics_ids("Hopper", ("train",))}
    references |= {f"test{i}": Reference(-10.0 + i, 100.0 + 10 * i, 50.0) for i in range(5)}
    scores.write_reference_scores("Hopper", references, path)
    monkeypatch.setattr(scores, "REFERENCE_FILE", path)
    return path


def test_scale_is_of_all_test_dynamics(file):
    assert scores.score_range("Hopper") == (-10.0, 140.0)
    assert normalized_score("Hopper", -10.0) == 0.0
    assert normalized_score("Hopper", 140.0) == 100.0
    np.testing.assert_allclose(normalized_score("Hopper", [[65.0, 290.0], [-160.0, 2.5]]), [[50, 200], [-100, 25 / 3]])


def test_round_trip_and_other_robots_stay(file):
    assert reference_scores("Hopper")["test2"] == Reference(-8.0, 120.0, 50.0)
    assert list(reference_scores("Hopper")) == [name.label for name in ids.dynamics_ids("Hopper")]
    scores.write_reference_scores("Ant", {"test0": Reference(0.0, 1.0, 0.1234567)}, file)
    assert list(json.loads(file.read_text())) == ["Ant", "Hopper"]
    assert reference_scores("Ant")["test0"].mean == 0.123457
    assert reference_scores("Hopper")["train0"].max == 900.0


@given(returns=st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=20))
def test_scores_are_a_straight_line_of_returns(returns):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scores, "score_range", lambda robot, file=None: (20.0, 220.0))
        found = normalized_score("Hopper", returns)
        np.testing.assert_allclose(found, (np.array(returns) - 20) / 2, atol=1e-9)
        np.testing.assert_allclose(found.mean(), normalized_score("Hopper", np.mean(returns)), atol=1e-6)


def test_robots_without_data_and_unknown_robots(file):
    with pytest.raises(
        ValueError, match=r"no reference scores for Walker: .*`dynagen data build Walker --write-manifest`"
    ):
        reference_scores("Walker")
    with pytest.raises(ValueError, match="unknown robot 'Cat'"):
        reference_scores("Cat")
