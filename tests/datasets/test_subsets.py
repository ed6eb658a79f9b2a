"""Parts of the data: which episodes they have, that they are views, and that all that reads episodes reads those."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench.datasets import Normalization, WindowSampler, load_dataset
from dynagen_bench.datasets.flat import load_adaptation
from dynagen_bench.datasets.subsets import spread_episodes, worst_episodes
from tests.tiny_data import three_step_episodes

returns_of_any_data = st.lists(st.integers(-5, 5).map(float), min_size=1, max_size=40).map(np.array)
"""Few different values, so that there are ties."""


def test_worst_episodes_by_hand():
    returns = np.array([5.0, 1.0, 3.0, 1.0, 9.0, 2.0])
    assert worst_episodes(returns, 0.5).tolist() == [1, 3, 5]
    assert worst_episodes(returns, 0.17).tolist() == [1]  # of the two that return 1 the earlier
    assert worst_episodes(returns, 0.001).tolist() == [1]
    assert worst_episodes(returns, 1).tolist() == [0, 1, 2, 3, 4, 5]


@given(returns=returns_of_any_data, quality=st.floats(0.001, 1))
def test_no_episode_left_out_is_worse_than_one_that_is_in(returns, quality):
    chosen = worst_episodes(returns, quality)
    left_out = np.delete(returns, chosen)
    assert len(chosen) == max(1, round(quality * len(returns)))
    assert (np.diff(chosen) > 0).all()
    assert returns[chosen].max() <= left_out.min(initial=np.inf)


def test_spread_episodes_by_hand():
    returns = np.array([50.0, 10.0, 40.0, 0.0, 30.0, 20.0])  # ranks 5, 1, 4, 0, 3, 2
    assert spread_episodes(returns, 1).tolist() == [4]  # rank 3
    assert spread_episodes(returns, 2).tolist() == [1, 2]  # ranks 1 and 4
    assert spread_episodes(returns, np.int64(2)).tolist() == [1, 2]
    assert spread_episodes(returns, 3).tolist() == [0, 1, 4]  # ranks 1, 3 and 5
    assert spread_episodes(np.arange(1000.0), 10).tolist() == list(range(50, 1000, 100))


@given(returns=returns_of_any_data, data=st.data())
def test_spread_episodes_are_as_far_apart_in_rank_as_can_be(returns, data):
    count = data.draw(st.integers(1, len(returns)))
    chosen = spread_episodes(returns, count)
    ranks = np.sort(np.argsort(np.argsort(returns, kind="stable"))[chosen])
    gap = len(returns) / count
    assert len(ranks) == count
    assert set(np.diff(ranks)) <= {math.floor(gap), math.ceil(gap)}
    for outer in (ranks[0] + 0.5, len(returns) - ranks[-1] - 0.5):  # half a gap to both ends
        assert abs(outer - gap / 2) <= 0.5


@pytest.mark.parametrize("quality", [0, -0.1, 1.1, True, "low", float("nan")])
def test_bad_quality(quality):
    with pytest.raises(ValueError, match="give a share of the episodes, above 0 and at most 1"):
        worst_episodes(np.zeros(4), quality)


@pytest.mark.parametrize("count", [0, 5, True, 2.0])
def test_bad_count(count):
    with pytest.raises(ValueError, match=r"^episodes is .*: give a whole number from 1 to 4$"):
        spread_episodes(np.zeros(4), count)


def test_low_quality_data_are_the_worst_episodes_of_all_train_dynamics_together(tiny_data):
    whole, low = load_dataset("Hopper"), load_dataset("Hopper", quality=0.3)
    assert len(low.episode_lengths) == round(0.3 * len(whole.episode_lengths)) == 72
    assert low.episode_returns.max() <= np.sort(whole.episode_returns)[71]
    kept = np.isin(whole.episode_seeds, low.episode_seeds)
    np.testing.assert_array_equal(low.episode_seeds, whole.episode_seeds[kept])  # in their old order
    assert low.num_steps == whole.episode_lengths[kept].sum()
    assert (whole.is_whole, low.is_whole) == (True, False)


def test_a_part_is_a_view_of_the_mapped_files(tiny_data):
    low = load_dataset("Hopper", quality=0.3)
    for field in ("observations", "actions", "rewards", "returns_to_go"):
        array = getattr(low, field)
        assert isinstance(array, np.memmap)
        assert not array.flags.writeable
        assert np.shares_memory(array, getattr(low.select(np.array([0])), field))


def test_a_part_is_normalised_by_its_own_episodes(tiny_data):
    low = load_dataset("Hopper", quality=0.3)
    acted_in = np.concatenate(
        [low.observations[s : s + n] for s, n in zip(low.episode_starts, low.episode_lengths, strict=True)]
    )
    normalization = low.normalization()
    np.testing.assert_allclose(normalization.mean, acted_in.mean(axis=0, dtype=np.float64), rtol=1e-6)
    np.testing.assert_allclose(normalization.std, acted_in.std(axis=0, dtype=np.float64), rtol=1e-6)


@given(
    episodes=st.permutations([0, 1]).flatmap(lambda order: st.sampled_from([order, order[:1]])),
    context=st.integers(1, 5),
)
def test_windows_of_a_part_are_those_of_the_whole(episodes, context):
    data = three_step_episodes()
    part = data.select(np.array(episodes))
    plain = Normalization(np.zeros(2, np.float32), np.ones(2, np.float32))
    first = {0: 0, 1: 3}  # the whole's step at which an episode begins
    steps = [first[number] + t for number in episodes for t in range(data.episode_lengths[number])]
    found = WindowSampler(part, context, plain).windows_at(np.arange(part.num_steps))
    expected = WindowSampler(data, context, plain).windows_at(np.array(steps))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_adaptation_set_is_of_one_test_dynamics_and_always_the_same(tiny_data):
    test = load_dataset("Hopper", "test")
    for index in range(5):
        chosen = load_adaptation("Hopper", index, episodes=4)
        assert (chosen.robot, chosen.split) == ("Hopper", "test")
        assert set(chosen.episode_dynamics) == {index}
        assert chosen.episode_seeds.tolist() == load_adaptation("Hopper", index, episodes=4).episode_seeds.tolist()
        # twelve episodes in four groups of three: of each the middle one
        ranked = np.sort(test.episode_returns[test.episode_dynamics == index])
        np.testing.assert_array_equal(np.sort(chosen.episode_returns), ranked[1::3])
    assert len(load_adaptation("Hopper", 0, episodes=12).episode_lengths) == 12


def test_train_dynamics_have_such_sets_too_by_the_same_rule(tiny_data):
    train = load_dataset("Hopper", "train")
    chosen = load_adaptation("Hopper", 19, split="train", episodes=4)
    assert (chosen.split, set(chosen.episode_dynamics)) == ("train", {19})
    ranked = np.sort(train.episode_returns[train.episode_dynamics == 19])
    np.testing.assert_array_equal(np.sort(chosen.episode_returns), ranked[1::3])


def test_an_adaptation_set_is_sampled_with_the_train_datas_normalisation(tiny_data):
    chosen = load_adaptation("Hopper", 2, episodes=3)
    sampler = WindowSampler(chosen, 4, load_dataset("Hopper").normalization())
    windows = sampler.sample(32, np.random.default_rng(0))
    rows = {tuple(row) for s, n in zip(chosen.episode_starts, chosen.episode_lengths, strict=True)
            for row in chosen.actions[s : s + n].tolist()}  # fmt: skip
    assert {tuple(row) for row in windows.actions[windows.mask].tolist()} <= rows
    with pytest.raises(ValueError, match="this is split 'test': normalisation is of train data"):
        chosen.normalization()


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (lambda: load_adaptation("Hopper", 5), "choose a whole number from 0 to 4"),
        (lambda: load_adaptation("Hopper", 0, split="nominal"), "there are no data of split 'nominal'"),
        (lambda: load_adaptation("Hoper", 0), "did you mean 'Hopper'"),
        (lambda: load_adaptation("Hopper", 0, episodes=13), "episodes is 13: give a whole number from 1 to 12"),
        (lambda: load_dataset("Hopper", "test", quality=0.3), "quality is of train data, not of split 'test'"),
        (lambda: load_dataset("Hopper", quality=0), "quality is 0: give a share"),
    ],
)
def test_bad_arguments(tiny_data, load, message):
    with pytest.raises(ValueError, match=message):
        load()


def test_episodes_that_share_rows_or_leave_them_are_refused():
    data = three_step_episodes()
    with pytest.raises(ValueError, match=r"episode 0 begins in row 0 and has 3 steps: .* shares some with another"):
        data.select(np.array([0, 1, 0]))
    for change, number in (
        ({"episode_starts": np.array([0, 3])}, 0),
        ({"episode_starts": np.array([-1, 4])}, 0),
        ({"episode_lengths": np.array([3, 3])}, 1),
        ({"episode_lengths": np.array([3, -1])}, 1),
        ({"episode_starts": np.array([4, 0])}, 0),
    ):
        with pytest.raises(ValueError, match=f"episode {number} begins in row .* leaves the 7 rows, or shares some"):
            dataclasses.replace(data, **change)


@pytest.mark.parametrize("number", [-1, 2])
def test_no_episode_is_taken_for_one_that_is_not_there(number):
    with pytest.raises(IndexError, match=f"^there is no episode {number}: the data have 2, numbered from 0$"):
        three_step_episodes().select(np.array([0, number]))
