"""DT+: Decision Transformer's own training, then a head on what it has become."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.dt_plus import DTPlusConfig
from agents.interface import Agent, Phased, Predictor
from agents.learner import Learner
from agents.train import train
from dynagen_bench.datasets import WindowSampler
from tests.agents.samples import K, S, flat_dataset, hopper_spec, new_agent, random_dataset, random_windows, tiny_config
from tests.agents.test_train import curves, settings


def learner_and_sampler(name, dataset=None, **changes):
    dataset = dataset or random_dataset()
    learner = Learner(name, tiny_config(name, **changes).for_robot("Hopper"), hopper_spec(), seed=3)
    return learner, WindowSampler(dataset, K, dataset.normalization())


def copy_of(parameters):
    return {key: value.detach().clone() for key, value in parameters}


def test_the_first_phase_is_decision_transformers_training_and_the_second_leaves_it_as_it_is():
    (plus, sampler), (dt, _) = learner_and_sampler("dt_plus"), learner_and_sampler("dt")
    first_head = copy_of(plus.agent.next_state_head.named_parameters())
    for _ in range(10):
        assert plus.update(sampler) == dt.update(sampler)
    trained = copy_of(dt.agent.named_parameters())
    for key, value in plus.agent.next_state_head.named_parameters():
        assert torch.equal(value, first_head[key])
    for _ in range(10):
        assert plus.update(sampler).keys() == {"loss", "next_state_loss", "gradient_norm"}
    for key, value in plus.agent.dt.named_parameters():
        assert torch.equal(value, trained[key]), key
    for key, value in plus.agent.next_state_head.named_parameters():
        assert not torch.equal(value, first_head[key]), key


def test_it_acts_as_the_decision_transformer_in_it():
    plus, dt = new_agent("dt_plus"), new_agent("dt")
    observations = np.random.default_rng(0).normal(size=(4, S))
    assert np.array_equal(*(agent.policy().predict(observations)[0] for agent in (plus, dt)))


def test_the_head_learns_what_can_be_read_from_the_trunk():
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, size=(10, 3)) for _ in range(50)]
    # the next state is the action, mapped: a linear head on the action's token can say so, untrained as the trunk is
    states = [np.concatenate([np.zeros((1, S)), a @ np.eye(3, S)]) for a in actions]
    dataset = flat_dataset(states, actions, [np.zeros(10)] * 50)
    learner, sampler = learner_and_sampler(
        "dt_plus", dataset, steps=401, trunk_steps=1, embedding=64, learning_rate=1e-2, dropout=0.5
    )
    losses = [learner.update(sampler)["loss"] for _ in range(401)]
    assert np.mean(losses[-50:]) < 0.05 * losses[1]


@pytest.mark.parametrize("name", ["dadt", "dt_plus"])
def test_predictions_are_those_of_the_loss_in_float32_and_without_dropout(name):
    windows = random_windows()
    exact, rounded = (new_agent(name, step=19, precision=p, dropout=0.5) for p in ("float32", "bfloat16"))
    assert isinstance(exact, Predictor)
    predicted = exact.predict(windows)
    assert (predicted.shape, predicted.dtype, predicted.requires_grad) == ((8, K, S), torch.float32, False)
    assert torch.equal(predicted, rounded.predict(windows))
    error = (predicted.numpy() - windows.next_observations)[windows.mask]
    assert exact.loss(windows, None)[1]["next_state_loss"].item() == pytest.approx(np.square(error).mean(), rel=1e-5)
    blind = windows._replace(next_observations=np.full_like(windows.next_observations, np.nan))
    assert torch.equal(exact.predict(blind), predicted)


@pytest.mark.parametrize("name", ["dadt", "dt_plus"])
@pytest.mark.parametrize("step", range(K - 1))
def test_a_prediction_knows_its_steps_action_and_nothing_later(name, step):
    agent, windows = new_agent(name), random_windows()
    later = windows._replace(observations=windows.observations.copy(), actions=windows.actions.copy())
    later.observations[:, step + 1 :] += 1.0
    later.actions[:, step + 1 :] += 1.0
    own = windows._replace(actions=windows.actions.copy())
    own.actions[:, step] += 1.0
    valid = windows.mask[:, : step + 1]
    before = agent.predict(windows)[:, : step + 1][valid]
    assert torch.equal(agent.predict(later)[:, : step + 1][valid], before)
    assert not torch.equal(agent.predict(own)[:, : step + 1][valid], before)


def test_it_is_an_agent_and_a_predictor_in_phases_and_dt_is_the_first_alone():
    assert all(isinstance(new_agent("dt_plus"), kind) for kind in (Agent, Predictor, Phased))
    assert [isinstance(new_agent("dt"), kind) for kind in (Agent, Predictor, Phased)] == [True, False, False]


def test_a_line_of_the_curves_may_hold_both_phases(tmp_path):
    config = tiny_config("dt_plus", steps=8, trunk_steps=3)
    rows = curves(train("dt_plus", config, settings(tmp_path, evaluate_every=0), random_dataset()))
    assert [bool(row["action_loss"]) for row in rows] == [True, True, False, False]
    assert [bool(row["next_state_loss"]) for row in rows] == [False, True, True, True]


def test_the_first_phase_has_half_of_the_steps_unless_it_is_said():
    assert DTPlusConfig().for_robot("Hopper").trunk_steps == 500_000
    assert DTPlusConfig(steps=3).for_robot("Ant").trunk_steps == 1
    config = DTPlusConfig(steps=10, trunk_steps=9).for_robot("HalfCheetah")
    assert (config.trunk_steps, config.target_return) == (9, 1500.0)
    assert dataclasses.replace(config, steps=20).trunk_steps == 9


@pytest.mark.parametrize(("steps", "trunk_steps"), [(10, 10), (10, 0), (10, 2.5), (10, True), (1, 1)])
def test_a_first_phase_that_leaves_no_step_for_the_head_is_refused(steps, trunk_steps):
    with pytest.raises(ValueError, match=f"^trunk_steps is {trunk_steps} of {steps} steps: give a whole number from 1"):
        DTPlusConfig(steps=steps, trunk_steps=trunk_steps)
    with pytest.raises(ValueError, match=r"^trunk_steps is 1 of 1 steps"):
        DTPlusConfig(steps=1).for_robot("Hopper")
