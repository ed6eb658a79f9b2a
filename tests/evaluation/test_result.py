"""Scores by hand, and evaluations as JSON."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.datasets import scores
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.result import MAX_EPISODES
from tests.evaluation.samples import evaluation, write_references


def made(returns, indices=(0, 1, 2, 3, 4), split="test", robot="Hopper"):
    array = np.asarray(returns, dtype=np.float64)
    return Evaluation(robot, split, indices, array, np.full(array.shape, 5), np.zeros(array.shape, np.int64), "4.0.0")


def test_official_score_by_hand(references):
    # the scale is 0 (test0's min) to 200 (test4's max); the mean return is (10 + 30 + 50 + 70 + 90) / 5 = 50
    found = made([[0, 20], [20, 40], [40, 60], [60, 80], [80, 100]])
    assert found.score == pytest.approx(25.0)


def test_dynamics_scores_by_hand(references):
    # test1: min 10, max 125, mean return 125; test3: min 30, max 175, mean return 30; test0: 0 to 100, mean return −50
    found = made([[120, 130], [30, 30], [-100, 0]], indices=(1, 3, 0))
    assert found.dynamics_scores == pytest.approx({"test1": 100.0, "test3": 0.0, "test0": -50.0})
    assert found.labels == ("test1", "test3", "test0")


def test_scores_of_train_dynamics_are_on_the_same_scale(references):
    found = made([[50.0]], indices=(7,), split="train")
    assert found.score == pytest.approx(25.0)
    assert found.dynamics_scores == pytest.approx({"train7": 52.5})


def test_without_reference_scores_there_is_no_score(tmp_path, monkeypatch, references):
    with pytest.raises(ValueError, match="no reference scores for Hopper nominal"):
        _ = made([[1.0]], indices=(0,), split="nominal").dynamics_scores
    write_references(tmp_path / "other.json", ("Ant",))
    monkeypatch.setattr(scores, "REFERENCE_FILE", tmp_path / "other.json")
    assert made([[50.0]], indices=(0,), robot="Ant").score == pytest.approx(25.0)
    with pytest.raises(ValueError, match="no reference scores for Hopper"):
        _ = made([[1.0]], indices=(0,)).score


@st.composite
def evaluations(draw):
    robot, split = draw(st.sampled_from(ids.ROBOTS)), draw(st.sampled_from(sorted(ids.SPLIT_SIZES)))
    every = st.integers(0, ids.SPLIT_SIZES[split] - 1)
    indices = tuple(draw(st.lists(every, min_size=1, unique=True)))
    shape = (len(indices), draw(st.integers(1, 4)))

    def filled(numbers, dtype):
        flat = st.lists(numbers, min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])
        return np.array(draw(flat), dtype=dtype).reshape(shape)

    returns = filled(st.floats(-1e13, 1e13), np.float64)
    lengths, seeds = filled(st.integers(1, 200), np.int64), filled(st.integers(0, 2**31 - 1), np.int64)
    return Evaluation(robot, split, indices, returns, lengths, seeds, "4.0.0")


@given(evaluations())
@settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_json_round_trip_loses_no_bit(before):
    after = Evaluation.from_json(json.loads(json.dumps(before.to_json())))
    assert after.to_json() == before.to_json()
    assert (after.robot, after.split, after.indices) == (before.robot, before.split, before.indices)
    for name in ("returns", "lengths", "seeds"):
        assert getattr(after, name).tobytes() == getattr(before, name).tobytes()
        assert getattr(after, name).dtype == getattr(before, name).dtype


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"returns": None}, "returns: Input should be a valid list"),
        ({"returns": [["1.0"] * 10] * 5}, "returns.0.0: Input should be a valid number"),
        ({"returns": [[float("nan")] * 10] * 5}, "returns.0.0: Input should be a finite number"),
        ({"returns": [[1e14] * 10] * 5}, "returns.0.0: Input should be less than or equal to"),
        ({"returns": [[1.0] * 10] * 4}, "returns have shape"),
        ({"returns": [[1.0] * 9] + [[1.0] * 10] * 4}, "returns: give as many episodes in each dynamics"),
        ({"returns": [[]] * 5}, "returns.0: List should have at least 1 item"),
        ({"returns": [[1.0] * (MAX_EPISODES + 1)] * 5}, "returns.0: List should have at most 1000 items"),
        ({"lengths": [[201] * 10] * 5}, "lengths.0.0: Input should be less than or equal to 200"),
        ({"lengths": [[1.5] * 10] * 5}, "lengths.0.0: Input should be a valid integer"),
        ({"seeds": [[True] * 10] * 5}, "seeds.0.0: Input should be a valid integer"),
        ({"seeds": [[2**31] * 10] * 5}, "seeds.0.0: Input should be less than"),
        ({"seeds": [[1] * 9] * 5}, "seeds have shape"),
        ({"robot": "Hoper"}, "did you mean 'Hopper'"),
        ({"split": "dev"}, "unknown split 'dev'"),
        ({"indices": [0, 1, 2, 3, 5]}, "index 5 is not in split 'test'"),
        ({"indices": [0, 1, 2, 3, 3]}, "name no dynamics or one twice"),
        ({"mujoco": "4.0.0\n"}, "mujoco: String should match"),
        ({"score": 100.0}, "score: Extra inputs are not permitted"),
    ],
)
def test_what_is_no_evaluation_is_refused_in_one_line(change, message):
    with pytest.raises(ValueError, match=message) as caught:
        Evaluation.from_json(evaluation().to_json() | change)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("field", ["robot", "returns", "mujoco"])
def test_a_missing_field_is_named(field):
    data = evaluation().to_json()
    del data[field]
    with pytest.raises(ValueError, match=f"{field}: Field required"):
        Evaluation.from_json(data)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="returns hold a number that is not finite"):
        made([[np.inf]], indices=(0,))
    with pytest.raises(ValueError, match=r"returns have shape \(2, 1\)"):
        made([[1.0], [2.0]], indices=(0,))
    with pytest.raises(ValueError, match="lengths go from 0 to 0"):
        Evaluation("Ant", "test", (0,), np.ones((1, 1)), np.zeros((1, 1), int), np.zeros((1, 1), int), "4.0.0")
