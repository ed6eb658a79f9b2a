"""Single steps: each is one of the data, as likely as another, and all of them are every step once."""

import dataclasses

import numpy as np
import pytest

from dynagen_bench.datasets import TransitionSampler, load_dataset
from tests.datasets.test_windows import three_step_episodes


def two_endings():
    """Episodes of three steps, of which every other one ended by itself, of several dynamics."""
    data = three_step_episodes()
    numbers = np.arange(len(data.episode_lengths))
    return dataclasses.replace(data, episode_terminated=numbers % 2 == 0, episode_dynamics=numbers % 3)


def test_all_steps_are_those_of_a_loop_over_the_episodes():
    data = two_endings()
    found = TransitionSampler(data).everything()
    assert len(found.rewards) == data.num_steps
    number = 0
    for episode, (start, length) in enumerate(zip(data.episode_starts, data.episode_lengths, strict=True)):
        for t in range(length):
            row = start + t
            assert np.array_equal(found.observations[number], data.observations[row])
            assert np.array_equal(found.next_observations[number], data.observations[row + 1])
            assert np.array_equal(found.actions[number], data.actions[row])
            assert found.rewards[number] == data.rewards[row]
            assert found.terminal[number] == (t == length - 1 and data.episode_terminated[episode])
            assert found.dynamics[number] == data.episode_dynamics[episode]
            number += 1


def test_a_batch_is_drawn_from_them_by_the_generator_alone():
    data = two_endings()
    every = TransitionSampler(data).everything()
    one, same, other = (TransitionSampler(data).sample(50, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert all(np.array_equal(x, y) for x, y in zip(one, same, strict=True))
    assert not np.array_equal(one.observations, other.observations)
    known = {tuple(row) for row in np.hstack((every.observations, every.actions, every.next_observations)).tolist()}
    assert {tuple(row) for row in np.hstack((one.observations, one.actions, one.next_observations)).tolist()} <= known


def test_observations_are_as_they_are_or_normalised():
    data = two_endings()
    normalization = data.normalization()
    plain, found = (TransitionSampler(data, by).everything() for by in (None, normalization))
    np.testing.assert_array_equal(found.observations, normalization.apply(plain.observations))
    np.testing.assert_array_equal(found.next_observations, normalization.apply(plain.next_observations))
    np.testing.assert_array_equal(found.actions, plain.actions)


@pytest.mark.usefixtures("tiny_data")
def test_terminal_steps_of_real_data_are_those_whose_episodes_ended_by_themselves():
    data = load_dataset("Hopper", "train")
    found = TransitionSampler(data).everything()
    assert found.terminal.sum() == data.episode_terminated.sum() > 0
    assert found.rewards.sum(dtype=np.float64) == pytest.approx(data.episode_returns.sum(), rel=1e-5)


@pytest.mark.parametrize("size", [0, -1, 2.5, True])
def test_bad_input_is_one_line(size):
    with pytest.raises(ValueError, match=f"batch_size is {size!r}: give a whole number from 1 on"):
        TransitionSampler(two_endings()).sample(size, np.random.default_rng(0))
    with pytest.raises(ValueError, match="have no steps to sample"):
        TransitionSampler(two_endings().select(np.array([], dtype=np.int64)))
