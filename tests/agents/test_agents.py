"""What every sequence agent has to do, once for each that is trained on windows."""

import dataclasses

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.interface import RobotSpec
from agents.learner import Learner
from agents.trunk import Trunk
from dynagen_bench.datasets import Normalization, WindowSampler
from dynagen_bench.evaluation import Policy, RewardAware
from tests.agents.samples import (
    TRANSFORMERS,
    A,
    K,
    S,
    flat_dataset,
    hopper_spec,
    new_agent,
    random_dataset,
    random_windows,
    stages,
    tiny_config,
)


def gradients(agent, windows):
    """The loss, and the gradients of the parameters that it reaches by name."""
    agent.zero_grad()
    loss, _ = agent.loss(windows, None)
    loss.backward()
    return loss.detach(), {key: value.grad for key, value in agent.named_parameters() if value.grad is not None}


def trunk_outputs(agent, windows):
    """The trunk's output (B, K, M, D) at all M tokens of a step, of the tokens that the loss gives it."""
    seen = []
    (trunk,) = (module for module in agent.modules() if isinstance(module, Trunk))
    hook = trunk.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[:2]))
    agent.loss(windows, None)
    hook.remove()
    ((tokens, mask),) = seen
    output = trunk(tokens, mask).detach()
    return output.view(len(output), K, -1, output.shape[-1])


def changed(windows, where, seed=1):
    """Windows with other numbers at the steps of `where` (B, K)."""
    rng = np.random.default_rng(seed)
    new = {}
    for field in ("observations", "actions", "next_observations", "returns_to_go"):
        old = getattr(windows, field)
        here = where if old.ndim == 2 else where[..., None]
        new[field] = np.where(here, rng.normal(0, 5, old.shape), old).astype(np.float32)
    return windows._replace(timesteps=np.where(where, rng.integers(200, size=where.shape), windows.timesteps), **new)


def test_the_phases_losses_together_reach_every_parameter(name):
    reached = [gradients(new_agent(name, step=step), random_windows())[1].keys() for n, step in stages() if n == name]
    assert set.union(*map(set, reached)) == {key for key, _ in new_agent(name).named_parameters()}


def test_loss_ignores_padded_steps(stage):
    agent, windows = new_agent(stage[0], step=stage[1]), random_windows()
    assert not windows.mask.all()
    loss, grads = gradients(agent, windows)
    other_loss, other_grads = gradients(agent, changed(windows, ~windows.mask))
    assert torch.equal(loss, other_loss)
    # a padded step's token has no gradient of its own; its row in a sum may only change the sum's order
    assert grads.keys() == other_grads.keys()
    for key, grad in grads.items():
        torch.testing.assert_close(grad, other_grads[key], rtol=1e-5, atol=1e-7)


def test_loss_is_the_mean_over_valid_steps_alone(stage):
    agent, windows = new_agent(stage[0], step=stage[1]), random_windows()
    alone = [agent.loss(type(windows)(*(x[i : i + 1] for x in windows)), None)[0].item() for i in range(8)]
    whole = agent.loss(windows, None)[0].item()
    assert whole == pytest.approx(np.average(alone, weights=windows.mask.sum(axis=1)), rel=1e-5)


@pytest.mark.parametrize("step", range(K - 1))
def test_changing_the_future_changes_no_earlier_output(transformer_stage, step):
    agent, windows = new_agent(transformer_stage[0], step=transformer_stage[1]), random_windows()
    future = np.zeros((8, K), dtype=bool)
    future[:, step + 1 :] = True
    before, after = trunk_outputs(agent, windows), trunk_outputs(agent, changed(windows, future))
    assert torch.equal(before[:, : step + 1], after[:, : step + 1])
    assert not torch.equal(before[:, step + 1 :], after[:, step + 1 :])


def test_a_steps_own_action_is_seen_by_its_last_token_only(transformer):
    agent, windows = new_agent(transformer), random_windows()
    other = windows._replace(actions=windows.actions.copy())
    other.actions[:, -1] += 1.0
    before, after = trunk_outputs(agent, windows), trunk_outputs(agent, other)
    assert torch.equal(before[:, :-1], after[:, :-1])
    assert torch.equal(before[:, -1, :-1], after[:, -1, :-1])
    assert not torch.equal(before[:, -1, -1], after[:, -1, -1])


def test_overfits_eight_windows(name):
    agent = new_agent(name, **({"embedding": 32} if name in TRANSFORMERS else {}))
    windows = random_windows((0, 2, 5, 9, 12, 14, 17, 19))
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-2)
    first, _ = agent.loss(windows, None)
    for _ in range(400):
        loss, parts = agent.loss(windows, None)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.02 * first
    assert all(part < 0.1 for part in parts.values())


def learned(name, seed, steps=5):
    dataset = random_dataset()
    sampler = WindowSampler(dataset, K, dataset.normalization())
    learner = Learner(name, tiny_config(name), hopper_spec(), seed)
    for _ in range(steps):
        learner.update(sampler)
    return learner


def test_same_seed_same_parameters_and_no_global_randomness(name):
    before = torch.get_rng_state()
    first = learned(name, seed=3).checkpoint()
    assert torch.equal(torch.get_rng_state(), before)
    torch.rand(5)
    again, other = learned(name, seed=3).checkpoint(), learned(name, seed=4).checkpoint()
    for parameter, value in first.parameters.items():
        assert torch.equal(value, again.parameters[parameter]), parameter
    assert any(not torch.equal(value, other.parameters[key]) for key, value in first.parameters.items())


