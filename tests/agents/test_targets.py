"""Which return to ask for: measured in held-out train dynamics, of agents that are asked."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from agents.checkpoint import load_checkpoint
from agents.run_folder import locked
from agents.targets import main, measure_targets, usual_targets
from agents.train import train
from agents.trained_run import TrainedRun
from dynagen_bench.datasets import load_dataset
from dynagen_bench.datasets.scores import Reference
from dynagen_bench.evaluation import evaluate
from tests.agents.samples import tiny_config
from tests.agents.test_train import settings


@pytest.fixture
def run(tiny_data, tmp_path) -> Path:
    """A run of DADT that held out 19 of the 20 train dynamics."""
    plan = settings(tmp_path, seed=3, evaluate_every=0, hold_out=19)
    return train("dadt", tiny_config("dadt", steps=2, learning_rate=0.05), plan, load_dataset("Hopper", "train"))


def test_each_target_has_the_returns_of_an_agent_that_is_asked_for_it(run):
    found = measure_targets(run, (5000.0, -200.0))
    assert list(found) == [5000.0, -200.0]
    assert list(found[5000.0]) == [f"train{index}" for index in range(1, 20)]
    checkpoint = load_checkpoint(run / "last.safetensors")
    for target, returns in found.items():
        config = dataclasses.replace(checkpoint.config, target_return=target)
        agent = dataclasses.replace(checkpoint, config=config).build_agent()
        alone = evaluate(agent.policy(), "Hopper", "train", indices=[1, 19]).returns.mean(axis=1)
        assert np.allclose([returns["train1"], returns["train19"]], alone)
    assert found[5000.0] != found[-200.0]
    with (run / "target-curve.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["target_return"]) for line in lines] == [5000.0, -200.0]
    for line, returns in zip(lines, found.values(), strict=True):
        assert float(line["mean_return"]) == pytest.approx(np.mean(list(returns.values())), rel=1e-6)
        assert float(line["train7"]) == pytest.approx(returns["train7"], rel=1e-6)


def test_the_command_asks_for_shares_of_the_best_that_the_train_data_show(run, monkeypatch, capsys):
    scores = {"train0": Reference(0, 100, 50), "train1": Reference(0, 200, 50), "test0": Reference(0, 900, 50)}
    monkeypatch.setattr("agents.targets.reference_scores", lambda robot: scores)
    assert usual_targets("Hopper") == (50, 100, 150, 200, 250, 300)
    main([str(run)])
    with (run / "target-curve.csv").open() as file:
        assert [line["target_return"] for line in csv.DictReader(file)] == [f"{50.0 * i}" for i in range(1, 7)]
    assert f"{run.name}: return in held-out" in " ".join(capsys.readouterr().out.split())


def test_an_interruption_loses_no_target_that_was_measured(run, monkeypatch):
    measured = []

    def stopped(*arguments, **options):
        if measured:
            raise KeyboardInterrupt
        measured.append(1)
        return evaluate(*arguments, **options)

    monkeypatch.setattr("agents.targets.evaluate", stopped)
    with pytest.raises(SystemExit, match=r"^130$"):
        main([str(run), "--targets", "50", "100"])
    assert not (run / "target-curve.csv").exists()
    measured.clear()
    monkeypatch.setattr("agents.targets.evaluate", lambda *some, **more: measured.append(1) or evaluate(*some, **more))
    main([str(run), "--targets", "50", "100"])
    assert len(measured) == 1  # 100 alone
    with (run / "target-curve.csv").open() as file:
        assert [line["target_return"] for line in csv.DictReader(file)] == ["50.0", "100.0"]
    assert not (run / "target-curve").exists()


def test_what_an_earlier_checkpoint_returned_is_not_taken(run, monkeypatch):
    found = measure_targets(run, (50.0,))
    part = run / "target-curve" / "50.0.json"
    part.parent.mkdir()
    about = TrainedRun.read(run).facts | {"target_return": 50.0, "mean_returns": dict.fromkeys(found[50.0], -1.0)}
    part.write_text(json.dumps(about))
    assert set(measure_targets(run, (50.0,))[50.0].values()) == {-1.0}  # what is of this checkpoint is taken
    part.parent.mkdir()
    part.write_text(json.dumps(about | {"trained_steps": 1}))
    assert measure_targets(run, (50.0,)) == found


def test_nobody_trains_on_what_is_measured(run):
    with locked(run), pytest.raises(ValueError, match="another process works in"):
        measure_targets(run, (50.0,))


def test_what_has_no_target_to_choose_is_said_in_one_line(run, tmp_path, tiny_data):
    with pytest.raises(SystemExit, match=r"^error: no runs given: name at least one run folder$"):
        main([])
    with pytest.raises(SystemExit, match="is no run, but holds some: name these, as"):
        main([str(tmp_path)])
    with pytest.raises(SystemExit, match="target_return is nan: give a finite number"):
        main([str(run), "--targets", "nan"])
    data = load_dataset("Hopper", "train")
    whole = train("dadt", tiny_config("dadt", steps=1), settings(tmp_path / "whole", evaluate_every=0), data)
    with pytest.raises(SystemExit, match="held out no train dynamics: train one with --hold-out"):
        main([str(whole)])
    plan = settings(tmp_path / "other", evaluate_every=0, hold_out=19)
    cloning = train("transformer_bc", tiny_config("transformer_bc", steps=1), plan, data)
    with pytest.raises(SystemExit, match="is of 'transformer_bc', which is asked for no return: it has no target"):
        main([str(cloning)])
    assert not list(tmp_path.rglob("target-curve.csv"))
