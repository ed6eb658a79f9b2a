"""FOCAL: each part of its loss against hand-computed values, what reaches which net, and how it acts."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.context import transitions_of
from agents.focal import FOCAL, FOCALConfig, dual_divergence
from agents.learner import Learner
from agents.transitions import TaskSampler
from dynagen_bench.evaluation import Policy, RewardAware, evaluate
from tests.agents.samples import A, S, flat_dataset, hopper_spec, random_dataset

TINY = {"tasks": 3, "context": 4, "batch_size": 8, "hidden": 16, "encoder_hidden": 16, "latent": 5, "steps": 20}


def three_dynamics(lengths=(9, 8, 12, 7, 6, 10)):
    return dataclasses.replace(random_dataset(lengths), episode_dynamics=np.arange(len(lengths)) % 3)


class Known(torch.nn.Module):
    """In place of a net: a function that is known."""

    def __init__(self, function) -> None:
        super().__init__()
        self.function = function

    def forward(self, x):
        return self.function(x)


def agent_and_batch(**changes):
    config = FOCALConfig(**(TINY | changes))
    dataset = three_dynamics()
    sampler = config.sampler(dataset, dataset.normalization())
    agent = FOCAL(config, hopper_spec(), torch.Generator().manual_seed(0))
    return agent, sampler.sample(config.batch_size, np.random.default_rng(0))


def learner_and_sampler(seed=0, **changes):
    config = FOCALConfig(**(TINY | changes))
    dataset = three_dynamics()
    return Learner("focal", config, hopper_spec(), seed), config.sampler(dataset, dataset.normalization())


def test_distances_by_hand():
    agent, _ = agent_and_batch()
    z = torch.tensor([[[0.0, 0.0], [2.0, 0.0]], [[0.0, 2.0], [0.0, 4.0]]])  # two dynamics, two sets of each
    near = 2 * (2 + 1e-3) ** 0.5 / (2 + 1e-3)  # mean over two elements: (4 + 0) / 2 = 2 in both pairs
    far = (1 / 2.1 + 1 / 8.1 + 1 / 4.1 + 1 / 10.1) / (4 + 1e-3)
    assert agent._distances(z).item() == pytest.approx(near + far, rel=1e-6)


def test_released_code_never_brings_sets_of_one_dynamics_together():
    agent, batch = agent_and_batch(variant="as_released")
    assert batch.rewards.shape == (3, 8 + 4)
    z = torch.tensor([[[0.0, 0.0]], [[0.0, 2.0]]])
    assert agent._distances(z).item() == pytest.approx(1 / 2.1 / (1 + 1e-3), rel=1e-6)


def test_divergence_by_hand():
    softplus = np.log1p(np.e)
    found = dual_divergence(torch.tensor([1.0, 0.0]), torch.tensor([1.0, -50.0]))
    np.testing.assert_allclose(found, [1 + np.log(softplus) - softplus, 1 + np.log(np.log(2))], rtol=1e-5)


def test_penalty_is_of_the_gradient_and_as_released_of_the_output():
    for variant, expected in (("paper", 5.0 * (2.0 - 1) ** 2), ("as_released", 5.0 * (3.0 - 1) ** 2)):
        agent, _ = agent_and_batch(variant=variant)
        agent.c = Known(lambda x: (3.0 + 2.0 * x[:, S : S + 1])[None])  # 3 at action 0, slope 2 by the first action
        s, a, z, three = torch.zeros(2, S), torch.zeros(2, A), torch.zeros(2, 5), torch.full((2,), 3.0)
        loss = agent._divergence_loss(s, a, z, a, three, None) + dual_divergence(three, three).mean()
        assert loss.item() == pytest.approx(expected, rel=1e-5)


def test_critics_learn_from_what_follows_and_not_past_an_end():
    agent, _ = agent_and_batch(discount=0.5, reward_scale=2.0)
    agent.q = Known(lambda x: torch.zeros(2, len(x), 1))
    agent.v = Known(lambda x: torch.zeros(1, len(x), 1))
    agent.slow_v = Known(lambda x: torch.full((1, len(x), 1), 10.0))
    s, a, z = torch.zeros(2, S), torch.zeros(2, A), torch.zeros(2, 5)
    losses = agent._critic_losses(
        s, a, torch.tensor([1.0, 1.0]), s, torch.tensor([False, True]), z, torch.tensor([-3.0, -5.0])
    )
    assert losses["q_loss"].item() == pytest.approx(2 * (7.0**2 + 2.0**2) / 2)  # 2 · 1 + 0.5 · 10, and 2 · 1
    assert losses["v_loss"].item() == pytest.approx((3.0**2 + 5.0**2) / 2)


@pytest.mark.parametrize(
    ("part", "nets"),
    [("encoder_loss", "encoder"), ("q_loss", "q"), ("v_loss", "v"), ("c_loss", "c"), ("actor_loss", "actor")],
)
def test_each_loss_reaches_its_own_net_alone(part, nets):
    agent, batch = agent_and_batch()
    _, parts = agent.loss(batch, torch.Generator().manual_seed(0))
    parts[part].backward()
    reached = {name.split(".")[0] for name, p in agent.named_parameters() if p.grad is not None}
    assert reached == {nets}


def test_slow_copy_and_alpha_follow():
    agent, _ = agent_and_batch(follow=0.25, alpha=3.0, target_divergence=0.5)
    with torch.no_grad():
        for parameter in agent.v.parameters():
            parameter.add_(4.0)
    before = [p.clone() for p in agent.slow_v.parameters()]
    agent.follow({"divergence": 2.5})
    for slow, old in zip(agent.slow_v.parameters(), before, strict=True):
        torch.testing.assert_close(slow, old + 1.0)
    assert agent.alpha.item() == 5.0
    agent.follow({"divergence": -100.0})
    assert agent.alpha.item() == 0.0
    agent, _ = agent_and_batch(alpha=3.0, target_divergence=0.5, variant="as_released")
    agent.follow({"divergence": -9.5})
    assert agent.alpha.item() == -7.0  # it winds up, and is clipped where it is used


def test_same_seed_same_parameters_and_a_continued_run_is_the_same(tmp_path):
    whole, sampler = learner_and_sampler(seed=3)
    before = torch.get_rng_state()
    for _ in range(6):
        whole.update(sampler)
    assert torch.equal(torch.get_rng_state(), before)
    half, _ = learner_and_sampler(seed=3)
    for _ in range(3):
        half.update(sampler)
    save_checkpoint(tmp_path / "last.safetensors", half.checkpoint())
    again, _ = learner_and_sampler(seed=5)
    again.seed = 3
    again.restore(load_checkpoint(tmp_path / "last.safetensors", agent="focal", robot="Hopper"))
    for _ in range(3):
        again.update(sampler)
    for name, value in whole.checkpoint().parameters.items():
        assert torch.equal(value, again.checkpoint().parameters[name]), name


def test_data_that_are_not_finite_stop_it():
    learner, sampler = learner_and_sampler()
    batch = sampler.sample(8, np.random.default_rng(0))
    batch.rewards[0, 0] = np.nan
    with pytest.raises(FloatingPointError, match="at step 0"):
        learner.update(type("Broken", (), {"sample": lambda *_: batch})())


def test_it_acts_alone_as_beside_others_bit_for_bit():
    agent, _ = agent_and_batch()
    rng = np.random.default_rng(0)
    observations, rewards = rng.normal(size=(4, 13, S)), rng.normal(size=(4, 13))

    def actions(lanes):
        policy, found = agent.policy(), []
        for step in range(4):
            found.append(policy.predict(observations[step, lanes])[0])
            policy.observe(rewards[step, lanes])
        return np.stack(found)

    together = actions(slice(None))
    assert np.abs(together).max() <= 1.0
    for lane in range(13):
        assert np.array_equal(together[:, lane], actions(slice(lane, lane + 1))[:, 0])


def test_z_is_the_mean_of_the_episodes_own_transitions():
    agent, _ = agent_and_batch()
    seen = []
    agent._act = lambda known: seen.append(known.z.clone()) or torch.zeros(len(known.z), A)
    policy = agent.policy()
    observations = np.random.default_rng(0).normal(size=(3, 2, S))
    for step in range(3):
        policy.predict(observations[step], episode_start=np.array([step == 0, step in (0, 2)]))
        policy.observe(np.array([step, 2.0 * step]))
    normal = [torch.from_numpy(agent.spec.normalization.apply(x)) for x in observations]
    none = torch.zeros(2, A)
    first = transitions_of(normal[0], none, torch.zeros(2), normal[1])
    second = transitions_of(normal[1], none, torch.tensor([1.0, 2.0]), normal[2])
    torch.testing.assert_close(seen[0][:2], torch.zeros(2, 5))
    torch.testing.assert_close(seen[1][:2], agent.encode(first[:, None]).detach())
    torch.testing.assert_close(seen[2][0], agent.encode(torch.stack((first, second), dim=1)).detach()[0])
    assert not seen[2][1].any()  # a new episode has shown nothing yet


def test_given_data_are_what_it_acts_by():
    agent, _ = agent_and_batch()
    dataset = random_dataset((4, 5))
    steps = TaskSampler(dataset, agent.spec.normalization, 1).everything()
    z = agent.encode(transitions_of(*(torch.from_numpy(x[0]) for x in steps[:4]))).detach()
    observation = np.ones((1, S))
    policy = agent.policy_given(dataset)
    for _ in range(2):  # it stays, whatever the episode shows
        actions, _ = policy.predict(observation)
        policy.observe(np.ones(1))
        normal = torch.from_numpy(agent.spec.normalization.apply(observation))
        expected = agent.actor.best(torch.cat((normal, z[None]), dim=1))[0].detach()
        np.testing.assert_allclose(actions, expected, rtol=1e-5, atol=1e-6)
    with pytest.raises(ValueError, match="3 dynamics"):
        agent.policy_given(three_dynamics())


def test_its_policy_is_one_for_the_benchmark():
    agent, _ = agent_and_batch()
    policy = agent.policy()
    assert isinstance(policy, Policy)
    assert isinstance(policy, RewardAware)
    assert evaluate(policy, "Hopper", indices=[0], episodes=2).returns.shape == (1, 2)
    with pytest.raises(ValueError, match=r"observations have shape \(2, 3\)"):
        policy.predict(np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"rewards have shape \(5,\)"):
        policy.observe(np.zeros(5))


def test_it_tells_dynamics_apart_that_look_alike_and_acts_for_each():
    """One state; action a gives reward g · a, and the next state shows nothing: g is ±1 by dynamics."""
    rng = np.random.default_rng(0)
    gains = [1.0, -1.0]
    data = [rng.uniform(-1, 1, size=(50, 1)) for _ in range(8)]
    dataset = flat_dataset(
        [rng.normal(0, 0.01, size=(51, 1)) for _ in data],
        data,
        [gains[i % 2] * actions[:, 0] for i, actions in enumerate(data)],
    )
    dataset = dataclasses.replace(dataset, episode_dynamics=np.arange(8) % 2, episode_terminated=np.ones(8, np.bool_))
    spec = dataclasses.replace(
        hopper_spec(), action_limit=np.ones(1, np.float32), normalization=dataset.normalization()
    )
    config = FOCALConfig(
        tasks=2, context=16, batch_size=64, hidden=32, encoder_hidden=32, latent=2, learning_rate=3e-3,
        discount=0.0, alpha=0.1, alpha_max=0.1,
    )  # fmt: skip
    learner = Learner("focal", config, spec, 0)
    sampler = config.sampler(dataset, spec.normalization)
    for _ in range(300):
        learner.update(sampler)
    observation = np.zeros((1, 1))
    for dynamics, gain in enumerate(gains):
        given = learner.agent.policy_given(dataset.select(np.flatnonzero(dataset.episode_dynamics == dynamics)))
        assert gain * given.predict(observation)[0].item() > 0.5


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"tasks": 1}, "tasks is 1"), ({"variant": "mine"}, "give paper or as_released"), ({"discount": 1.5}, "discount")],
)
def test_bad_configs_are_one_line(changes, words):
    with pytest.raises(ValueError, match=words):
        FOCALConfig(**changes)


def test_actor_and_value_by_hand():
    """The actor draws around 0 with deviation 1; Q₁ is 5 and Q₂ 2, and c is 1 everywhere."""
    agent, batch = agent_and_batch(alpha=3.0, actor_penalty=0.0)
    with torch.no_grad():
        for parameter in agent.actor.parameters():
            parameter.zero_()
    agent.q = Known(lambda x: torch.tensor([5.0, 2.0])[:, None, None].expand(2, len(x), 1))
    agent.v = Known(lambda x: torch.zeros(1, len(x), 1))
    agent.c = Known(lambda x: (1.0 + 0.0 * x[:, S : S + 1])[None])
    _, parts = agent.loss(batch, None)
    log_probability = -A / 2 * np.log(2 * np.pi)
    softplus = np.log1p(np.e)
    divergence = 1 + np.log(softplus) - softplus
    assert parts["divergence"].item() == pytest.approx(divergence, rel=1e-5)
    assert parts["actor_loss"].item() == pytest.approx(log_probability - 2.0 + 3.0 * divergence, rel=1e-5)
    assert parts["v_loss"].item() == pytest.approx((2.0 - log_probability) ** 2, rel=1e-5)
