"""Steps of several dynamics: which are drawn, and what is in them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.transitions import TaskSampler
from dynagen_bench.datasets import Normalization
from tests.agents.samples import S, random_dataset

PLAIN = Normalization(np.zeros(S, np.float32), np.full(S, 1 - 1e-6, np.float32))  # changes nothing: 1e-6 is added
assert PLAIN.apply(np.ones(S))[0] == 1.0


def mixed(lengths, dynamics):
    dataset = random_dataset(tuple(lengths))
    terminated = np.arange(len(lengths)) % 2 == 0
    return dataclasses.replace(dataset, episode_dynamics=np.array(dynamics), episode_terminated=terminated)


def row_of(dataset, observation):
    """The row of the data that has this observation, which is the only one."""
    (rows,) = np.nonzero((dataset.observations == observation).all(axis=1))
    return int(rows.item())


@given(
    st.lists(st.tuples(st.integers(1, 6), st.integers(0, 3)), min_size=1, max_size=8),
    st.integers(2, 4),
    st.integers(0, 2**32 - 1),
)
def test_every_step_is_one_of_the_data_and_of_its_dynamics(episodes, tasks, seed):
    lengths, dynamics = zip(*episodes, strict=True)
    dataset = mixed(lengths, dynamics)
    found = TaskSampler(dataset, PLAIN, tasks).sample(5, np.random.default_rng(seed))
    assert len(found.dynamics) == min(tasks, len(set(dynamics)))
    assert (found.dynamics == found.dynamics[:, :1]).all()
    assert list(found.dynamics[:, 0]) == sorted(set(found.dynamics.ravel().tolist()))
    for m, task in enumerate(found.dynamics[:, 0]):
        for b in range(5):
            row = row_of(dataset, found.observations[m, b])
            episode = int(np.searchsorted(dataset.episode_starts, row, side="right")) - 1
            assert dataset.episode_dynamics[episode] == task
            assert np.array_equal(found.actions[m, b], dataset.actions[row])
            assert found.rewards[m, b] == dataset.rewards[row]
            assert np.array_equal(found.next_observations[m, b], dataset.observations[row + 1])
            last = row - dataset.episode_starts[episode] == lengths[episode] - 1
            assert found.terminal[m, b] == (last and dataset.episode_terminated[episode])


def test_each_step_of_a_dynamics_is_as_likely_as_another():
    dataset = mixed((1, 3, 4), (0, 1, 1))
    found = TaskSampler(dataset, PLAIN, 2).sample(7000, np.random.default_rng(0))
    _, counts = np.unique(found.observations[1], axis=0, return_counts=True)
    assert len(counts) == 7
    assert (np.abs(counts - 1000) < 150).all()  # five deviations


def test_observations_are_normalised():
    dataset = random_dataset()
    normalization = dataset.normalization()
    plain = TaskSampler(dataset, PLAIN, 2).sample(5, np.random.default_rng(0))
    found = TaskSampler(dataset, normalization, 2).sample(5, np.random.default_rng(0))
    np.testing.assert_array_equal(found.observations, normalization.apply(plain.observations))
    np.testing.assert_array_equal(found.next_observations, normalization.apply(plain.next_observations))


def test_everything_of_one_dynamics():
    dataset = random_dataset((2, 3))
    found = TaskSampler(dataset, PLAIN, 1).everything()
    assert np.array_equal(found.observations[0], dataset.observations[[0, 1, 3, 4, 5]])
    with pytest.raises(ValueError, match="the data are of 2 dynamics"):
        TaskSampler(mixed((2, 3), (0, 1)), PLAIN, 1).everything()


def test_no_steps():
    dataset = random_dataset()
    with pytest.raises(ValueError, match="have no steps to sample"):
        TaskSampler(dataset.select(np.array([], dtype=np.int64)), PLAIN, 2)
