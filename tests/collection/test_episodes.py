"""Episodes of stored policies: functions of (dynamics, policy, seed), the bits of the environment that a user makes."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding

from dynagen_bench import ids
from dynagen_bench.collection.episodes import action_noise, collect_episodes, reset_seed, roll_out
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from tests.tiny_data import random_policy


def tiny_snapshots(robot, count=2):
    rng = np.random.default_rng(3)
    return {100 * (i + 1): random_policy(robot, rng) for i in range(count)}


def states_on_the_way(name, episode):
    """Replay an episode in the single environment: states (T + 1, nq), (T + 1, nv), and what each step gave."""
    env = gymnasium.make(name.env_id)
    first, _ = env.reset(seed=episode.seed)
    np.testing.assert_array_equal(first, episode.observations[0])
    data = env.unwrapped.data
    states, steps = [(data.qpos.copy(), data.qvel.copy())], []
    for action in episode.actions:
        steps.append(env.step(action)[:4])
        states.append((data.qpos.copy(), data.qvel.copy()))
    env.close()
    qpos, qvel = (np.stack(part) for part in zip(*states, strict=True))
    return qpos, qvel, steps


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_seed_and_actions_replay_an_episode_bit_for_bit(robot):
    name = ids.make_id(robot, "test", 3)
    for episode in collect_episodes(name, tiny_snapshots(robot), 2):
        _, _, steps = states_on_the_way(name, episode)
        observations, rewards, terminated, truncated = zip(*steps, strict=True)
        np.testing.assert_array_equal(observations, episode.observations[1:])
        np.testing.assert_array_equal(rewards, episode.rewards)
        assert not any(terminated[:-1])
        assert not any(truncated[:-1])
        assert (terminated[-1], truncated[-1]) == (episode.terminated, episode.truncated)
        assert episode.terminated or episode.truncated


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_step_from_any_stored_state_gives_the_next_one_in_any_order(robot):
    name = ids.make_id(robot, "train", 1)
    episode = next(collect_episodes(name, tiny_snapshots(robot, 1), 1))
    qpos, qvel, _ = states_on_the_way(name, episode)
    lanes = 3
    physics = BatchPhysics(robot, [load_dynamics(robot, "train", 1)] * lanes, threads=2)
    order = np.random.default_rng(0).permutation(len(episode))
    for some in np.array_split(order, -(-len(order) // lanes)):
        rows = np.arange(len(some))
        physics.qpos[rows], physics.qvel[rows] = qpos[some], qvel[some]
        result = physics.step(episode.actions[some], rows)
        np.testing.assert_array_equal(physics.qpos[rows], qpos[some + 1])
        np.testing.assert_array_equal(physics.qvel[rows], qvel[some + 1])
        np.testing.assert_array_equal(result.observations, episode.observations[some + 1])
        np.testing.assert_array_equal(result.rewards, episode.rewards[some])
        np.testing.assert_array_equal(result.terminated, (some == len(episode) - 1) & episode.terminated)


def test_an_episode_does_not_depend_on_the_batch_it_ran_in():
    name = ids.make_id("Hopper", "train", 4)
    snapshots = tiny_snapshots("Hopper", 3)
    many = list(collect_episodes(name, snapshots, 6, threads=2))
    alone = list(collect_episodes(name, {200: snapshots[200]}, 2, threads=1))
    assert [e.snapshot for e in many] == [100] * 6 + [200] * 6 + [300] * 6
    for one, other in zip(alone, many[6:8], strict=True):
        assert (one.seed, one.terminated, one.policy_hash) == (other.seed, other.terminated, other.policy_hash)
        np.testing.assert_array_equal(one.observations, other.observations)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_actions_are_the_stored_policys_on_the_grid_and_inside_the_space():
    name = ids.make_id("SlimHumanoid", "test", 0)
    snapshots = tiny_snapshots("SlimHumanoid", 1)
    episode = next(collect_episodes(name, snapshots, 1))
    assert episode.actions.dtype == np.float32
    assert episode.truncated
    assert len(episode.observations) == HORIZON + 1
    np.testing.assert_array_equal(np.round(episode.actions * 2.0**12), episode.actions * 2.0**12)
    assert (np.abs(episode.actions) <= 0.4).all()
    noise = action_noise(episode.seed, 17)
    expected = snapshots[100].act(episode.observations[5:6], np.full(17, 0.4), noise[5:6])
    np.testing.assert_array_equal(expected[0], episode.actions[5])


def test_seeds_are_frozen_31_bit_and_differ():
    seeds = {
        reset_seed(name, snapshot, episode)
        for name in ids.dynamics_ids("Hopper", ("test",))
        for snapshot in (50_000, 100_000)
        for episode in range(50)
    }
    assert len(seeds) == 500
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert reset_seed(ids.make_id("Hopper", "test", 3), 50_000, 0) == PINNED_SEED


PINNED_SEED = 275158975
"""Written down when v0 was made: the data of every user are drawn from it."""


def test_action_noise_is_not_the_resets_stream():
    noise = action_noise(7, 3)
    assert noise.shape == (HORIZON, 3)
    assert abs(noise.mean()) < 0.1
    assert abs(noise.std() - 1) < 0.1
    assert not np.isin(noise, seeding.np_random(7)[0].standard_normal(1000)).any()
    np.testing.assert_array_equal(noise, action_noise(7, 3))


class Flung(BatchPhysics):
    """Simulation 1 starts at a velocity that MuJoCo gives up at."""

    def start(self, simulations, rngs):
        observations = super().start(simulations, rngs)
        self.qvel[1, 3] = 1e12
        return observations


def test_an_unstable_episode_is_never_returned(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where the process stands
    physics = Flung("Hopper", [load_dynamics("Hopper", "test", 0)] * 3, threads=1)
    policy = random_policy("Hopper", np.random.default_rng(0))
    with pytest.raises(RuntimeError, match=r"bad state at step 0 of the episode of reset seed 6, snapshot 100"):
        roll_out(physics, policy, 100, [5, 6, 7])


@pytest.mark.parametrize("given", [0, 1.5, True])
def test_no_number_of_episodes_is_refused(given):
    with pytest.raises(ValueError, match=f"^episodes_per_snapshot is {given}: give a whole number from 1 on$"):
        next(collect_episodes(ids.make_id("Hopper", "train", 0), tiny_snapshots("Hopper", 1), given))
