"""Windows against episodes of three steps written by hand, and properties of any data."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench.datasets import Normalization, OfflineDataset, WindowSampler
from tests.tiny_data import three_step_episodes

PLAIN = Normalization(np.zeros(2, np.float32), np.full(2, 1 - 1e-6, np.float32))
"""Changes nothing."""


@pytest.fixture
def sampler():
    return WindowSampler(three_step_episodes(), 4, PLAIN)


def test_a_window_in_the_middle_is_padded_on_the_left(sampler):
    window = sampler.windows_at(np.array([1]))
    np.testing.assert_allclose(window.observations, [[[0, 0], [0, 0], [10, -1], [20, -2]]])
    np.testing.assert_allclose(window.actions, [[[0], [0], [2], [3]]])
    np.testing.assert_allclose(window.next_observations, [[[0, 0], [0, 0], [20, -2], [30, -3]]])
    np.testing.assert_allclose(window.returns_to_go, [[0, 0, 6, 4]])
    np.testing.assert_array_equal(window.timesteps, [[0, 0, 1, 2]])
    np.testing.assert_array_equal(window.mask, [[False, False, True, True]])


def test_a_window_never_reaches_into_the_next_episode(sampler):
    windows = sampler.windows_at(np.array([0, 2, 3, 4]))
    np.testing.assert_allclose(windows.actions[..., 0], [[0, 1, 2, 3], [0, 0, 0, 3], [0, 0, 5, 6], [0, 0, 0, 6]])
    np.testing.assert_allclose(windows.returns_to_go, [[0, 7, 6, 4], [0, 0, 0, 4], [0, 0, 24, 16], [0, 0, 0, 16]])
    np.testing.assert_array_equal(windows.timesteps, [[0, 0, 1, 2], [0, 0, 0, 2], [0, 0, 0, 1], [0, 0, 0, 1]])
    np.testing.assert_array_equal(windows.mask.sum(axis=1), [3, 1, 2, 1])


def test_a_short_context_takes_the_steps_from_the_start():
    windows = WindowSampler(three_step_episodes(), 2, PLAIN).windows_at(np.array([0, 1]))
    np.testing.assert_allclose(windows.actions[..., 0], [[1, 2], [2, 3]])
    assert windows.mask.all()


def test_observations_are_normalised_and_padding_is_zero_all_the_same():
    normalization = Normalization(np.array([10, 0], np.float32), np.array([5, 1], np.float32))
    window = WindowSampler(three_step_episodes(), 3, normalization).windows_at(np.array([1]))
    np.testing.assert_allclose(window.observations[0, :, 0], [0, 0, 2], rtol=1e-5)
    np.testing.assert_allclose(window.next_observations[0, :, 0], [0, 2, 4], rtol=1e-5)


def test_types_and_shapes(sampler):
    windows = sampler.sample(7, np.random.default_rng(0))
    shapes = {field: getattr(windows, field).shape for field in windows._fields}
    assert shapes == {
        "observations": (7, 4, 2),
        "actions": (7, 4, 1),
        "next_observations": (7, 4, 2),
        "returns_to_go": (7, 4),
        "timesteps": (7, 4),
        "mask": (7, 4),
    }
    for field in ("observations", "actions", "next_observations", "returns_to_go"):
        assert getattr(windows, field).dtype == np.float32
    assert (windows.timesteps.dtype, windows.mask.dtype) == (np.int64, np.bool_)


def test_the_same_generator_gives_the_same_windows(sampler):
    one, other = (sampler.sample(16, np.random.default_rng(4)) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_every_step_begins_as_many_windows(sampler):
    windows = sampler.sample(5000, np.random.default_rng(0))
    first = windows.actions[np.arange(5000), windows.mask.argmax(axis=1), 0]
    actions, counts = np.unique(first, return_counts=True)
    assert actions.tolist() == [1, 2, 3, 5, 6]
    assert (np.abs(counts - 1000) < 120).all()  # four standard deviations


def random_episodes(lengths, seed):
    """Data of any lengths whose second observation element is the row number."""
    rng = np.random.default_rng(seed)
    lengths = np.array(lengths)
    starts = np.concatenate([[0], np.cumsum(lengths + 1)[:-1]])
    rows = int((lengths + 1).sum())
    rewards = rng.normal(size=rows).astype(np.float32)
    rewards[starts + lengths] = 0
    to_go = np.concatenate(
        [np.cumsum(rewards[s : s + n + 1][::-1])[::-1] for s, n in zip(starts, lengths, strict=True)]
    )
    per_episode = np.zeros(len(lengths), dtype=np.int64)
    return OfflineDataset(
        robot="Hopper",
        split="train",
        observations=np.stack([rng.normal(size=rows), np.arange(rows)], axis=1).astype(np.float32),
        actions=rng.normal(size=(rows, 1)).astype(np.float32),
        rewards=rewards,
        returns_to_go=to_go.astype(np.float32),
        episode_starts=starts,
        episode_lengths=lengths,
        episode_dynamics=per_episode,
        episode_snapshots=per_episode,
        episode_returns=to_go[starts].astype(np.float64),
        episode_seeds=per_episode,
        episode_terminated=per_episode.astype(np.bool_),
    )


@given(
    lengths=st.lists(st.integers(1, 9), min_size=1, max_size=6),
    context=st.integers(1, 12),
    seed=st.integers(0, 2**32 - 1),
)
def test_windows_of_any_data(lengths, context, seed):
    data = random_episodes(lengths, seed)
    sampler = WindowSampler(data, context, PLAIN)
    steps = np.arange(data.num_steps)
    windows = sampler.windows_at(steps)
    owner = np.repeat(np.arange(len(lengths)), lengths)
    for b in steps:
        mask = windows.mask[b]
        rows = windows.observations[b, :, 1].round().astype(int)[mask]
        start, length = data.episode_starts[owner[b]], lengths[owner[b]]
        first = b - sum(lengths[: owner[b]])
        size = min(context, length - first)
        # left padded, consecutive, inside one episode, from the asked step on
        np.testing.assert_array_equal(mask, np.arange(context) >= context - size)
        np.testing.assert_array_equal(rows, start + first + np.arange(size))
        np.testing.assert_array_equal(windows.timesteps[b, mask], first + np.arange(size))
        np.testing.assert_array_equal(windows.next_observations[b, mask, 1].round(), rows + 1)
        np.testing.assert_array_equal(windows.actions[b, mask], data.actions[rows])
        np.testing.assert_array_equal(windows.returns_to_go[b, mask], data.returns_to_go[rows])
        for array in windows[:5]:
            assert not array[b][~mask].any()


def test_fine_tuning_may_sample_test_data_with_train_normalisation():
    WindowSampler(three_step_episodes("test"), 4, three_step_episodes("train").normalization())


@pytest.mark.parametrize(
    ("data", "context", "message"),
    [
        (three_step_episodes(), 0, "context is 0: give a whole number from 1 on"),
        (
            dataclasses.replace(
                three_step_episodes(),
                **{f.name: getattr(three_step_episodes(), f.name)[:0] for f in dataclasses.fields(OfflineDataset)[2:]},
            ),
            4,
            "the train data of Hopper have no steps to sample",
        ),
    ],
)
def test_bad_arguments(data, context, message):
    with pytest.raises(ValueError, match=message):
        WindowSampler(data, context, PLAIN)


@pytest.mark.parametrize("size", [-1, 0, 1.5, None])
def test_a_batch_is_a_whole_number_of_windows(size):
    sampler = WindowSampler(three_step_episodes(), 2, PLAIN)
    with pytest.raises(ValueError, match=f"batch_size is {size!r}: give a whole number from 1 on"):
        sampler.sample(size, np.random.default_rng(0))


@pytest.mark.parametrize("context", [2.5, "20", True])
def test_a_context_is_a_whole_number(context):
    with pytest.raises(ValueError, match=f"context is {context!r}: give a whole number from 1 on"):
        WindowSampler(three_step_episodes(), context, PLAIN)


@pytest.mark.parametrize("step", [-1, 10**6])
def test_a_step_that_is_not_there_is_told(sampler, step):
    with pytest.raises(ValueError, match=rf"there is no step {step}: give numbers from 0 to \d+"):
        sampler.windows_at(np.array([0, step]))
