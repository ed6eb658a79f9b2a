"""Whose actions are shown: those of the data, where a behaviour policy acts."""

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.collection.episodes import roll_out
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.evaluation import evaluate
from dynagen_bench.pictures.actors import Actor, choose_actor, given_actor, smooth_actions, stored_snapshots

NAME = ids.make_id("Hopper", "test", 3)
LIMIT = np.ones(3)


def played(actor: Actor, seed: int) -> list[float]:
    """Rewards of one episode in `NAME`."""
    act = actor.start(seed)
    env = gymnasium.make(NAME.env_id)
    observation, _ = env.reset(seed=seed)
    rewards, over = [], False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(
            act(observation, len(rewards), rewards[-1] if rewards else 0.0)
        )
        rewards.append(reward)
        over = terminated or truncated
    return rewards


def test_a_snapshot_acts_as_it_made_the_data(tiny_policies):
    physics = BatchPhysics("Hopper", [load_dynamics("Hopper", "test", 3)] * 2)
    episodes = roll_out(physics, stored_snapshots(NAME, tiny_policies)[300], 300, [5, 6])
    assert played(choose_actor("300", NAME, LIMIT, tiny_policies), 6) == episodes[1].rewards.tolist()


def test_the_best_is_the_snapshot_that_the_leaderboards_reference_acts_with():
    name = ids.make_id("Hopper", "test", 0)
    assert choose_actor("best", name, LIMIT).label == "policy of test0, 900K"  # with noise 1M returns more


class Counting:
    """Acts by a state that it is given back, by its last reward, and by whether an episode begins."""

    def __init__(self) -> None:
        self.rewards = np.zeros(1)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        state = np.where(episode_start, 0, 0 if state is None else state) + 1
        if episode_start.all():
            self.rewards = np.zeros(len(observation))
        return np.sin(np.stack([state, observation[:, 1], self.rewards], axis=1)).astype(np.float32), state

    def observe(self, rewards):
        self.rewards = rewards


def test_a_policy_of_ones_own_acts_as_it_is_scored():
    found = evaluate(Counting(), "Hopper", indices=[3], episodes=2)
    for seed, expected in zip(found.seeds[0].tolist(), found.returns[0], strict=True):
        assert sum(played(given_actor(Counting()), seed)) == pytest.approx(expected, abs=1e-9)
    assert given_actor(Counting()).label == "Counting"


def test_zero_and_random_need_no_policies(tmp_path):
    assert not choose_actor("zero", NAME, LIMIT, tmp_path).start(0)(np.zeros(11), 0, 0.0).any()
    first, again, other = (choose_actor("random", NAME, LIMIT, tmp_path).start(seed) for seed in (1, 1, 2))
    assert np.array_equal(first(np.zeros(11), 7, 0.0), again(np.ones(11), 7, 1.0))
    assert not np.array_equal(first(np.zeros(11), 7, 0.0), other(np.zeros(11), 7, 0.0))
    assert not np.array_equal(first(np.zeros(11), 7, 0.0), first(np.zeros(11), 8, 0.0))


@pytest.mark.parametrize(
    ("policy", "name", "error", "message"),
    [
        ("good", NAME, ValueError, "unknown policy 'good': write best, random, zero"),
        ("250", NAME, ValueError, "choose best or one of 100, 200, 300, 400"),
        (
            "best",
            ids.make_id("Ant", "test", 0),
            FileNotFoundError,
            "dynagen collect Ant test0.*--policy random or zero",
        ),
        ("best", ids.make_id("Hopper", "nominal", 0), FileNotFoundError, "--policy-of train0"),
    ],
)
def test_a_mistake_says_what_to_do(tiny_policies, policy, name, error, message):
    with pytest.raises(error, match=message) as said:
        choose_actor(policy, name, LIMIT, tiny_policies)
    assert "\n" not in str(said.value)


@given(seed=st.integers(0, 2**32), actuators=st.integers(1, 20))
def test_swinging_actions_are_small_and_of_the_seed(seed, actuators):
    limit = np.linspace(0.4, 1.0, actuators)
    actions = smooth_actions(seed, limit, 0.01)
    assert actions.shape == (HORIZON, actuators)
    assert (np.abs(actions) <= 0.25 * limit + 1e-6).all()
    assert np.ptp(actions, axis=0).min() > 0
    assert np.array_equal(actions, smooth_actions(seed, limit, 0.01))
