"""Runs to a submission."""

import json

import numpy as np
import pytest

from agents.run_folder import RunSettings
from agents.submit import main, submit
from agents.train import train
from dynagen_bench.evaluation import Evaluation
from dynagen_bench.evaluation.submission import read_submission
from leaderboard.verify import verify
from tests.agents.samples import random_dataset, tiny_config


def run(tmp_path, name="dadt", seed=0, steps=2, **changes):
    settings = RunSettings(
        "Hopper", seed=seed, runs=tmp_path, evaluate_every=1, checkpoint_every=1, log_every=1, **changes
    )
    return train(name, tiny_config(name, steps=steps), settings, random_dataset())


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
    assert found.commands[1].startswith("python -m agents.train dadt --robot Hopper --seed 1 --every 4 --context 5 ")
    assert all(check.label == "replayed" for check in verify(tmp_path / "out", found))
    assert found.versions.keys() >= {"torch", "mujoco", "numpy", "gymnasium"}


def test_the_best_checkpoints_are_another_submission(tmp_path):
    folder = run(tmp_path)
    main([str(folder), "--output", str(tmp_path / "best"), "--authors", "A. Name", "--checkpoint", "best"])
    found = read_submission(tmp_path / "best")
    best = json.loads((folder / "evaluation-best.json").read_text())
    assert (found.checkpoint, found.runs[0].gradient_steps) == ("best", best["gradient_steps"])


def test_what_does_not_belong_together_is_refused_in_one_line(tmp_path):
    one, other = run(tmp_path), run(tmp_path, "dt")
    longer = run(tmp_path, seed=1, steps=3)
    unfinished = run(tmp_path, seed=2)
    config = json.loads((unfinished / "config.json").read_text())
    config["config"]["steps"] = 9
    (unfinished / "config.json").write_text(json.dumps(config))
    (tmp_path / "empty").mkdir()
    for runs, authors, message in (
        ([], ["A"], "no runs given"),
        ([one, other], ["A"], "agent differs between the runs"),
        ([one, longer], ["A"], "config for Hopper differs between the runs"),
        ([unfinished], ["A"], "was evaluated at step 2 of 9: train it to the end"),
        ([tmp_path / "empty"], ["A"], "is no finished run, it has no config.json"),
        ([one, one], ["A"], "both Hopper with seed 0"),
        ([one], ["two\nlines"], "authors.0"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
            submit(runs, tmp_path / "out", authors)
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()
