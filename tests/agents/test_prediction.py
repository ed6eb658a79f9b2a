"""Next-state errors: every step is scored once, in the units of the paper's Table 3."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from agents import PREDICTORS
from agents.learner import Learner
from agents.prediction import PredictionErrors, prediction_errors, tiles
from agents.recording import record_prediction
from agents.run_folder import PREDICTION
from dynagen_bench.datasets import Normalization, WindowSampler
from tests.agents.samples import S, hopper_spec, random_dataset
from tests.tiny_data import three_step_episodes


class Copying(torch.nn.Module):
    """Predicts that nothing changes."""

    def loss(self, windows, generator):
        raise NotImplementedError

    def predict(self, windows):
        return torch.from_numpy(windows.observations)


def learner(name="mlp", context=5) -> Learner:
    return Learner(name, PREDICTORS[name][0](context=context, hidden=16, batch_size=8), hopper_spec(), seed=0)


def with_dynamics(dataset, dynamics):
    dataset.episode_dynamics[:] = dynamics
    return dataset


@pytest.mark.parametrize("context", [1, 2, 20])
def test_a_value_worked_out_by_hand(context):
    # episodes of 3 and 2 steps; each step adds (10, -1) to the state, which are (10 / 4, -1 / 2) normalised
    normalization = Normalization(np.array([3.0, 0.0], np.float32), np.array([4.0, 2.0], np.float32))
    found = prediction_errors(Copying(), three_step_episodes("test"), normalization, context, progress=False)
    assert found.dynamics.tolist() == [0, 1]
    assert found.steps.tolist() == [3, 2]
    np.testing.assert_allclose(found.errors, (2.5**2 + 0.5**2) / 2, rtol=1e-5)
    assert found.unchanged.tolist() == found.errors.tolist()  # who copies predicts that nothing changes
    assert found.mean == pytest.approx(3.25, rel=1e-5)


@pytest.mark.parametrize("name", PREDICTORS)
def test_a_loop_over_single_steps_finds_the_same(name):
    dataset = with_dynamics(random_dataset((6, 3, 7, 5, 1)), [4, 0, 4, 2, 0])
    normalization, predictor = dataset.normalization(), learner(name).agent
    found = prediction_errors(predictor, dataset, normalization, 5, progress=False)
    squares = {0: [], 2: [], 4: []}
    for start, length, dynamics in zip(
        dataset.episode_starts, dataset.episode_lengths, dataset.episode_dynamics, strict=True
    ):
        states = normalization.apply(dataset.observations[start : start + length + 1])
        for step in range(length):
            first = step - step % 5  # of its window; the history up to the step, alone and without padding
            history = WindowSampler(dataset, step - first + 1, normalization)
            counted = dataset.episode_lengths[: np.searchsorted(dataset.episode_starts, start)].sum()
            windows = history.windows_at(np.array([counted + first]))
            with torch.no_grad():
                next_state = predictor.predict(windows)[0, -1].numpy()
            squares[dynamics].append(np.mean((next_state - states[step + 1]) ** 2))
    assert found.dynamics.tolist() == [0, 2, 4]
    assert found.steps.tolist() == [4, 5, 13]
    np.testing.assert_allclose(found.errors, [np.mean(squares[key]) for key in squares], rtol=1e-4)
    assert found.mean == pytest.approx(found.errors.mean())


@given(lengths=st.lists(st.integers(0, 45), min_size=1, max_size=12), context=st.integers(1, 25))
def test_windows_tile_the_episodes(lengths, context):
    starts, owners = tiles(np.array(lengths), context)
    first = np.cumsum(lengths) - lengths  # of each episode, counted through all
    ends = np.minimum(starts + context, (first + lengths)[owners])
    steps = [step for start, end in zip(starts, ends, strict=True) for step in range(start, end)]
    assert steps == list(range(sum(lengths)))
    assert ((starts - first[owners]) % context == 0).all()


def test_more_windows_than_a_batch_holds(monkeypatch):
    dataset, predictor = random_dataset(), learner().agent
    whole = prediction_errors(predictor, dataset, dataset.normalization(), 5, progress=False)
    monkeypatch.setattr("agents.prediction.BATCH", 2)
    apart = prediction_errors(predictor, dataset, dataset.normalization(), 5, progress=False)
    np.testing.assert_allclose(whole.errors, apart.errors, rtol=1e-6)
    assert whole.steps.tolist() == apart.steps.tolist() == [24]


def test_a_part_of_the_episodes_is_spread_over_their_returns():
    dataset = with_dynamics(random_dataset((4,) * 12), np.repeat([1, 3], 6))
    dataset.episode_returns[:] = np.tile(np.arange(6.0), 2)
    part = dataset.select(np.array([1, 4, 7, 10]))
    normalization = dataset.normalization()
    found = prediction_errors(Copying(), dataset, normalization, 5, episodes=2, progress=False)
    expected = prediction_errors(Copying(), part, normalization, 5, episodes=None, progress=False)
    assert found.errors.tolist() == expected.errors.tolist()
    assert found.steps.tolist() == [8, 8]
    all_of_them = prediction_errors(Copying(), dataset, normalization, 5, episodes=100, progress=False)
    assert all_of_them.steps.tolist() == [24, 24]
    with pytest.raises(ValueError, match="episodes is 0: give a whole number from 1 on"):
        prediction_errors(Copying(), dataset, normalization, 5, episodes=0)


def test_a_prediction_that_is_no_number_is_refused():
    dataset, broken = with_dynamics(random_dataset(), [0, 3, 3]), learner().agent
    with torch.no_grad():
        broken.net.biases[-1].fill_(np.inf)
    with pytest.raises(FloatingPointError, match="next state of Hopper train0 is predicted to be no finite number"):
        prediction_errors(broken, dataset, dataset.normalization(), 5, progress=False)


def test_the_record_of_a_run(tmp_path):
    test = with_dynamics(random_dataset(split="test"), [0, 1, 1])
    trained = learner()
    assert record_prediction(trained, tmp_path, test, 4, official=False).keys() == {"test_error"}
    assert not (tmp_path / PREDICTION).exists()
    shown = record_prediction(trained, tmp_path, test, 4, official=True)
    record = json.loads((tmp_path / PREDICTION).read_text())
    assert (record["agent"], record["seed"], record["gradient_steps"], record["every"]) == ("mlp", 0, 0, 4)
    found = record["prediction"]
    assert found["mean"] == pytest.approx(shown["test_error"])
    assert (found["robot"], found["split"], found["dynamics"], found["steps"]) == ("Hopper", "test", [0, 1], [9, 15])
    assert len(found["errors"]) == 2


def test_the_mean_counts_every_dynamics_the_same():
    errors = PredictionErrors(
        "Hopper", "test", np.array([0, 1]), np.array([1.0, 3.0]), np.array([2.0, 2.0]), np.array([1, 999])
    )
    assert errors.mean == 2.0


def test_normalisation_of_another_robot_is_refused():
    short = Normalization(np.zeros(S - 1, np.float32), np.ones(S - 1, np.float32))
    with pytest.raises(ValueError, match="normalization is of 10 elements"):
        prediction_errors(Copying(), random_dataset(), short, 5, progress=False)
