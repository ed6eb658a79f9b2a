"""Runs to a submission."""

import dataclasses
import json

import numpy as np
import pytest

from agents import AGENTS
from agents.adapt import adapt
from agents.fine_tuning import PAPER, AdaptationSettings
from agents.run_folder import RunSettings
from agents.submit import _privileged, main, submit
from agents.train import train
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.submission import read_submission
from leaderboard.verify import verify
from tests.agents.samples import random_dataset, tiny_config


def run(tmp_path, name="dadt", seed=0, steps=2, options=None, **changes):
    settings = RunSettings(
        "Hopper", seed=seed, runs=tmp_path, evaluate_every=1, checkpoint_every=1, log_every=1, **changes
    )
    dataset = dataclasses.replace(random_dataset(), episode_dynamics=np.array([0, 1, 19]))
    return train(name, tiny_config(name, steps=steps, **(options or {})), settings, dataset)


def test_runs_become_a_submission_that_the_leaderboard_reads(tmp_path):
    folders = [run(tmp_path, seed=seed, every=4) for seed in (0, 1)]
    submit(folders, tmp_path / "out", authors=["A. Name"], code="https://example.org/code")
    found = read_submission(tmp_path / "out")
    assert (found.agent, found.authors, found.checkpoint, found.track) == ("dadt", ["A. Name"], "last", "zero-shot")
    assert "Dynamics-Augmented" in found.description
    assert "2 gradient steps, on a part of the data alone (one in 4 snapshots)" in found.description
    assert [(r.robot, r.seed, r.gradient_steps) for r in found.runs] == [("Hopper", 0, 2), ("Hopper", 1, 2)]
    for folder, submitted in zip(folders, found.runs, strict=True):
        record = json.loads((folder / "evaluation.json").read_text())
        evaluation = Evaluation.from_json(record["evaluation"])
        assert np.array_equal(submitted.evaluation.evaluation().returns, evaluation.returns)
        assert submitted.trace is not None
        assert [point.gradient_steps for point in submitted.curve] == [1, 2]
        assert submitted.curve[-1].mean_return == pytest.approx(evaluation.returns.mean(), rel=1e-6)
    assert found.commands[1].startswith(
        "python -m agents.train dadt --robot Hopper --seed 1 --every 4 --threads 1 --context 5 "
    )
    assert all(check.label == "replayed" for check in verify(tmp_path / "out", found))
    assert found.versions.keys() >= {"torch", "mujoco", "numpy", "gymnasium"}


def test_runs_of_other_configs_are_told_by_what_differs(tmp_path):
    folders = [run(tmp_path, seed=seed) for seed in (0, 1)]
    config = json.loads((folders[1] / "config.json").read_text())
    config["config"]["batch_size"] = 7
    (folders[1] / "config.json").write_text(json.dumps(config))
    with pytest.raises(
        ValueError, match=r"^config for Hopper differs .*, \{'batch_size': \d+\} and \{'batch_size': 7\}: "
    ):
        submit(folders, tmp_path / "out", authors=["A. Name"])


def test_the_adaptation_track_has_a_fixed_set_of_episodes(tmp_path, tiny_data):
    folder = run(tmp_path, every=1)
    adapt(folder, AdaptationSettings(steps=1, episodes=2, batch_size=2))
    with pytest.raises(
        ValueError, match="adapted on 2 episodes of each test dynamics, and the track has a fixed set of 10"
    ):
        submit([folder], tmp_path / "out", authors=["A. Name"], track="adaptation")
    assert not (tmp_path / "out").exists()


def test_folders_of_runs_are_told_from_runs(tmp_path):
    folder = run(tmp_path)
    for given, message in (
        (folder.parent, "is no run, but holds some: name these, as"),
        (tmp_path / "x", "is no folder"),
    ):
        with pytest.raises(FileNotFoundError, match=message):
            submit([given], tmp_path / "out", authors=["A. Name"])


def test_a_damaged_result_is_one_line(tmp_path):
    folder = run(tmp_path)
    record = json.loads((folder / "evaluation.json").read_text())
    record["evaluation"]["seeds"] = "x"
    (folder / "evaluation.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"\A[^\n]*seeds[^\n]*\Z"):
        submit([folder], tmp_path / "out", authors=["A. Name"])


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        SystemExit, match=r"^error: .* is no folder that you may write to, give a path elsewhere$"
    ) as stop:
        main([str(run(tmp_path)), "--output", str(tmp_path / "file" / "out"), "--authors", "A. Name"])
    assert "\n" not in str(stop.value)


