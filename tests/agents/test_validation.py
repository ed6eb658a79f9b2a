"""Held-out train dynamics: they are not trained on, what is measured in them, and training that stops by it."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.checkpoint import load_checkpoint
from agents.learner import Learner
from agents.mlp import MLPConfig
from agents.run_folder import read_curve, read_finished, read_json, write_json
from agents.train import train
from agents.validation import BATCHES, Validation, check_patience, has_stalled, held_out_indices, set_apart
from dynagen_bench.datasets import WindowSampler
from dynagen_bench.evaluation import evaluate
from tests.agents.samples import K, hopper_spec, new_agent, random_dataset, tiny_config
from tests.agents.test_train import curves, parameters, same, settings


def dataset_of(*dynamics):
    """An episode of noise for each of the train dynamics."""
    dataset = random_dataset(lengths=tuple(range(5, 5 + len(dynamics))))
    return dataclasses.replace(dataset, episode_dynamics=np.array(dynamics))


def test_the_last_dynamics_are_set_apart():
    data, held = set_apart(dataset_of(0, 19, 17, 18, 19), 2)
    assert data.episode_dynamics.tolist() == [0, 17]
    assert held.episode_dynamics.tolist() == [19, 18, 19]
    assert list(held_out_indices(2)) == [18, 19]
    dataset = dataset_of(0, 19)
    assert set_apart(dataset, 0) == (dataset, None)
    for dynamics in ((0, 1), (18, 19)):
        with pytest.raises(ValueError, match=r"^of the 2 episodes [02] are of the 2 train dynamics that are held out"):
            set_apart(dataset_of(*dynamics), 2)


def test_what_is_held_out_is_neither_trained_on_nor_normalised_by(tmp_path):
    dataset, config = dataset_of(0, 3, 18, 19), tiny_config("dt", steps=4)
    held_out = train("dt", config, settings(tmp_path, hold_out=2), dataset)
    assert held_out.name == "dt-Hopper-seed0-holdout2"
    never_seen = train("dt", config, settings(tmp_path), dataset.select(np.array([0, 1])))
    assert same(parameters(held_out), parameters(never_seen))
    specs = [load_checkpoint(folder / "last.safetensors").spec for folder in (held_out, never_seen)]
    assert np.array_equal(*(spec.normalization.mean for spec in specs))
    rows = curves(held_out)
    assert [bool(row["validation_loss"] and row["validation_return"]) for row in rows] == [False, True]
    assert "validation_loss" not in curves(never_seen)[-1]


def test_the_measures_are_the_loss_without_dropout_and_the_return():
    held, agent, config = dataset_of(18, 19), new_agent("dadt"), tiny_config("dadt")
    validation = Validation(held, 2, config, hopper_spec())
    found = validation.measure(agent)
    sampler = WindowSampler(held, K, hopper_spec().normalization)
    drawn = [sampler.sample(config.batch_size, np.random.default_rng(batch)) for batch in range(BATCHES)]
    assert found["validation_loss"] == pytest.approx(np.mean([agent.loss(x, None)[0].item() for x in drawn]))
    returns = evaluate(agent.policy(), "Hopper", "train", indices=[18, 19]).returns
    assert found["validation_return"] == returns.mean()
    assert validation.measure(agent) == found
    predictor = Learner("mlp", MLPConfig(batch_size=8), hopper_spec(), seed=0)
    measured = Validation(held, 2, predictor.config, hopper_spec()).measure(predictor.agent)
    assert measured.keys() == {"validation_loss"}


@given(returns=st.lists(st.integers(0, 3).map(float), max_size=12), patience=st.integers(0, 4))
def test_training_has_stalled_where_no_record_is_among_the_last(returns, patience):
    records = [i for i, value in enumerate(returns) if not returns[:i] or value > max(returns[:i])]
    expected = bool(patience and records and len(returns) - 1 - records[-1] >= patience)
    points = [(10 * n, value) for n, value in enumerate(returns, start=1)]
    assert has_stalled(points, 10, patience) == expected
    odd = sorted([*points, *((step + 5, value) for step, value in points)])  # ends of runs that were continued
    assert has_stalled(odd, 10, patience) == expected


def stopping(tmp_path, **changes):
    """Settings of a run that looks every two steps and stops at the second look without a better return."""
    given = {"hold_out": 1, "patience": 2, "evaluate_every": 2, "checkpoint_every": 6, "log_every": 2}
    return settings(tmp_path, **(given | changes))


def test_a_run_stops_early_and_says_so_and_is_the_same_when_it_was_killed(tmp_path, monkeypatch):
    dataset, config = dataset_of(0, 19), tiny_config("dt", learning_rate=0.0)  # no return is better than the first
    folder = train("dt", config, stopping(tmp_path / "whole"), dataset)
    record = json.loads((folder / "evaluation.json").read_text())
    assert (record["gradient_steps"], record["stopped_early"]) == (6, True)
    assert load_checkpoint(folder / "last.safetensors").step == 6
    assert [row["step"] for row in curves(folder)] == ["2", "4", "6"]
    before = (folder / "last.safetensors").read_bytes()
    assert train("dt", config, stopping(tmp_path / "whole"), dataset) == folder
    assert (folder / "last.safetensors").read_bytes() == before

    update, stops = Learner.update, [3, 5]

    def stopped(self, sampler):
        if stops and self.step == stops[0]:
            stops.pop(0)
            raise KeyboardInterrupt
        return update(self, sampler)

    monkeypatch.setattr(Learner, "update", stopped)
    cut = stopping(tmp_path / "cut", checkpoint_every=2)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            train("dt", config, cut, dataset)
    assert [row["step"] for row in curves(train("dt", config, cut, dataset))] == ["2", "4", "6"]


def test_a_run_that_was_shorter_once_stops_where_one_does_that_never_was(tmp_path):
    dataset, config = dataset_of(0, 19), tiny_config("dt", learning_rate=0.0, steps=12)  # no return is better
    for steps in (3, 12):
        looking = stopping(tmp_path, log_every=1)
        folder = train("dt", dataclasses.replace(config, steps=steps), looking, dataset)
    assert json.loads((folder / "evaluation.json").read_text())["gradient_steps"] == 6


def test_a_run_that_ends_where_it_was_killed_is_measured_there(tmp_path, monkeypatch):
    dataset, update = dataset_of(0, 19), Learner.update

    def stopped(self, sampler):
        if self.step == 3:
            raise KeyboardInterrupt
        return update(self, sampler)

    looking = stopping(tmp_path, patience=0, log_every=1, checkpoint_every=3)
    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", stopped)
        with pytest.raises(KeyboardInterrupt):
            train("dt", tiny_config("dt", steps=12), looking, dataset)
    folder = train("dt", tiny_config("dt", steps=3), looking, dataset)
    assert [step for step, _ in read_curve(folder, "validation_return")] == [2, 3]


def test_a_run_that_stops_between_two_lines_of_its_curve_has_the_last_one_too(tmp_path):
    config = tiny_config("dt", learning_rate=0.0)
    folder = train("dt", config, stopping(tmp_path, log_every=4, checkpoint_every=8), dataset_of(0, 19))
    assert [row["step"] for row in curves(folder) if row["loss"]] == ["4", "6"]


def test_a_run_that_stopped_goes_on_when_it_is_told_to(tmp_path):
    dataset, config = dataset_of(0, 19), tiny_config("dt", learning_rate=0.0, steps=8)
    folder = train("dt", config, stopping(tmp_path), dataset)
    assert json.loads((folder / "evaluation.json").read_text())["gradient_steps"] == 6
    assert train("dt", config, stopping(tmp_path, patience=0), dataset) == folder
    record = json.loads((folder / "evaluation.json").read_text())
    assert (record["gradient_steps"], record["stopped_early"]) == (8, False)


def test_a_run_that_stalls_at_its_last_step_is_finished_also_when_more_steps_are_asked_for(tmp_path):
    dataset, config = dataset_of(0, 19), tiny_config("dt", learning_rate=0.0, steps=6)
    folder = train("dt", config, stopping(tmp_path), dataset)
    longer = dataclasses.replace(config, steps=12)
    assert train("dt", longer, stopping(tmp_path), dataset) == folder
    found, record = read_finished(folder, ["dt"])
    assert (found["config"]["steps"], record["gradient_steps"], record["stopped_early"]) == (6, 6, False)

    about = read_json(folder / "config.json")
    write_json(folder / "config.json", about | {"config": about["config"] | {"steps": 12}})  # as it was left once
    with pytest.raises(ValueError, match="was evaluated at step 6 of 12: train it to the end first"):
        read_finished(folder, ["dt"])
    train("dt", longer, stopping(tmp_path), dataset)
    found, record = read_finished(folder, ["dt"])
    assert (found["config"]["steps"], record["gradient_steps"], record["stopped_early"]) == (12, 6, True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"patience": 2}, "^patience is 2, hold_out 0 and evaluate_every 10: give --hold-out"),
        ({"patience": 2, "hold_out": 3, "evaluate_every": 0}, "evaluate_every 0: give --hold-out and --evaluate-every"),
        ({"hold_out": 20}, "^hold_out is 20: give at most 19 dynamics"),
        ({"hold_out": -1}, "^hold_out is -1: give a whole number from 0 on"),
        ({"quality": 0.0}, r"^quality is 0.0: give a share"),
        ({"quality": 1.5}, r"^quality is 1.5: give a share"),
    ],
)
def test_settings_that_do_not_fit_are_refused_in_one_line(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        settings(tmp_path, **changes)
    assert "\n" not in str(caught.value)


def test_patience_is_for_agents_that_learn_to_act_until_the_end():
    check_patience("dt", new_agent("dt"), 3)
    check_patience("dt_plus", new_agent("dt_plus"), 0)
    with pytest.raises(ValueError, match=r"^patience is 3: dt_plus learns in phases"):
        check_patience("dt_plus", new_agent("dt_plus"), 3)
    predictor = Learner("mlp", MLPConfig(), hopper_spec(), seed=0).agent
    with pytest.raises(ValueError, match=r"^patience is 3: mlp has no returns"):
        check_patience("mlp", predictor, 3)
