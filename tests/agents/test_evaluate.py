"""What a run has learned: the same episodes for the agent, its untrained self and random actions."""

import dataclasses
import json

import numpy as np
import pytest

from agents.checkpoint import load_checkpoint
from agents.evaluate import main as evaluate_command
from agents.evaluate import measure_learning
from agents.focal import FOCALConfig
from agents.predict import main as predict_command
from agents.run_folder import LEARNED, locked
from agents.train import train
from agents.trajectory_transformer import TrajectoryTransformerConfig
from dynagen_bench.datasets import load_dataset
from dynagen_bench.evaluation import RandomPolicy, evaluate
from tests.agents.samples import tiny_config
from tests.agents.test_train import settings

STILL = {"steps": 1, "learning_rate": 0.0, "batch_size": 4, "context": 5}
CONFIGS = {
    "dadt": dataclasses.replace(tiny_config("dadt"), **STILL),
    "focal": FOCALConfig(**{key: value for key, value in STILL.items() if key != "context"}, hidden=8),
    "trajectory_transformer": TrajectoryTransformerConfig(
        **STILL, layers=1, heads=1, embedding=8, bins=8, horizon=2, beams=2, plan_every=2
    ),
}


@pytest.mark.usefixtures("tiny_data")
@pytest.mark.parametrize("name", CONFIGS)
def test_who_has_learned_nothing_does_what_the_untrained_do(name, tmp_path):
    run = train(name, CONFIGS[name], settings(tmp_path, evaluate_every=0), load_dataset("Hopper", "train"))
    record = measure_learning(run, dynamics=2)
    assert json.loads((run / LEARNED).read_text()) == record
    assert record["dynamics"] == ["train0", "train1"]
    assert record["trained"] == record["untrained"] != record["random"]


@pytest.mark.usefixtures("tiny_data")
def test_the_untrained_are_fitted_to_what_the_trained_were(tmp_path):
    name = "trajectory_transformer"
    plan = settings(tmp_path, evaluate_every=0, hold_out=19)
    run = train(name, CONFIGS[name], plan, load_dataset("Hopper", "train"))
    record = measure_learning(run, dynamics=1)
    assert record["trained"] == record["untrained"]


@pytest.mark.usefixtures("tiny_data")
def test_the_numbers_are_those_of_evaluate(tmp_path, capsys):
    config = dataclasses.replace(CONFIGS["dadt"], steps=3, learning_rate=0.01)
    run = train("dadt", config, settings(tmp_path, seed=3, evaluate_every=0), load_dataset("Hopper", "train"))
    evaluate_command([str(run), "--dynamics", "1"])
    record = json.loads((run / LEARNED).read_text())
    agent = load_checkpoint(run / "last.safetensors").build_agent()
    for what, policy in (("trained", agent.policy()), ("random", RandomPolicy("Hopper", 3))):
        assert np.allclose(record[what], evaluate(policy, "Hopper", "train", indices=[0]).returns.mean(axis=1))
    assert record["trained"] != record["untrained"]
    assert "dadt, Hopper, seed 3" in capsys.readouterr().out


@pytest.mark.usefixtures("tiny_data")
def test_nobody_trains_a_run_on_while_it_is_measured(tmp_path):
    run = train("dadt", CONFIGS["dadt"], settings(tmp_path, evaluate_every=0), load_dataset("Hopper", "train"))
    with locked(run), pytest.raises(ValueError, match="another process works in"):
        measure_learning(run, dynamics=1)
    assert not (run / LEARNED).exists()


@pytest.mark.parametrize("command", [evaluate_command, predict_command])
def test_an_interruption_is_one_line(command, tmp_path, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    for what in ("agents.evaluate.check_finished", "agents.predict.read_run"):
        monkeypatch.setattr(what, stopped)
    with pytest.raises(SystemExit, match=r"^130$"):
        command([str(tmp_path)])


def test_bad_input_is_one_line(tmp_path):
    with pytest.raises(SystemExit, match=r"error: .* is no finished run"):
        evaluate_command([str(tmp_path)])
    with pytest.raises(SystemExit, match=r"^error: threads is -1: give a whole number from 0 on$"):
        evaluate_command([str(tmp_path), "--threads", "-1"])