def test_the_best_checkpoints_are_another_submission(tmp_path):
    folder = run(tmp_path)
    main([str(folder), "--output", str(tmp_path / "best"), "--authors", "A. Name", "--checkpoint", "best"])
    found = read_submission(tmp_path / "best")
    best = json.loads((folder / "evaluation-best.json").read_text())
    assert (found.checkpoint, found.runs[0].gradient_steps) == ("best", best["gradient_steps"])
    assert "--evaluate-every 1 " in found.commands[0]  # which decides what is the best
    submit([folder], tmp_path / "last", ["A. Name"])
    assert "--evaluate-every" not in read_submission(tmp_path / "last").commands[0]
    config = json.loads((folder / "config.json").read_text())
    config["settings"]["evaluate_every"] = RunSettings("Hopper").evaluate_every
    (folder / "config.json").write_text(json.dumps(config))
    submit([folder], tmp_path / "usual", ["A. Name"], checkpoint="best")
    assert "--evaluate-every" not in read_submission(tmp_path / "usual").commands[0]


def test_what_does_not_belong_together_is_refused_in_one_line(tmp_path):
    one, other = run(tmp_path), run(tmp_path, "dt")
    longer = run(tmp_path, seed=1, steps=3)
    unfinished = run(tmp_path, seed=2)
    config = json.loads((unfinished / "config.json").read_text())
    config["config"]["steps"] = 9
    (unfinished / "config.json").write_text(json.dumps(config))
    parts = [run(tmp_path, seed=3, every=4), run(tmp_path, seed=4, quality=0.3), run(tmp_path, seed=5, hold_out=1)]
    (tmp_path / "empty").mkdir()
    for runs, authors, message in (
        ([], ["A"], "no runs given"),
        ([one, other], ["A"], "agent differs between the runs"),
        ([one, longer], ["A"], "config for Hopper differs between the runs"),
        ([one, parts[0]], ["A"], "every for Hopper differs between the runs, 1 and 4: submit them apart"),
        ([one, parts[1]], ["A"], r"quality for Hopper differs between the runs, 1\.0 and 0\.3: submit them apart"),
        ([one, parts[2]], ["A"], "hold_out for Hopper differs between the runs, 0 and 1: submit them apart"),
        ([unfinished], ["A"], "was evaluated at step 2 of 9: train it to the end"),
        ([tmp_path / "empty"], ["A"], "is no finished run, it has no config.json"),
        ([one, one], ["A"], "both Hopper with seed 0"),
        ([one], ["two\nlines"], "authors.0"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
            submit(runs, tmp_path / "out", authors)
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_who_acts_by_the_present_state_alone_knows_nothing_of_the_body():
    assert {name for name in AGENTS if _privileged(name, "zero-shot") == "none"} == {"merpo", "mlp_bc"}
    assert {_privileged(name, "zero-shot") for name in AGENTS} == {"none", "own-history"}


def test_what_was_fine_tuned_is_a_submission_of_the_other_track(tmp_path, tiny_data):
    folder = run(tmp_path, every=1, seed=1)
    with pytest.raises(FileNotFoundError, match=r"has no adaptation.json: make it with `python -m agents.adapt"):
        submit([folder], tmp_path / "out", ["A. Name"], track="adaptation")
    adapt(folder, AdaptationSettings(steps=3, learning_rate=0.01))
    with pytest.raises(ValueError, match="only the last checkpoint is fine-tuned: give --checkpoint last"):
        submit([folder], tmp_path / "out", ["A. Name"], track="adaptation", checkpoint="best")
    options = [str(folder), "--output", str(tmp_path / "out"), "--authors", "A. Name", "--track", "adaptation"]
    main(options)
    found = read_submission(tmp_path / "out")
    assert (found.track, found.checkpoint, found.privileged) == ("adaptation", "last", "offline-context")
    assert "2 gradient steps, then fine-tuned for 3 on 10 episodes of each test dynamics." in found.description
    record = json.loads((folder / "adaptation.json").read_text())
    assert (found.runs[0].gradient_steps, found.hours) == (5, record["hours"])
    assert found.runs[0].evaluation.returns == record["evaluation"]["returns"]
    assert found.runs[0].curve == []
    assert found.commands[0].startswith("python -m agents.train dadt --robot Hopper --seed 1 --threads 1 --context 5 ")
    expected = "python -m agents.adapt runs/dadt-Hopper-seed1 --steps 3 --learning-rate 0.01 --threads 1"
    assert found.commands[1:] == [expected]
    assert [check.label for check in verify(tmp_path / "out", found)] == ["replayed"]

    run(tmp_path, seed=1, steps=3)  # the same run, continued
    with pytest.raises(ValueError, match="was adapted at step 2 and trained to 3 since: adapt it again"):
        submit([folder], tmp_path / "out", ["A. Name"], track="adaptation")


def test_the_steps_of_an_adaptation_are_told_also_where_they_are_the_default(tmp_path, tiny_data):
    folder = run(tmp_path, every=1)
    adapt(folder, AdaptationSettings(steps=1))
    record = json.loads((folder / "adaptation.json").read_text())
    record["adaptation"] = dataclasses.asdict(AdaptationSettings()) | PAPER | {"steps": 2000}
    del record["threads"]  # older than that
    (folder / "adaptation.json").write_text(json.dumps(record))
    submit([folder], tmp_path / "out", ["A. Name"], track="adaptation")
    commands = read_submission(tmp_path / "out").commands
    assert commands[1:] == ["python -m agents.adapt runs/dadt-Hopper-seed0 --steps 2000"]


def test_the_commit_is_that_which_has_made_the_result(tmp_path, tiny_data):
    folder = run(tmp_path, every=1)
    adapt(folder, AdaptationSettings(steps=1))
    for file, commit in (("config.json", "a" * 40), ("adaptation.json", "b" * 40)):
        content = json.loads((folder / file).read_text())
        assert "commit" in content
        (folder / file).write_text(json.dumps(content | {"commit": commit}))
    for track, commit in (("zero-shot", "a" * 40), ("adaptation", "b" * 40)):
        submit([folder], tmp_path / track, ["A. Name"], track=track)
        assert read_submission(tmp_path / track).commit == commit
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"commit": "a" * 40 + "-dirty"}))
    submit([folder], tmp_path / "out", ["A. Name"], track="adaptation")
    assert read_submission(tmp_path / "out").commit is None  # no later commit has what was never committed


