"""Evaluation episodes: the bits of Gymnasium's own loop, each start once, and what a policy is and is not given."""

import hashlib

import gymnasium
import numpy as np
import pytest
import torch

from dynagen_bench import ids
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.evaluation import EPISODES, RandomPolicy, action_space, evaluate, reset_seeds, returns_in


class Constant:
    """The ten-line policy of the documentation: no class of ours, one method."""

    def __init__(self, robot, value) -> None:
        self.action = np.full(action_space(robot).shape, value)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.tile(self.action, (len(observation), 1)), state


class Recorder(Constant):
    """Writes down everything it is given."""

    def __init__(self, robot="Hopper", value=0.3) -> None:
        super().__init__(robot, value)
        self.observations, self.starts, self.states, self.deterministic, self.rewards = [], [], [], [], []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.observations.append(observation.copy())
        self.starts.append(episode_start.copy())
        self.states.append(state)
        self.deterministic.append(deterministic)
        observation[:] = np.nan  # what is given belongs to the policy: this must change nothing
        return super().predict(observation)[0], (state or 0) + 1

    def observe(self, rewards):
        self.rewards.append(rewards)


def plain_episode(env_id, seed, action, **options):
    """Return and length of an episode as Gymnasium's users write it."""
    environment = gymnasium.make(env_id, **options)
    environment.reset(seed=seed)
    total, steps, done = 0.0, 0, False
    while not done:
        _, reward, terminated, truncated, _ = environment.step(action)
        total, steps, done = total + reward, steps + 1, terminated or truncated
    environment.close()
    return total, steps


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_returns_are_those_of_a_plain_gymnasium_loop_bit_for_bit(robot):
    policy = Constant(robot, 0.3)
    found = evaluate(policy, robot, indices=(0, 3), episodes=2)
    for row, index in enumerate(found.indices):
        for episode in range(2):
            seed = int(found.seeds[row, episode])
            expected = plain_episode(f"{robot}-RandDyn-test{index}", seed, policy.action.astype(np.float32))
            assert (found.returns[row, episode], found.lengths[row, episode]) == expected


def test_every_dynamics_and_seed_is_visited_once():
    policy = Recorder()
    found = evaluate(policy, "Hopper")
    assert found.indices == (0, 1, 2, 3, 4)
    assert found.returns.shape == found.lengths.shape == found.seeds.shape == (5, EPISODES)
    assert len(np.unique(found.seeds)) == found.seeds.size
    first = policy.observations[0].reshape(5, EPISODES, -1)
    for index in found.indices:
        environment = gymnasium.make(f"Hopper-RandDyn-test{index}")
        for episode in range(EPISODES):
            np.testing.assert_array_equal(
                environment.reset(seed=int(found.seeds[index, episode]))[0], first[index, episode]
            )


def test_official_reset_seeds_are_frozen():
    # Scores are comparable only while all start in the same states: never change this hash.
    everything = np.concatenate([reset_seeds(robot, "test", range(5)).ravel() for robot in ids.ROBOTS])
    assert reset_seeds("Hopper", "test", [0], 3).tolist() == [[201525830, 135624621, 1216510725]]
    digest = hashlib.sha256(everything.astype("<i8").tobytes()).hexdigest()
    assert digest == "6d5853db73b33cbbded9226d899ddbe734469102b7649a6d3ae7d496df595391"
    assert len(np.unique(everything)) == everything.size
    assert everything.min() >= 0
    assert everything.max() < 2**31


def test_a_seed_is_a_function_of_its_names_alone():
    whole = reset_seeds("Ant", "train", range(20), 7)
    np.testing.assert_array_equal(reset_seeds("Ant", "train", [5, 2], 3), whole[[5, 2], :3])
    for other in (reset_seeds("Ant", "train", range(20), 7, seed=1), reset_seeds("Walker", "train", range(20), 7)):
        assert not np.intersect1d(other, whole).size
    assert not np.intersect1d(reset_seeds("Ant", "test", range(5), 7), whole).size


