"""Stored weights: what is stored acts as its run did, and what is not is told."""

import json

import numpy as np
import pytest
import torch

import agents
from agents import pretrained, store
from agents.checkpoint import load_checkpoint
from agents.pretrained import load_agent, read_about, store_run, stored
from agents.run_folder import RunSettings
from agents.train import train
from dynagen_bench.evaluation import Evaluation, evaluate
from tests.agents.samples import random_dataset, tiny_config


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run of DADT."""
    settings = RunSettings("Hopper", runs=tmp_path_factory.mktemp("runs"), checkpoint_every=1, log_every=1)
    return train(
        "dadt", tiny_config("dadt", steps=3), settings, random_dataset(), command="python -m agents.train dadt"
    )


def returns(agent):
    return evaluate(agent.policy(), "Hopper", indices=[1], traces=False).returns


def test_stored_weights_act_as_the_run_that_they_are_of(run, tmp_path):
    record = json.loads((run / "evaluation.json").read_text())
    evaluation = Evaluation.from_json(record["evaluation"])
    path = store_run(run, folder=tmp_path)
    assert path == tmp_path / "dadt-Hopper.safetensors"
    assert stored(tmp_path) == ["dadt-Hopper"]
    for agent in (agents.load(run), agents.load(str(run / "last.safetensors")), load_agent("dadt", "Hopper", tmp_path)):
        assert np.array_equal(returns(agent), evaluation.returns[[1]])
    kept, last = load_checkpoint(path), load_checkpoint(run / "last.safetensors")
    assert not kept.optimizer
    assert (kept.config, kept.step, kept.seed) == (last.config, 3, 0)
    assert all(torch.equal(kept.parameters[name], value) for name, value in last.parameters.items())
    about = read_about(path)
    assert about["score"] == evaluation.score
    assert about["mean_return"] == pytest.approx(evaluation.returns.mean())
    config = json.loads((run / "config.json").read_text())
    assert (about["commit"], about["data"], about["command"]) == (config["commit"], config["data"], config["command"])
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_weights_are_replaced_only_when_told_to(run, tmp_path):
    path = store_run(run, folder=tmp_path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"is there, with score .*: give --replace"):
        store_run(run, folder=tmp_path)
    assert path.read_bytes() == before
    store_run(run, replace=True, folder=tmp_path)
    assert load_checkpoint(path).step == 3


def test_the_command_line_stores_and_ends_bad_input_in_one_line(run, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pretrained.store_run, "__defaults__", (False, tmp_path / "stored"))
    store.main([str(run)])
    assert capsys.readouterr().out.startswith(f"stored: {tmp_path / 'stored' / 'dadt-Hopper.safetensors'}, mean return")
    with pytest.raises(SystemExit, match=r"^error: .* is no finished run, it has no config\.json") as stop:
        store.main([str(tmp_path)])
    assert "\n" not in str(stop.value)


def test_what_is_not_there_is_told_in_one_line_with_what_is(run, tmp_path):
    store_run(run, folder=tmp_path)
    for name, robot, message in (
        ("dadt", "Ant", "no stored weights of 'dadt' for 'Ant', stored are dadt-Hopper: make them with"),
        (
            "dadt",
            None,
            r"no run folder and no checkpoint at dadt: .* need a robot too, agents.load\('dadt', 'Hopper'\)",
        ),
        (tmp_path, None, "no checkpoint at .*last.safetensors"),
    ):
        with pytest.raises(FileNotFoundError, match=message) as caught:
            load_agent(name, robot, tmp_path)
        assert "\n" not in str(caught.value)
    for name, robot, message in (
        ("DADT", "Hopper", "unknown agent 'DADT': .*did you mean 'dadt'"),
        ("dadt", "hopper", "'Hopper'"),
    ):
        with pytest.raises(ValueError, match=message):
            load_agent(name, robot, tmp_path)
    with pytest.raises(ValueError, match=r"unknown agent '\.\./dadt'"):
        load_agent("../dadt", "Hopper", tmp_path)


def test_a_run_whose_files_do_not_belong_together_is_not_stored(run, tmp_path):
    (tmp_path / "cut").mkdir()
    for file in run.glob("*.*"):
        (tmp_path / "cut" / file.name).write_bytes(file.read_bytes())
    record = json.loads((run / "evaluation.json").read_text())
    (tmp_path / "cut" / "evaluation.json").write_text(
        json.dumps({**record, "gradient_steps": 2, "stopped_early": True})
    )
    with pytest.raises(ValueError, match="is at step 3, its evaluation of step 2"):
        store_run(tmp_path / "cut", folder=tmp_path)
    assert not stored(tmp_path)


def test_a_predictor_is_no_agent(tmp_path, tiny_data):
    settings = RunSettings("Hopper", runs=tmp_path, checkpoint_every=1, log_every=1)
    config = agents.PREDICTORS["mlp"][0](steps=1, batch_size=4, hidden=4, context=4)
    folder = train("mlp", config, settings, random_dataset())
    with pytest.raises(ValueError, match="is of 'mlp', which predicts and does not act: give a run of dadt"):
        agents.load(folder)
    with pytest.raises(ValueError, match="'mlp', which does not act"):
        store_run(folder, folder=tmp_path / "stored")


def test_what_is_stored_in_the_repository_is_whole():
    for name in stored():
        about = read_about(pretrained.FOLDER / f"{name}.safetensors")
        agent, robot = name.rsplit("-", 1)
        assert agents.load(agent, robot).policy() is not None
        assert about["settings"]["robot"] == robot
