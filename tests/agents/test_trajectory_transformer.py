"""Trajectory Transformer: its loss, its way to a checkpoint, and that its plans are good ones."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.interface import Agent, Fitted, RobotSpec
from agents.learner import Learner
from agents.trajectory_transformer import TrajectoryTransformer, TrajectoryTransformerConfig
from dynagen_bench.datasets import Normalization
from dynagen_bench.evaluation import Policy, RewardAware, evaluate
from tests.agents.samples import A, S, flat_dataset, hopper_spec, random_dataset

NAME = "trajectory_transformer"
TINY = {"layers": 1, "heads": 2, "embedding": 16, "context": 4, "batch_size": 8, "warmup_steps": 5, "bins": 8}
TINY |= {"learning_rate": 3e-3, "precision": "float32", "horizon": 2, "beams": 3, "memory": 2}


def tiny_config(**changes) -> TrajectoryTransformerConfig:
    return TrajectoryTransformerConfig(**(TINY | changes))


def dataset_with_ends(lengths=(9, 3, 12)):
    """Of noise; the second episode ends by itself."""
    dataset = random_dataset(lengths)
    return dataclasses.replace(dataset, episode_terminated=np.arange(len(lengths)) == 1)


def fitted_learner(seed: int = 0, **changes) -> tuple[Learner, object]:
    """A learner on `dataset_with_ends`, and its sampler."""
    dataset, config = dataset_with_ends(), tiny_config(**changes)
    learner = Learner(NAME, config, hopper_spec(), seed)
    sampler = config.sampler(dataset, hopper_spec().normalization)
    learner.agent.fit(sampler)
    return learner, sampler


def some_windows(sampler, steps=(0, 7, 8, 9, 11, 13, 20, 23)):
    """Eight trajectories: some are cut off, some end by themselves."""
    return sampler.at(np.array(steps))


def gradients(agent, windows):
    agent.zero_grad()
    loss, _ = agent.loss(windows, None)
    loss.backward()
    return loss.detach(), {key: value.grad for key, value in agent.named_parameters() if value.grad is not None}


def test_it_is_what_the_loop_and_the_evaluation_ask_for():
    learner, _ = fitted_learner()
    for protocol in (Agent, Fitted):
        assert isinstance(learner.agent, protocol)
    policy = learner.agent.policy()
    assert isinstance(policy, Policy)
    assert isinstance(policy, RewardAware)
    assert learner.agent.policy() is not policy


def test_loss_reaches_every_parameter_but_the_thresholds():
    learner, sampler = fitted_learner()
    _, grads = gradients(learner.agent, some_windows(sampler))
    assert grads.keys() == {key for key, _ in learner.agent.named_parameters()} - {"discretizer.thresholds"}


def test_loss_ignores_padding():
    learner, sampler = fitted_learner()
    windows = some_windows(sampler)
    assert not windows.mask.all()
    assert windows.ended.any()
    noise = np.random.default_rng(0).normal(size=windows.rows.shape).astype(np.float32)
    unknown = (~windows.mask | windows.ended)[:, :, None]  # what has ended is stop, whatever stands there
    loss, grads = gradients(learner.agent, windows)
    other_loss, other_grads = gradients(learner.agent, windows._replace(rows=np.where(unknown, noise, windows.rows)))
    assert torch.equal(loss, other_loss)
    for key, grad in grads.items():
        torch.testing.assert_close(grad, other_grads[key], rtol=1e-5, atol=1e-7)


def test_loss_is_the_weighted_mean_over_what_is_known():
    learner, sampler = fitted_learner(action_weight=5.0, reward_weight=2.0, value_weight=3.0)
    agent, windows = learner.agent, some_windows(sampler)
    each = [agent.loss(type(windows)(*(x[i : i + 1] for x in windows)), None) for i in range(8)]
    known = windows.mask.sum(axis=1)
    predicted = known * (S + A + 2) - 1
    whole, parts = agent.loss(windows, None)
    assert whole.item() == pytest.approx(np.average([x.item() for x, _ in each], weights=predicted), rel=1e-5)
    counts = np.array([known.sum() * S - 8, known.sum() * A, known.sum(), known.sum()])
    values = np.array([parts[f"{kind}_loss"].item() for kind in ("state", "action", "reward", "value")])
    assert whole.item() == pytest.approx((counts * values * [1, 5, 2, 3]).sum() / counts.sum(), rel=1e-5)


def test_after_the_end_it_is_stop_that_is_learned():
    learner, sampler = fitted_learner(learning_rate=1e-2, dropout=0.0)
    windows = some_windows(sampler, (10, 10))  # the second of three steps, the last of which ended the episode
    assert windows.ended.tolist() == [[False, False, True, True]] * 2
    for _ in range(60):
        loss, _ = learner.agent.loss(windows, None)
        learner.optimizer.zero_grad()
        loss.backward()
        for group in learner.optimizer.param_groups:
            group["lr"] = 1e-2
        learner.optimizer.step()
    tokens = learner.agent.discretizer.encode(torch.from_numpy(windows.rows))
    logits = learner.agent.net.logits(tokens.masked_fill(torch.from_numpy(windows.ended)[:, :, None], 8))
    assert (logits[:, 2:].argmax(dim=3) == 8).all()
    assert (logits[:, :2].argmax(dim=3).flatten(1)[:, 1:] < 8).all()


def test_overfits_eight_trajectories():
    learner, sampler = fitted_learner(embedding=32, dropout=0.0)
    windows = some_windows(sampler)
    optimizer = torch.optim.Adam(learner.agent.parameters(), lr=1e-2)
    first, _ = learner.agent.loss(windows, None)
    for _ in range(200):
        loss, parts = learner.agent.loss(windows, None)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    # what a trajectory begins with is told by its first number alone
    assert loss < 0.05 * first
    assert all(part < 0.2 for part in parts.values())


def learned(seed, steps=5, **changes) -> Learner:
    learner, sampler = fitted_learner(seed, **changes)
    for _ in range(steps):
        learner.update(sampler)
    return learner


def test_same_seed_same_parameters_and_no_global_randomness():
    before = torch.get_rng_state()
    first = learned(seed=3).checkpoint()
    assert torch.equal(torch.get_rng_state(), before)
    torch.rand(5)
    again, other = learned(seed=3).checkpoint(), learned(seed=4).checkpoint()
    for parameter, value in first.parameters.items():
        assert torch.equal(value, again.parameters[parameter]), parameter
    assert any(not torch.equal(value, other.parameters[key]) for key, value in first.parameters.items())


def test_dropout_is_drawn_from_the_generator():
    learner, sampler = fitted_learner()
    windows = some_windows(sampler)
    losses = [learner.agent.loss(windows, torch.Generator().manual_seed(seed))[0].item() for seed in (1, 1, 2)]
    assert losses[0] == losses[1] != losses[2]
    assert losses[0] != learner.agent.loss(windows, None)[0].item()


def test_both_precisions_learn_the_same():
    losses = []
    for precision in ("float32", "bfloat16"):
        learner, sampler = fitted_learner(precision=precision, batch_size=32)
        losses.append([learner.update(sampler)["loss"] for _ in range(80)])
    exact, rounded = np.reshape(losses, (2, -1, 40)).mean(axis=2)
    assert exact[-1] < 0.9 * exact[0]
    assert not np.array_equal(exact, rounded)
    np.testing.assert_allclose(rounded, exact, rtol=0.02)


def test_training_leaves_the_thresholds_as_they_are():
    fresh, _ = fitted_learner()
    assert torch.equal(learned(seed=0).agent.discretizer.thresholds, fresh.agent.discretizer.thresholds)


def random_steps(lanes: int, steps: int = 7):
    rng = np.random.default_rng(0)
    return rng.normal(size=(steps, lanes, S)), rng.uniform(0, 3, size=(steps, lanes))


def test_from_a_checkpoint_it_plans_and_goes_on_as_before(tmp_path):
    learner = learned(seed=0)
    save_checkpoint(tmp_path / "last.safetensors", learner.checkpoint())
    found = load_checkpoint(tmp_path / "last.safetensors", agent=NAME, robot="Hopper")
    assert found.config == learner.config
    observations, _ = random_steps(3)
    actions = [agent.policy().predict(observations[0])[0] for agent in (learner.agent, found.build_agent())]
    assert np.array_equal(*actions)
    again, sampler = fitted_learner()
    again.restore(found)
    assert again.update(sampler) == learner.update(sampler)


def actions_of_lanes(agent, lanes):
    """Actions (T, N, A) in some of 13 episodes; the seventh begins anew at step 3."""
    observations, rewards = random_steps(13)
    policy, actions = agent.policy(), []
    for t in range(len(rewards)):
        starts = np.array([t == 0 or (lane == 6 and t == 3) for lane in lanes])
        actions.append(policy.predict(observations[t, lanes], episode_start=starts)[0])
        policy.observe(rewards[t, lanes])
    return np.stack(actions)


@pytest.mark.parametrize("plan_every", [1, 2])
def test_episodes_act_alone_as_they_do_together_bit_for_bit(plan_every):
    agent = learned(seed=0, embedding=64, plan_every=plan_every).agent
    together = actions_of_lanes(agent, list(range(13)))
    assert together.dtype == np.float32
    assert len(np.unique(together[:, :, 0])) > 2
    for lane in (0, 6, 12):
        assert np.array_equal(actions_of_lanes(agent, [lane])[:, 0], together[:, lane])


def test_plans_begin_with_the_tokens_of_training():
    learner, sampler = fitted_learner()
    dataset, shown = dataset_with_ends(), []

    def plan(history):
        t = len(shown)
        shown.append((history, learner.agent._tokens(history)))
        return torch.from_numpy(dataset.actions[t]).expand(len(history.mask), 2, A)

    learner.agent.plan = plan
    policy = learner.agent.policy()
    for t in range(9):
        policy.predict(dataset.observations[t : t + 1], episode_start=np.array([t == 0]))
        policy.observe(dataset.rewards[t : t + 1])
    middles = learner.agent.discretizer.decode
    for t, (history, tokens) in enumerate(shown):
        first = max(0, t - 2)
        rows = torch.from_numpy(sampler.rows(np.arange(first, t + 1)))
        expected = learner.agent.discretizer.encode(rows)
        assert torch.equal(tokens[0, :-1, : S + A], expected[:-1, : S + A])
        assert torch.equal(tokens[0, -1, :S], expected[-1, :S])
        rewards = history.returns_to_go[0, :-1] - history.returns_to_go[0, 1:]
        torch.testing.assert_close(rewards, rows[:-1, S + A], rtol=1e-4, atol=1e-4)
        assert middles(tokens).isfinite().all()


def copying_data(rng, episodes: int = 120):
    """One-dimensional episodes of 6 steps: the action is ± 0.8 · state, and rewarded where it is +."""
    states = [rng.uniform(-1, 1, size=(7, 1)) for _ in range(episodes)]
    signs = [rng.choice([-1.0, 1.0], size=(6, 1), p=[0.7, 0.3]) for _ in range(episodes)]
    actions = [0.8 * sign * s[:-1] for sign, s in zip(signs, states, strict=True)]
    return flat_dataset(states, actions, [(sign[:, 0] > 0).astype(float) for sign in signs])


def test_plans_take_the_actions_that_are_rewarded_not_those_that_are_frequent():
    rng = np.random.default_rng(0)
    dataset = copying_data(rng)
    changes = {"bins": 12, "embedding": 32, "batch_size": 64, "context": 2, "horizon": 1, "memory": 1, "layers": 2}
    config = tiny_config(**changes, dropout=0.0, weight_decay=0.0, learning_rate=1e-2, cdf=0.1, beams=16)
    spec = RobotSpec("Hopper", np.ones(1, np.float32), Normalization(np.zeros(1, np.float32), np.ones(1, np.float32)))
    learner = Learner(NAME, config, spec, seed=0)
    sampler = config.sampler(dataset, spec.normalization)
    learner.agent.fit(sampler)
    for _ in range(250):
        learner.update(sampler)
    states = rng.uniform(-1, 1, size=(5, 40, 1))
    states = states[np.abs(states) > 0.2].reshape(-1)[:120].reshape(4, 30, 1)  # of others the sign is no matter
    policy = learner.agent.policy()
    errors = []
    for now in states:
        actions, _ = policy.predict(now)
        policy.observe(np.ones(30))
        errors.append(np.abs(actions - 0.8 * now))
    assert np.mean(np.concatenate(errors) < 0.2) > 0.85


def test_actions_stay_in_the_action_space():
    limit = np.array([0.1, 0.2, 0.3], np.float32)
    config = tiny_config()
    spec = dataclasses.replace(hopper_spec(), action_limit=limit)
    agent = TrajectoryTransformer(config, spec, torch.Generator().manual_seed(0))
    agent.fit(config.sampler(dataset_with_ends(), spec.normalization))  # of actions in ± 1
    actions, _ = agent.policy().predict(np.random.default_rng(0).normal(size=(20, S)))
    assert (np.abs(actions) <= limit).all()
    assert (np.abs(actions) == limit).any()


def test_evaluation_runs_on_hopper():
    learner, _ = fitted_learner()
    policy = learner.agent.policy()
    found = evaluate(policy, "Hopper", "test", indices=[0], episodes=2)
    assert np.isfinite(found.returns).all()
    again = evaluate(learner.agent.policy(), "Hopper", "test", indices=[0], episodes=2)
    assert np.array_equal(found.returns, again.returns)


def test_an_agent_that_was_not_fitted_says_so():
    agent = TrajectoryTransformer(tiny_config(), hopper_spec(), torch.Generator().manual_seed(0))
    with pytest.raises(RuntimeError, match="no thresholds: fit it to training data"):
        agent.policy().predict(np.zeros((1, S)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("horizon", 5), ("plan_every", 3), ("cdf", 1.5), ("beams", 0), ("bins", 1), ("termination_penalty", "none")],
)
def test_fields_are_checked(field, value):
    with pytest.raises(ValueError, match=f"{field} is {value!r}: give a"):
        tiny_config(**{field: value})


def test_defaults_are_the_originals_with_the_reduced_budget():
    config = TrajectoryTransformerConfig()
    assert (config.context, config.bins, config.layers, config.heads, config.embedding) == (10, 100, 4, 4, 128)
    assert (config.horizon, config.beams, config.expand, config.memory) == (5, 32, 2, 5)
    assert tiny_config(termination_penalty=None).termination_penalty is None