def test_an_episode_does_not_depend_on_the_others_of_its_batch():
    whole = evaluate(Constant("Hopper", 0.3), "Hopper", episodes=3)
    part = evaluate(Constant("Hopper", 0.3), "Hopper", indices=[4, 1], episodes=2)
    np.testing.assert_array_equal(part.returns, whole.returns[[4, 1], :2])
    np.testing.assert_array_equal(part.lengths, whole.lengths[[4, 1], :2])


def test_what_a_policy_is_given():
    policy = Recorder()
    found = evaluate(policy, "Hopper", episodes=2)
    lengths, steps = found.lengths.ravel(), found.lengths.max()
    assert len(set(lengths)) > 1  # lanes end at different steps, or this test shows nothing
    assert len(policy.observations) == len(policy.rewards) == steps
    assert all(given.shape == (10, 11) and given.dtype == np.float64 for given in policy.observations)
    assert policy.starts[0].all()
    assert not np.any(policy.starts[1:])
    assert policy.states == [None, *range(1, steps)]
    assert all(policy.deterministic)
    np.testing.assert_array_equal(sequential_sum(policy.rewards), found.returns.ravel())
    for lane, length in enumerate(lengths):
        after = [rewards[lane] for rewards in policy.rewards[length:]]
        frozen = [given[lane] for given in policy.observations[length:]]
        assert not np.any(after)
        assert all(np.array_equal(row, frozen[0]) for row in frozen)


def sequential_sum(rewards):
    total = np.zeros_like(rewards[0])
    for step in rewards:
        total = total + step
    return total


def test_a_stable_baselines3_model_is_a_policy_as_it_is(torch_on_one_thread):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    environment = gymnasium.make("Hopper-RandDyn-train0")
    model = stable_baselines3.PPO("MlpPolicy", environment, n_steps=8, batch_size=8, device="cpu")
    first = evaluate(model, "Hopper", episodes=2)
    again = evaluate(model, "Hopper", episodes=2)
    np.testing.assert_array_equal(first.returns, again.returns)
    assert first.lengths.min() >= 1


@pytest.mark.parametrize("split", ["train", "nominal"])
def test_other_splits_can_be_evaluated_too(split):
    found = evaluate(RandomPolicy("Walker"), "Walker", split, episodes=1)
    assert found.labels[0] == {"train": "train0", "nominal": "nominal"}[split]
    assert len(found.indices) == ids.SPLIT_SIZES[split]


class Gives(Constant):
    """Answers what it was made with."""

    def __init__(self, actions) -> None:
        self.actions = actions

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.actions, state


def one_bad_row(value):
    actions = np.zeros((5, 3))
    actions[3, 1] = value
    return actions


def test_a_predict_of_another_form_is_told_before_anything_runs():
    class OfAnotherLibrary:
        def predict(self, x):
            return x

    with pytest.raises(
        TypeError, match=r"^OfAnotherLibrary\.predict\(x\) cannot be called as predict\(observation, "
    ) as no:
        evaluate(OfAnotherLibrary(), "Hopper", episodes=1)
    assert "\n" not in str(no.value)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (one_bad_row(np.nan), r"step 0: the policy's action in row 3 is not finite: \[ 0. nan  0.\]"),
        (one_bad_row(-np.inf), "row 3 is not finite"),
        (one_bad_row(1e300), "row 3 is not finite"),
        (np.zeros((5, 4)), r"shape \(5, 4\) .* it must give numbers of shape \(5, 3\)"),
        (np.zeros(3), r"shape \(3,\)"),
        (np.full((5, 3), "left"), "type <U4"),
        (None, "type object"),
        (
            [[0.0] * 3] * 4 + [[0.0]],
            r"step 0: the policy's actions are no array \(.*\), it must give numbers of shape \(5, 3\)",
        ),
        (torch.zeros((5, 3), requires_grad=True), r"are no array \(Can't call numpy\(\) on Tensor that requires grad"),
    ],
)
def test_bad_actions_end_in_one_line_and_reach_no_physics(actions, message):
    with pytest.raises(ValueError, match=message) as caught:
        evaluate(Gives(actions), "Hopper", episodes=1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("answer", "form"),
    [
        (np.zeros((5, 3)), "one ndarray"),
        (np.zeros((2, 3)), "one ndarray"),
        ((np.zeros((5, 3)), None, None), "3 values"),
        (None, "one NoneType"),
    ],
)
def test_an_answer_that_is_not_actions_and_state_is_told_in_one_line(answer, form):
    class Odd:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return answer

    with pytest.raises(ValueError, match=rf"step 0: predict gave {form}: it must return two, \(actions, state\)"):
        evaluate(Odd(), "Hopper", episodes=1)


