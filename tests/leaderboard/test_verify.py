"""Replays: honest submissions to the last bit, other arithmetic within the tolerance, and what is said of each."""

import dataclasses
import os

import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.evaluation import RandomPolicy, evaluate
from dynagen_bench.evaluation.submission import FILE_NAME, Run, write_submission
from dynagen_bench.evaluation.traces import INTERVAL, Traces, physics_digest
from leaderboard.__main__ import main
from leaderboard.board import BOARD, submit, verify_entries
from leaderboard.entries import FOLDER, VERDICT, read_official
from leaderboard.verify import TOLERANCE, _differences, label_of, verify
from leaderboard.verify_replay import replay
from tests.evaluation.samples import submission, traced, with_other_arithmetic


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_robot_is_replayed_to_the_last_bit(robot):
    found = evaluate(RandomPolicy(robot), robot, indices=(3, 0), episodes=2)
    again = replay(found, found.traces)
    np.testing.assert_array_equal(again.starts, again.first_states)
    np.testing.assert_array_equal(again.ends, again.stored_ends)
    assert again.returns.tolist() == found.returns.ravel().tolist()
    lengths = found.lengths.ravel()
    assert len(again.ends) == sum(-(-lengths // INTERVAL))
    ends = again.terminated[np.arange(4), lengths - 1]
    assert (ends | (lengths == 200)).all()
    assert again.terminated.sum() == ends.sum()


class Wild:
    """Actions near float32's largest, one way and the other; the actuators clip them."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        step = state or 0
        return np.tile(np.where(np.arange(3) % 2 == step % 2, 3e38, -3e38), (len(observation), 1)), step + 1


def test_actions_far_outside_the_range_are_replayed_too():
    found = evaluate(Wild(), "Hopper", episodes=2)
    again = replay(found, found.traces)
    np.testing.assert_array_equal(again.ends, again.stored_ends)
    assert again.returns.tolist() == found.returns.ravel().tolist()


def test_an_honest_submission_is_replayed(tmp_path):
    made = traced(tmp_path, robots=("Walker", "Hopper"))
    checks = verify(tmp_path, made)
    assert [check.run for check in checks] == made.runs
    assert label_of(checks) == "replayed"
    assert not any(check.faults for check in checks)
    for check in checks:
        claimed = check.run.evaluation.evaluation()
        assert check.returns.tolist() == claimed.returns.tolist()
        assert check.transitions == claimed.lengths.sum()


def with_states(found, change):
    """The run of an evaluation whose stored states, but the first of each episode, are changed, on other arithmetic."""
    states = found.traces.states.copy()
    first = np.cumsum([0, *(-(-found.lengths.ravel() // INTERVAL) + 1)[:-1]])
    later = np.setdiff1d(np.arange(len(states)), first)
    states[later] += change
    other = dataclasses.replace(
        found, physics="0" * 16, traces=Traces(found.traces.lengths, found.traces.actions, states)
    )
    return other, submission().model_copy(
        update={"format_version": 2, "runs": [Run.from_evaluation(other, seed=0, gradient_steps=0)]}
    )


@pytest.mark.parametrize(
    ("change", "label", "faults"),
    [(0.0, "replayed", 0), (1e-9, "replayed (tolerance)", 0), (1e-4, "self-reported", 20)],
)
def test_other_arithmetic_is_told_by_its_label(tmp_path, change, label, faults):
    other, made = with_states(evaluate(RandomPolicy("Hopper"), "Hopper"), change)
    write_submission(tmp_path, made, [other.traces])
    (check,) = verify(tmp_path, made)
    assert check.label == label
    assert len(check.faults) == (faults + 1 if faults else 0)  # the last line says how many more


def test_the_tolerance_by_hand():
    assert TOLERANCE == 1e-5  # docs/submissions.md tells it
    found = np.array([[1.0, 0.0], [-99.0, 0.0], [0.0, 0.0]])
    stored = found + np.array([[1.9e-5, 0.0], [9.9e-4, 0.0], [0.0, 0.9e-5]])
    assert _differences(stored, found, TOLERANCE).tolist() == [0.0, 0.0, 0.0]
    stored = found + np.array([[2.1e-5, 0.0], [1.1e-3, 0.0], [0.0, 1.1e-5]])
    assert _differences(stored, found, TOLERANCE) == pytest.approx([2.1e-5, 1.1e-3, 1.1e-5])
    assert _differences(np.array([[np.nan, 0.0]]), np.zeros((1, 2)), TOLERANCE).tolist() == [np.inf]


@pytest.mark.parametrize(("more", "faults"), [(1e-3, 0), (5e-3, 21)])
def test_other_arithmetic_buys_no_return(tmp_path, more, faults):
    other, _ = with_states(evaluate(RandomPolicy("Hopper"), "Hopper"), 0.0)
    claimed = dataclasses.replace(other, returns=other.returns + more)  # 1e-5 · (200 + R) is 2e-3 and little more
    made = submission().model_copy(
        update={"format_version": 2, "runs": [Run.from_evaluation(claimed, seed=0, gradient_steps=0)]}
    )
    write_submission(tmp_path, made, [claimed.traces])
    (check,) = verify(tmp_path, made)
    assert len(check.faults) == faults


@pytest.mark.parametrize("robot", ["SlimHumanoid", "Ant"])  # the others' official data are rebuilt
def test_committed_episodes_are_still_what_their_seeds_and_actions_give(robot):
    place = BOARD / FOLDER / "random-policy-zero-shot-last"
    made = read_official(place)
    run = next(run for run in made.runs if run.robot == robot)
    (check,) = verify(place, made.model_copy(update={"runs": [run]}))
    assert not check.faults
    assert check.label in ("replayed", "replayed (tolerance)")


def test_the_same_arithmetic_is_given_no_tolerance(tmp_path):
    other, made = with_states(evaluate(RandomPolicy("Hopper"), "Hopper"), 1e-12)
    same = dataclasses.replace(other, physics=evaluate(RandomPolicy("Hopper"), "Hopper").physics)
    made = made.model_copy(update={"runs": [Run.from_evaluation(same, seed=0, gradient_steps=0)]})
    write_submission(tmp_path, made, [same.traces])
    (check,) = verify(tmp_path, made)
    assert len(check.faults) == 21
    assert "steps 0 to 9 end elsewhere, off by 1e-12" in check.faults[0]


def test_the_board_keeps_the_returns_of_its_own_replay(tmp_path, board):
    other, _ = with_states(evaluate(RandomPolicy("Hopper"), "Hopper"), 1e-9)
    claimed = dataclasses.replace(other, returns=other.returns + 1e-4)
    made = submission().model_copy(
        update={"format_version": 2, "runs": [Run.from_evaluation(claimed, seed=0, gradient_steps=0)]}
    )
    write_submission(tmp_path / "mine", made, [claimed.traces])
    entry = submit(tmp_path / "mine", board)
    assert entry.label == "replayed (tolerance)"
    assert np.abs(entry.submission.runs[0].evaluation.evaluation().returns - other.returns).max() < 1e-6


def test_commands_end_in_a_table_or_a_line_a_fault(tmp_path, board, capsys):
    made = traced(tmp_path / "mine")
    assert main(["verify", str(tmp_path / "mine")]) == 0
    out = capsys.readouterr().out
    assert "replayed" in out
    assert f"{made.runs[0].evaluation.evaluation().score:.2f}" in out
    write_submission(tmp_path / "first", submission())
    assert main(["verify", str(tmp_path / "first")]) == 0
    assert "self-reported" in capsys.readouterr().out
    (tmp_path / "mine" / made.runs[0].trace_name).unlink()
    assert main(["verify", str(tmp_path / "mine")]) == 2
    captured = capsys.readouterr()
    assert "1 fault" in captured.out
    assert (
        captured.err
        == f"leaderboard: {tmp_path / 'mine' / made.runs[0].trace_name} is no file: a link or a pipe is none\n"
    )
    for arguments in ([], [str(tmp_path), "--all"], [str(tmp_path / "nothing")]):
        assert main(["verify", *arguments, "--board", str(board)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_every_entry_of_a_board_is_verified(tmp_path, board, capsys):
    traced(tmp_path / "mine")
    entry = submit(tmp_path / "mine", board)
    write_submission(tmp_path / "first", submission(agent="other"))
    submit(tmp_path / "first", board)
    assert main(["verify", "--all", "--board", str(board)]) == 0
    assert entry.slug in capsys.readouterr().out
    place = board / "entries" / entry.slug
    trace = place / entry.submission.runs[0].trace_name
    trace.write_bytes(trace.read_bytes()[:-8] + bytes(8))
    assert main(["verify", "--all", "--board", str(board)]) == 2
    error = capsys.readouterr().err
    assert "its SHA-256 is" in error
    assert f"{VERDICT}: label: 'replayed', but the replay does not bear it out" in error


def test_a_label_holds_for_what_was_verified_alone(tmp_path, board, capsys):
    traced(tmp_path / "mine")
    place = board / "entries" / submit(tmp_path / "mine", board).slug
    text = (place / FILE_NAME).read_text(encoding="utf-8")
    (place / FILE_NAME).write_text(text.replace("A. Author", "B. Author"), encoding="utf-8")
    assert main(["verify", "--all", "--board", str(board)]) == 2
    assert f"{VERDICT}: submission: it was made for another submission.json" in capsys.readouterr().err


def test_bad_states_of_a_trace_write_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = evaluate(RandomPolicy("Hopper"), "Hopper")
    states = np.full_like(found.traces.states, 1e11)  # MuJoCo's own log of bad states would go to the working folder
    again = replay(found, Traces(found.traces.lengths, found.traces.actions, states))
    assert np.isfinite(again.returns).all()
    assert os.listdir(tmp_path) == ["references"]


def test_an_entry_is_without_fault_on_the_machine_that_sent_it_and_on_the_board_s(tmp_path, board, references):
    """HalfCheetah's and Hopper's runs of a machine of other arithmetic, there, here, and there again."""
    there = (
        "import json, pathlib, sys; from dynagen_bench.datasets import scores;"
        "folder, board, references = map(pathlib.Path, sys.argv[1:]); scores.REFERENCE_FILE = references;"
    )
    places = (str(tmp_path / "mine"), str(board), str(references))
    made = "from tests.evaluation.samples import traced; traced(folder, ('Hopper', 'HalfCheetah')); print('null')"
    with_other_arithmetic(there + made, *places)
    entry = submit(tmp_path / "mine", board)
    assert entry.label == "replayed (tolerance)"
    assert [run.evaluation.physics for run in entry.submission.runs] == [None, None]
    assert not [check.faults for check in verify_entries(board)[entry.slug] if check.faults]
    again = (
        "from leaderboard.board import verify_entries;"
        "found = [check for checks in verify_entries(board).values() for check in checks];"
        "print(json.dumps([[check.label, check.faults] for check in found]))"
    )
    assert with_other_arithmetic(there + again, *places) == [["replayed", []], ["replayed", []]]


def test_the_board_says_whose_arithmetic_its_returns_are(tmp_path, board):
    other, made = with_states(evaluate(RandomPolicy("Hopper"), "Hopper"), 0.0)  # only its digest is another
    write_submission(tmp_path / "mine", made, [other.traces])
    entry = submit(tmp_path / "mine", board)
    assert entry.label == "replayed"
    assert entry.submission.runs[0].evaluation.physics == physics_digest("Hopper")


def test_an_interrupted_verification_says_so_in_one_line(tmp_path, capsys, monkeypatch):
    traced(tmp_path / "mine")

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("leaderboard.verify.replay", stopped)
    with pytest.raises(SystemExit, match=r"^130$"):
        main(["verify", str(tmp_path / "mine")])
    assert capsys.readouterr().err == "stopped: the board is as it was\n"
