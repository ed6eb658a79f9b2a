"""Random actions and the data's own returns."""

import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.evaluation import Policy, RandomPolicy, RewardAware, action_space, baselines, data_returns, evaluate
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


def test_what_cannot_be_submitted_ends_in_one_line_before_any_evaluation(tiny_policies, monkeypatch):
    monkeypatch.setattr(baselines, "evaluate", None)
    for arguments, message in (
        (("random", ["Hoper"]), "did you mean 'Hopper'"),
        (("random", []), "5 runs on 0 robots"),
        (("random", ["Ant"], 0), "0 runs on 1 robots"),
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
