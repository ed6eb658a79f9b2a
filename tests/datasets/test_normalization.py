"""Statistics of observations, and their use."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.trajectory_transformer.trajectories import TrajectorySampler
from agents.transitions import TaskSampler
from dynagen_bench.datasets import Normalization, TransitionSampler, WindowSampler, normalization
from tests.tiny_data import three_step_episodes


def test_by_hand():
    observations = np.array([[1, 5], [100, 100], [3, 5]], dtype=np.float32)
    found = normalization.statistics(observations, np.array([True, False, True]))
    np.testing.assert_array_equal(found.mean, [2, 5])
    np.testing.assert_array_equal(found.std, [1, 0])
    applied = found.apply(np.array([[3.0, 5.0], [2.0, 6.0]]))
    assert applied.dtype == np.float32
    np.testing.assert_allclose(applied, [[1 / (1 + 1e-6), 0], [0, 1e6]], rtol=1e-6)


@given(rows=st.integers(1, 40), chunk=st.integers(1, 50), seed=st.integers(0, 2**32 - 1))
def test_chunks_change_nothing(rows, chunk, seed):
    rng = np.random.default_rng(seed)
    observations = (1000 + rng.normal(size=(rows, 3))).astype(np.float32)
    chosen = rng.random(rows) < 0.7
    chosen[rng.integers(rows)] = True
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(normalization, "_CHUNK", chunk)
        found = normalization.statistics(observations, chosen)
    np.testing.assert_allclose(found.mean, observations[chosen].astype(np.float64).mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.std, observations[chosen].astype(np.float64).std(axis=0), rtol=1e-5, atol=1e-12)
    applied = found.apply(observations[chosen])
    assert np.isfinite(applied).all()
    assert applied.shape == observations[chosen].shape


def test_any_leading_shape_goes_through():
    applied = Normalization(np.zeros(3, np.float32), np.ones(3, np.float32)).apply(np.ones((2, 4, 3)))
    assert applied.shape == (2, 4, 3)


SAMPLERS = {
    "windows": lambda data, normalization: WindowSampler(data, 2, normalization),
    "transitions": TransitionSampler,
    "tasks": lambda data, normalization: TaskSampler(data, normalization, 1),
    "trajectories": lambda data, normalization: TrajectorySampler(data, 2, normalization, 0.9, None),
}


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("size", [1, 3])
def test_no_sampler_stretches_a_normalisation_of_other_observations(sampler, size):
    other = Normalization(np.zeros(size, np.float32), np.ones(size, np.float32))
    with pytest.raises(ValueError, match=rf"^normalization is of {size} elements, and observations have shape .*2\)"):
        SAMPLERS[sampler](three_step_episodes(), other).sample(4, np.random.default_rng(0))


@pytest.mark.parametrize(("mean", "std"), [((2,), (1,)), ((2, 2), (2, 2)), ((), ())])
def test_a_mean_and_a_deviation_of_each_element(mean, std):
    with pytest.raises(ValueError, match=r"give both the shape \(S,\)$"):
        Normalization(np.zeros(mean, np.float32), np.ones(std, np.float32))


def test_nothing_to_normalise_by():
    with pytest.raises(ValueError, match="no observations to normalise by"):
        normalization.statistics(np.zeros((2, 3), np.float32), np.zeros(2, np.bool_))
