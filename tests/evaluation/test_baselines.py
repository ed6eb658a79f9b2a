"""Random actions and the data's own returns."""

import gymnasium
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.collection.episodes import action_noise
from dynagen_bench.collection.policies import load_policies, policy_file
from dynagen_bench.evaluation import (
    EPISODES,
    Policy,
    RandomPolicy,
    RewardAware,
    action_space,
    baselines,
    data_returns,
    evaluate,
    reset_seeds,
)
from dynagen_bench.evaluation.baselines import baseline_submission
from dynagen_bench.evaluation.submission import read_submission, read_traces, write_submission


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_random_actions_fill_the_action_space(robot):
    space = action_space(robot)
    actions, state = RandomPolicy(robot).predict(np.zeros((500, 3)), state="kept")
    assert state == "kept"
    assert actions.shape == (500, *space.shape)
    assert actions.dtype == np.float32
    assert all(space.contains(action) for action in actions)
    assert (actions.max(axis=0) > 0.9 * space.high).all()
    assert (actions.min(axis=0) < 0.9 * space.low).all()


def test_the_seed_makes_random_actions_repeatable():
    first = evaluate(RandomPolicy("Hopper", seed=1), "Hopper", episodes=2)
    again = evaluate(RandomPolicy("Hopper", seed=1), "Hopper", episodes=2)
    other = evaluate(RandomPolicy("Hopper", seed=2), "Hopper", episodes=2)
    np.testing.assert_array_equal(first.returns, again.returns)
    assert not np.array_equal(first.returns, other.returns)
    np.testing.assert_array_equal(first.seeds, other.seeds)


def test_the_protocols_tell_policies_from_what_is_none():
    assert isinstance(RandomPolicy("Hopper"), Policy)
    assert not isinstance(RandomPolicy("Hopper"), RewardAware)
    assert not isinstance(object(), Policy)


def test_data_returns_are_the_test_references(references):
    assert data_returns("Ant") == {"test0": 50.0, "test1": 51.0, "test2": 52.0, "test3": 53.0, "test4": 54.0}


def test_the_random_policy_is_submitted_as_an_entry_like_any_other(tmp_path):
    submission, traces = baseline_submission("random", ["Hopper"], runs=2)
    assert [run.seed for run in submission.runs] == [0, 1]
    assert submission.runs[0].evaluation != submission.runs[1].evaluation
    assert submission.privileged == "none"
    assert submission.commands == ["dynagen baseline Hopper --output my-entry --runs 2"]
    again, _ = baseline_submission("random", ["Hopper"], runs=2)
    assert again == submission  # its hashes of the traces, too
    write_submission(tmp_path, submission, traces)
    assert read_submission(tmp_path) == submission
    assert read_traces(tmp_path, submission.runs[1]).sha256 == submission.runs[1].trace


def test_no_action_at_all_is_submitted_once():
    submission, traces = baseline_submission("zero", ["Hopper"])
    assert [run.seed for run in submission.runs] == [0]
    assert not traces[0].actions.any()
    assert submission.privileged == "none"
    assert submission.commands == ["dynagen baseline Hopper --output my-entry --policy zero"]
    # upright is paid, and the noise of a start alone does not throw it over at once
    assert submission.runs[0].evaluation.evaluation().returns.min() > 20


@pytest.mark.parametrize("policy", ["behaviour", "expert"])
def test_behaviour_policies_are_submitted_as_privileged_references(policy, tiny_policies):
    submission, traces = baseline_submission(policy, ["Hopper"], runs=2, folder=tiny_policies)
    assert submission.privileged == "test-dynamics"
    assert [run.trace for run in submission.runs] == [one.sha256 for one in traces]
    assert len(submission.runs) == (2 if policy == "behaviour" else 1)  # the best ones act without any noise


class Stored:
    """One stored policy in every row, without noise."""

    def __init__(self, policy) -> None:
        self.policy = policy

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.policy.act(observation, np.ones(3), None).astype(np.float32), state


def test_an_expert_is_the_best_snapshot_of_its_own_dynamics_chosen_by_other_episodes(tiny_policies):
    (run,) = baseline_submission("expert", ["Hopper"], folder=tiny_policies)[0].runs
    for index in (1, 4):
        stored = list(load_policies(policy_file(ids.make_id("Hopper", "test", index), tiny_policies))[0].values())
        episodes = EPISODES * len(stored)
        trials = [evaluate(Stored(x), "Hopper", indices=[index], episodes=episodes, seed=1).returns[0] for x in stored]
        means = [trial[EPISODES * i : EPISODES * (i + 1)].mean() for i, trial in enumerate(trials)]
        expected = evaluate(Stored(stored[int(np.argmax(means))]), "Hopper", indices=[index])
        assert run.evaluation.returns[index] == expected.returns[0].tolist()


@pytest.mark.parametrize("seed", [0, 1])
def test_behaviour_policies_act_in_their_own_dynamics_with_the_noise_of_the_data(seed, tiny_policies):
    run = baseline_submission("behaviour", ["Hopper"], runs=2, folder=tiny_policies)[0].runs[seed]
    for index, episode in ((0, 0), (3, 7), (4, 9)):
        snapshots = load_policies(policy_file(ids.make_id("Hopper", "test", index), tiny_policies))[0]
        policy = list(snapshots.values())[(episode * 4 // 10 + seed) % 4]
        noise = action_noise(int(reset_seeds("Hopper", "test", [index], seed=1 + seed)[0, episode]), 3)
        env = gymnasium.make(f"Hopper-RandDyn-test{index}")
        observation, _ = env.reset(seed=run.evaluation.seeds[index][episode])
        total, step, done = 0.0, 0, False
        while not done:
            action = policy.act(observation[None], np.ones(3), noise[step : step + 1])[0].astype(np.float32)
            observation, reward, terminated, truncated, _ = env.step(action)
            total, step, done = total + reward, step + 1, terminated or truncated
        assert run.evaluation.returns[index][episode] == total


def test_what_cannot_be_submitted_ends_in_one_line_before_any_evaluation(tiny_policies, monkeypatch):
    monkeypatch.setattr(baselines, "evaluate", None)
    for arguments, message in (
        (("random", ["Hoper"]), "did you mean 'Hopper'"),
        (("random", []), "no robot is given: name one or more of Walker, "),
        (("random", ["Ant"], 1.5), "runs is 1.5: give a whole number from 1 on"),
        (("random", ["Ant"], 0), "runs is 0: give a whole number from 1 on"),
        (("random", ["Hopper", "Hoper"]), "did you mean 'Hopper'"),
        (("random", ["Hopper", "Ant", "Hopper"], 1), "a robot is named twice in Hopper Ant Hopper: name each once"),
        (("random", ["Hopper"], 101), "101 runs asked for: give at most 100, all robots together"),
        (("behaviour", ["Hopper", "Ant"], 51), "102 runs asked for"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            baseline_submission(*arguments)
        assert "\n" not in str(caught.value)
    for policy in ("behaviour", "expert"):  # the tiny policies are Hopper's alone
        with pytest.raises(FileNotFoundError, match="no behaviour policies at"):
            baseline_submission(policy, ["Hopper", "Ant"], folder=tiny_policies)