def test_runs_of_several_commits_tell_their_own(tmp_path):
    folders = [run(tmp_path, seed=seed) for seed in (0, 1)]
    for folder, commit in zip(folders, "ab", strict=True):
        content = json.loads((folder / "config.json").read_text()) | {"commit": commit * 40}
        (folder / "config.json").write_text(json.dumps(content))
    submit(folders, tmp_path / "out", ["A. Name"])
    made = read_submission(tmp_path / "out")
    assert (made.commit, [one.commit for one in made.runs]) == (None, ["a" * 40, "b" * 40])


def test_a_long_learning_curve_is_thinned_to_what_is_taken(tmp_path):
    folder = run(tmp_path)
    header = (folder / "curves.csv").read_text().splitlines()[0]
    lines = [",".join(f"{step}" if name == "step" else "1.5" for name in header.split(",")) for step in range(1, 2501)]
    (folder / "curves.csv").write_text("\n".join([header, *lines, ""]))
    submit([folder], tmp_path / "out", ["A. Name"])
    curve = read_submission(tmp_path / "out").runs[0].curve
    assert [point.gradient_steps for point in curve[-2:]] == [2497, 2500]
    assert len(curve) == 834  # every third, the last among them


def test_a_part_of_the_data_and_an_early_stop_are_told(tmp_path):
    # of learning rate 0 no return is better than the first, and of patience 2 the third step is the last one
    folder = run(tmp_path, steps=9, quality=0.3, hold_out=1, patience=2, options={"learning_rate": 0.0})
    assert folder.name == "dadt-Hopper-seed0-quality0.3-holdout1"
    submit([folder], tmp_path / "out", ["A. Name"])
    found = read_submission(tmp_path / "out")
    assert found.runs[0].gradient_steps == 3
    said = (
        "Trained for 3 gradient steps, on the 30% of the episodes with the lowest returns, 1 of the 20 train dynamics"
    )
    said += " held out, stopped early after 2 evaluations without a better return in those."
    assert said in found.description
    assert "--quality 0.3 --hold-out 1 --patience 2 --threads 1 --evaluate-every 1 " in found.commands[0]
    assert " --steps 9" in found.commands[0]


def test_a_run_that_is_older_than_some_settings_has_their_defaults(tmp_path):
    folder = run(tmp_path)
    config = json.loads((folder / "config.json").read_text())
    for setting in ("quality", "hold_out", "patience"):
        del config["settings"][setting]
    (folder / "config.json").write_text(json.dumps(config))
    submit([folder], tmp_path / "out", ["A. Name"])
    assert run(tmp_path, steps=3) == folder  # and may go on


def test_a_run_of_a_predictor_is_refused(tmp_path):
    folder = run(tmp_path)
    config = json.loads((folder / "config.json").read_text()) | {"agent": "mlp"}
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(ValueError, match="is of 'mlp', which does not act: give a run of dadt, "):
        submit([folder], tmp_path / "out", ["A. Name"])