def test_dropout_is_drawn_from_the_generator(transformer):
    agent, windows = new_agent(transformer), random_windows()
    losses = [agent.loss(windows, torch.Generator().manual_seed(seed))[0].item() for seed in (1, 1, 2)]
    assert losses[0] == losses[1] != losses[2]
    assert losses[0] != agent.loss(windows, None)[0].item() == agent.loss(windows, None)[0].item()


def test_acting_leaves_the_agent_as_it_is(name):
    agent = new_agent(name)
    observations = np.random.default_rng(0).normal(size=(4, S))
    actions = {}
    for training in (True, False):
        agent.train(training)
        policy = agent.policy()
        actions[training], _ = policy.predict(observations, deterministic=True)
        assert all(module.training is training for module in agent.modules())
    assert np.array_equal(actions[True], actions[False])
    assert all(parameter.requires_grad and parameter.grad is None for parameter in agent.parameters())


def test_its_policy_is_one_for_the_benchmark(name):
    policy = new_agent(name).policy()
    assert isinstance(policy, Policy)
    assert isinstance(policy, RewardAware) or name not in TRANSFORMERS
    assert new_agent(name).policy() is not policy
    actions, _ = policy.predict(np.zeros((4, S)))
    assert actions.shape == (4, A)
    assert actions.dtype == np.float32


def test_actions_stay_in_the_action_space(name):
    limit = np.array([0.4, 1.0, 2.0], np.float32)
    spec = dataclasses.replace(hopper_spec(), action_limit=limit)
    agent = AGENTS[name][1](tiny_config(name), spec, torch.Generator().manual_seed(0))
    with torch.no_grad():
        for parameter in agent.parameters():
            parameter.mul_(30)
    actions, _ = agent.policy().predict(np.random.default_rng(0).normal(size=(200, S)))
    assert (np.abs(actions) <= limit).all()
    assert (np.abs(actions).max(axis=0) > 0.9 * limit).all()


def test_wrong_shapes_are_refused_by_the_loss(transformer_stage):
    windows = random_windows()
    with pytest.raises(AssertionError):
        new_agent(transformer_stage[0], step=transformer_stage[1]).loss(
            windows._replace(observations=windows.observations[..., :-1]), None
        )


def copying_data(gains, rng):
    """One-dimensional episodes of 10 steps: the action is gain · state, and rewarded where the gain is positive."""
    states = [rng.uniform(-1, 1, size=(11, 1)) for _ in gains]
    actions = [gain * s[:-1] for gain, s in zip(gains, states, strict=True)]
    return flat_dataset(states, actions, [np.full(10, float(gain > 0)) for gain in gains])


def test_solves_a_one_dimensional_copying_task(name):
    rng = np.random.default_rng(0)
    conditioned = "target_return" in {field.name for field in dataclasses.fields(AGENTS[name][0])}
    # who imitates a wanted return is shown bad episodes too, and told by the return which is which
    dataset = copying_data([0.8, -0.8] * 50 if conditioned else [0.8] * 100, rng)
    wanted = {"target_return": 10.0, "return_scale": 10.0} if conditioned else {}
    wanted |= {"dropout": 0.0} if name in TRANSFORMERS else {}
    # who learns in phases has the first half of the steps for actions
    config = tiny_config(name, steps=1000, learning_rate=3e-3, batch_size=32, **wanted)
    spec = RobotSpec("Hopper", np.ones(1, np.float32), Normalization(np.zeros(1, np.float32), np.ones(1, np.float32)))
    learner = Learner(name, config, spec, seed=0)
    sampler = WindowSampler(dataset, config.context, spec.normalization)
    for _ in range(500):
        learner.update(sampler)
    assert largest_error(learner.agent, 0.8, 1.0, rng) < 0.15
    if conditioned:
        agent = AGENTS[name][1](dataclasses.replace(config, target_return=0.0), spec, torch.Generator())
        agent.load_state_dict(dict(learner.agent.named_parameters()))
        assert largest_error(agent, -0.8, 0.0, rng) < 0.15


def loss_curve(name, precision, steps=160):
    """Mean losses of 40 steps each, on copying data with dropout; of the first phase, where there are two."""
    dataset = copying_data([0.8] * 50, np.random.default_rng(0))
    spec = RobotSpec("Hopper", np.ones(1, np.float32), Normalization(np.zeros(1, np.float32), np.ones(1, np.float32)))
    config = tiny_config(name, steps=2 * steps, embedding=32, batch_size=32, precision=precision)
    learner = Learner(name, config, spec, seed=0)
    sampler = WindowSampler(dataset, config.context, spec.normalization)
    losses = [learner.update(sampler)["loss"] for _ in range(steps)]
    return np.reshape(losses, (-1, 40)).mean(axis=1)


def test_both_precisions_learn_the_same(transformer):
    exact, rounded = loss_curve(transformer, "float32"), loss_curve(transformer, "bfloat16")
    assert exact[-1] < 0.2 * exact[0]
    assert not np.array_equal(exact, rounded)
    np.testing.assert_allclose(rounded, exact, rtol=0.03)


def largest_error(agent, gain, reward, rng):
    """Of actions from gain · state, in an episode of 10 steps rewarded as the data of that gain are."""
    policy, errors = agent.policy(), []
    for _ in range(10):
        states = rng.uniform(-1, 1, size=(20, 1))
        actions, _ = policy.predict(states)
        if isinstance(policy, RewardAware):
            policy.observe(np.full(20, reward))
        errors.append(np.abs(actions - gain * states).max())
    return max(errors)