@pytest.mark.parametrize(
    ("robot", "arguments", "message"),
    [
        ("Hoper", {}, "did you mean 'Hopper'"),
        ("Hopper", {"split": "tset"}, "unknown split 'tset'"),
        ("Hopper", {"indices": [5]}, "whole number from 0 to 4"),
        ("Hopper", {"indices": [1, 1]}, "one twice"),
        ("Hopper", {"indices": []}, "name no dynamics"),
        *[
            ("Hopper", {"episodes": given}, rf"^episodes is {given!r}: give a whole number from 1 on")
            for given in (0, 2.5, "2", True, None)
        ],
        *[
            ("Hopper", {"seed": given}, rf"^seed is {given!r}: give a whole number from 0 on$")
            for given in (-1, 2.5, "2", True, None)
        ],
    ],
)
def test_bad_arguments_end_in_one_line(robot, arguments, message):
    with pytest.raises(ValueError, match=message) as caught:
        evaluate(Constant("Hopper", 0.0), robot, **arguments)
    assert "\n" not in str(caught.value)


def test_returns_in_bodies_of_ones_own_are_those_of_a_plain_loop():
    bodies = [{}, {"body_mass": {"torso": 2.0}}, load_dynamics("Hopper", "test", 3).to_json()]
    policy = Constant("Hopper", 0.3)
    found = returns_in(policy, "Hopper", bodies, episodes=2)
    assert (found.shape, found.dtype) == ((3, 2), np.float64)
    np.testing.assert_array_equal(found[0], evaluate(policy, "Hopper", "nominal", episodes=2).returns[0])
    for row, body in zip(found, bodies, strict=True):
        seeds = reset_seeds("Hopper", "nominal", [0], episodes=2)[0]  # of every body: nothing but the body differs
        action = policy.action.astype(np.float32)
        plain = [plain_episode("Hopper-RandDyn-v0", int(seed), action, dynamics=body)[0] for seed in seeds]
        np.testing.assert_array_equal(row, plain)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([], r"^dynamics is \[\]: give a list of bodies"),
        ({"body_mass": {"torso": 2.0}}, "give a list of bodies"),
        ([{"body_mass": {"torsoo": 2.0}}], "torsoo"),
        ([{"mass": {"torso": 2.0}}], "unknown dynamics parameter"),
    ],
)
def test_bodies_that_are_none_end_in_one_line(bodies, message):
    with pytest.raises(ValueError, match=message) as caught:
        returns_in(Constant("Hopper", 0.3), "Hopper", bodies)
    assert "\n" not in str(caught.value)


def test_numpys_whole_numbers_are_taken_as_plain_ones_are():
    plain = reset_seeds("Hopper", "test", [0], 3, seed=5)
    np.testing.assert_array_equal(reset_seeds("Hopper", "test", [0], np.int64(3), seed=np.int32(5)), plain)


def test_the_progress_bar_is_on_the_error_stream(capsys):
    evaluate(RandomPolicy("Hopper", 0), "Hopper", indices=[0], episodes=1, progress=True)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "evaluating in Hopper test" in shown.err


def test_an_object_without_predict_is_refused():
    with pytest.raises(TypeError, match=r"function has no method predict"):
        evaluate(lambda observation: observation, "Hopper")
