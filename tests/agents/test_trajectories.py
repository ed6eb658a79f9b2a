"""Trajectories: rewards, values and ends, by hand."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.trajectory_transformer.trajectories import TrajectorySampler, discounted_values
from dynagen_bench.datasets import Normalization
from dynagen_bench.envs import HORIZON
from tests.agents.samples import flat_dataset

NORMALIZATION = Normalization(np.array([1.0], np.float32), np.array([2.0], np.float32))


def sampler_of(lengths=(4, 3), terminated=(True, False), penalty=-100.0, context=3, chosen=None) -> TrajectorySampler:
    """Episodes e with state 10 e + t, action −t and reward 2 ** t, for t below 8."""
    dataset = flat_dataset(
        [10.0 * e + np.arange(n + 1)[:, None] for e, n in enumerate(lengths)],
        [-np.arange(n)[:, None] for n in lengths],
        [2.0 ** (np.arange(n) % 8) for n in lengths],
    )
    dataset = dataclasses.replace(dataset, episode_terminated=np.array(terminated))
    if chosen is not None:
        dataset = dataset.select(np.array(chosen))
    return TrajectorySampler(dataset, context, NORMALIZATION, 0.5, penalty)


def test_transitions_by_hand():
    rows = sampler_of().rows(np.arange(7))
    np.testing.assert_allclose(rows[:, 0], (np.array([0, 1, 2, 3, 10, 11, 12]) - 1) / 2, rtol=1e-5)
    assert rows[:, 1].tolist() == [0, -1, -2, -3, 0, -1, -2]
    assert rows[:, 2].tolist() == [1, 2, 4, -100, 1, 2, 4]
    assert rows[:, 3].tolist() == [2 + 4 / 2 - 100 / 4, 4 - 100 / 2, -100, 0, 2 + 4 / 2, 4, 0]
    assert sampler_of(penalty=None).rows(np.array([3]))[0, 2] == 8


def test_what_has_ended_is_known_and_what_was_cut_off_is_not():
    sampler = sampler_of()
    found = sampler.at(np.array([0, 2, 3, 4, 6]))
    assert found.rows.dtype == np.float32
    assert found.rows[:, :, 1].tolist() == [[0, -1, -2], [-2, -3, 0], [-3, 0, 0], [0, -1, -2], [-2, 0, 0]]
    assert found.ended.tolist() == [[False] * 3, [False, False, True], [False, True, True], [False] * 3, [False] * 3]
    assert found.mask.tolist() == [[True] * 3] * 4 + [[True, False, False]]
    assert not found.rows[~found.mask].any()


def test_nothing_is_known_past_the_horizon():
    found = sampler_of(lengths=(HORIZON - 1,), terminated=(True,)).at(np.array([HORIZON - 2]))
    assert found.ended.tolist() == [[False, True, False]]
    assert found.mask.tolist() == [[True, True, False]]


def test_a_part_of_the_data_has_the_trajectories_of_its_episodes():
    whole, part = sampler_of(), sampler_of(chosen=[1])
    assert part.num_steps == 3
    for ours, theirs in zip(part.at(np.arange(3)), whole.at(np.arange(4, 7)), strict=True):
        assert np.array_equal(ours, theirs)


def test_every_step_begins_a_trajectory_as_often_as_another():
    drawn = sampler_of().sample(7000, np.random.default_rng(0)).rows[:, 0, 0]
    counts = np.unique(drawn, return_counts=True)[1]
    assert len(counts) == 7
    assert counts.min() > 850


@given(st.lists(st.integers(0, 12), min_size=1, max_size=8), st.floats(0.0, 1.0), st.integers(0, 99))
def test_values_are_the_discounted_rewards_that_follow(lengths, discount, seed):
    rewards = np.random.default_rng(seed).normal(size=sum(lengths)).astype(np.float32)
    found = discounted_values(rewards, np.array(lengths), discount)
    assert found.dtype == np.float32
    for episode, values in zip(
        np.split(rewards, np.cumsum(lengths)[:-1]), np.split(found, np.cumsum(lengths)[:-1]), strict=True
    ):
        for t, value in enumerate(values):
            following = episode[t + 1 :].astype(np.float64)
            assert value == pytest.approx((discount ** np.arange(len(following)) * following).sum(), abs=1e-5)


def test_data_without_steps_are_refused():
    with pytest.raises(ValueError, match="the train data of Hopper have no steps"):
        sampler_of(lengths=(0, 0), terminated=(False, False))
