"""MerPO: each part of its loss by hand, what reaches which net, its phases, a new dynamics, and how it acts."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.interface import Agent, Following, ForTask, Phased
from agents.learner import Learner
from agents.merpo.agent import Imagined, MerPO, MerPOConfig
from agents.merpo.world_model import Steps
from agents.train import train
from dynagen_bench.evaluation import Policy, RewardAware, evaluate
from tests.agents.samples import A, S, flat_dataset, hopper_spec, random_dataset
from tests.agents.test_train import settings

TINY = {
    "tasks": 3, "batch_size": 8, "starts": 4, "rollout": 2, "hidden": 16, "layers": 1, "model_hidden": 16,
    "model_layers": 1, "members": 2, "steps": 20, "learning_rate": 1e-3,
}  # fmt: skip
LATER = 19  # a step of the second phase


def three_dynamics(lengths=(9, 8, 12, 7, 6, 10)):
    return dataclasses.replace(random_dataset(lengths), episode_dynamics=np.arange(len(lengths)) % 3)


def agent_and_batch(step=0, **changes):
    config = MerPOConfig(**(TINY | changes)).for_robot("Hopper")
    dataset = three_dynamics()
    agent = MerPO(config, hopper_spec(), generator())
    agent.begin(step)
    sampler = config.sampler(dataset, dataset.normalization())
    return agent, sampler.sample(config.batch_size, np.random.default_rng(0))


def learner_and_sampler(seed=0, **changes):
    config = MerPOConfig(**(TINY | changes)).for_robot("Hopper")
    dataset = three_dynamics()
    return Learner("merpo", config, hopper_spec(), seed), config.sampler(dataset, dataset.normalization())


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def zeros(tasks, rows, terminal=False, rewards=0.0):
    """Steps that have nothing but rewards and ends."""
    s, a = torch.zeros(tasks, rows, S), torch.zeros(tasks, rows, A)
    return Steps(s, a, torch.full((tasks, rows), rewards), s, torch.full((tasks, rows), terminal))


class Always(torch.nn.Module):
    """In place of a net: what it says of each row is known."""

    def __init__(self, *values) -> None:
        super().__init__()
        self.values = values

    def forward(self, x):
        return torch.cat([torch.full((len(x) // len(self.values), x.shape[1], 1), v) for v in self.values])


class TimesState(torch.nn.Module):
    """In place of a net: so many times the first number of its input."""

    def __init__(self, factor) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, x):
        return self.factor * x[:, :, :1]


@pytest.mark.parametrize(("share", "terminal"), [(0.5, False), (0.25, False), (1.0, True)])
def test_evaluation_by_hand(share, terminal):
    agent, _ = agent_and_batch(LATER, discount=0.5, real_share=share, beta=2.0)
    agent.slow_q, agent.q = Always(10.0, 12.0), Always(1.0, 3.0)
    weight = torch.tensor([0.75, 0.25]).expand(3, 2)
    imagined = Imagined(zeros(3, 2, rewards=-1.0), torch.zeros(3, 2, A), weight)
    loss, gap = agent._evaluation(zeros(3, 5, terminal, rewards=2.0), imagined, generator())
    real, other = (2.0 if terminal else 2.0 + 0.5 * 10), -1.0 + 0.5 * 10
    squares = [share * (q - real) ** 2 + (1 - share) * (q - other) ** 2 for q in (1.0, 3.0)]
    assert gap.item() == pytest.approx(0.0, abs=1e-6)  # the critics say the same of both
    assert loss.item() == pytest.approx(3 * 0.5 * sum(squares), rel=1e-5)


def test_conservatism_is_the_difference_of_means():
    agent, _ = agent_and_batch(LATER, beta=2.0, real_share=0.5)
    agent.q, agent.slow_q = TimesState(3.0), Always(0.0, 0.0)
    data, made = zeros(3, 2), zeros(3, 4)
    data.observations[:, :, 0], made.observations[:, :, 0] = (
        torch.tensor([1.0, 2.0]),
        torch.tensor([1.0, 4.0, 7.0, 8.0]),
    )
    imagined = Imagined(made, torch.zeros(3, 4, A), torch.tensor([0.5, 0.25, 0.25, 0.0]).expand(3, 4))
    loss, gap = agent._evaluation(data, imagined, generator())
    assert gap.item() == pytest.approx(3 * (3.25 - 1.5))
    squares = 0.5 * (1 + 4) / 2 + 0.5 * (0.5 * 1 + 0.25 * 16 + 0.25 * 49)
    assert loss.item() == pytest.approx(3 * 2 * (2.0 * 5.25 + 0.5 * 9 * squares), rel=1e-5)


def test_improvement_by_hand():
    """Policies of mean 0.5, behaviour of 0, the meta-policy of 2, all of deviation 1."""
    agent, _ = agent_and_batch(LATER, penalty=0.5, alpha=0.4)
    agent.q = Always(-4.0, 8.0)
    for actor, mean in ((agent.actor, 0.5), (agent.behaviour, 0.0), (agent.meta_policy, 2.0)):
        with torch.no_grad():
            for parameter in actor.parameters():
                parameter.zero_()
            actor.net.biases[-1][:, :, :A] = mean
    imagined = Imagined(zeros(3, 2), torch.zeros(3, 2, A), torch.tensor([0.9, 0.1]).expand(3, 2))
    loss, meta, notes = agent._improvement(imagined, generator())
    behaviour, other = A * 0.5**2 / 2, A * 1.5**2 / 2
    assert notes["behaviour_divergence"].item() == pytest.approx(behaviour, rel=1e-5)
    assert notes["meta_divergence"].item() == pytest.approx(other, rel=1e-5)
    assert notes["value"].item() == pytest.approx(-4.0)
    assert meta.item() == pytest.approx(3 * other, rel=1e-5)
    assert loss.item() == pytest.approx(3 * (1.0 + 0.5 * (0.4 * behaviour + 0.6 * other)), rel=1e-5)


def test_nothing_counts_after_an_imagined_end():
    agent, batch = agent_and_batch(LATER, rollout=3)
    ends = iter([[True, False, False, False], [False, True, False, False], [False] * 4])

    def step(observations, actions, _):
        terminal = torch.tensor(next(ends)).expand(3, 4)
        return Steps(observations, actions, torch.ones(3, 4), observations + 1, terminal)

    agent.model.step = step
    start = torch.from_numpy(batch.observations[:, :4])
    found = agent.imagine(start, generator())
    alive = torch.tensor([1.0, 1, 1, 1, 0, 1, 1, 1, 0, 0, 1, 1])
    torch.testing.assert_close(found.weight, (alive / alive.sum()).expand(3, 12))
    torch.testing.assert_close(found.steps.observations[:, 8:], start + 2)
    assert torch.equal(found.next_actions[:, :8], found.steps.actions[:, 4:])


REACHED = [
    (0, "model_loss", {"model"}),
    (0, "proximal_loss", {"model"}),
    (0, "behaviour_loss", {"behaviour"}),
    (0, "meta_policy_loss", {"meta_policy"}),
    (LATER, "q_loss", {"q"}),
    (LATER, "actor_loss", {"actor"}),
    (LATER, "meta_policy_loss", {"meta_policy"}),
]


@pytest.mark.parametrize(("step", "part", "nets"), REACHED)
def test_each_loss_reaches_its_own_net_alone(step, part, nets):
    agent, batch = agent_and_batch(step)
    loss, parts = agent.loss(batch, generator())
    parts[part].backward()
    reached = {name.split(".")[0] for name, p in agent.named_parameters() if p.grad is not None}
    assert reached == nets
    own = [parts[name] for at, name, _ in REACHED if at == step]
    assert loss.item() == pytest.approx(sum(own).item(), rel=1e-5)


@pytest.mark.parametrize("step", [0, LATER])
def test_each_dynamics_is_learned_from_its_own_data_alone(step):
    agent, batch = agent_and_batch(step)
    agent.loss(batch, generator())[0].backward()
    before = {name: p.grad.clone() for name, p in agent.named_parameters() if p.grad is not None}
    agent.zero_grad()
    for field in batch[:4]:
        field[1] += 0.1
    agent.loss(batch, generator())[0].backward()
    for name, gradient in before.items():
        if name.startswith("meta_policy"):
            continue
        new = dict(agent.named_parameters())[name].grad
        for dynamics in (0, 2):
            assert torch.equal(gradient[dynamics::3], new[dynamics::3]), name
        assert not torch.equal(gradient[1::3], new[1::3]), name


def test_phases_begin_where_the_one_before_ended():
    learner, sampler = learner_and_sampler(steps=4)
    agent = learner.agent
    assert isinstance(agent, Agent)
    assert isinstance(agent, Phased)
    assert isinstance(agent, Following)
    first = [learner.update(sampler) for _ in range(2)]
    assert all("model_loss" in values and "q_loss" not in values for values in first)
    models = [p.clone() for p in (*agent.model.parameters(), *agent.behaviour.parameters())]
    agent.begin(2)
    assert torch.equal(agent.actor.net.weights[0], agent.behaviour.net.weights[0])
    second = [learner.update(sampler) for _ in range(2)]
    assert all("q_loss" in values and "model_loss" not in values for values in second)
    for old, new in zip(models, (*agent.model.parameters(), *agent.behaviour.parameters()), strict=True):
        assert torch.equal(old, new)
    assert not torch.equal(agent.actor.net.weights[0], agent.behaviour.net.weights[0])


def test_what_follows_the_gradient():
    agent, _ = agent_and_batch(meta_rate=0.5, follow=0.25)
    with torch.no_grad():
        for parameter in (*agent.model.tasks.parameters(), *agent.q.parameters()):
            parameter.add_(4.0)
    slow, meta = ([p.clone() for p in net.parameters()] for net in (agent.slow_q, agent.model.meta))
    agent.follow({})
    for old, new in zip(meta, agent.model.meta.parameters(), strict=True):
        torch.testing.assert_close(new, old + 2.0)
    assert all(map(torch.equal, slow, agent.slow_q.parameters()))
    agent.begin(LATER)
    meta = [p.clone() for p in agent.model.meta.parameters()]
    agent.follow({})
    for old, new in zip(slow, agent.slow_q.parameters(), strict=True):
        torch.testing.assert_close(new, old + 1.0)
    assert all(map(torch.equal, meta, agent.model.meta.parameters()))


def test_same_seed_same_parameters_and_a_continued_run_is_the_same(tmp_path):
    whole, sampler = learner_and_sampler(seed=3, steps=6)
    before = torch.get_rng_state()
    for _ in range(6):
        whole.update(sampler)
    assert torch.equal(torch.get_rng_state(), before)
    for at in (2, 3, 5):  # in the first phase, between the two, and in the second
        half, _ = learner_and_sampler(seed=3, steps=6)
        for _ in range(at):
            half.update(sampler)
        save_checkpoint(tmp_path / "last.safetensors", half.checkpoint())
        again, _ = learner_and_sampler(seed=5, steps=6)
        again.seed = 3
        again.restore(load_checkpoint(tmp_path / "last.safetensors", agent="merpo", robot="Hopper"))
        for _ in range(at, 6):
            again.update(sampler)
        for name, value in whole.checkpoint().parameters.items():
            assert torch.equal(value, again.checkpoint().parameters[name]), name


@pytest.mark.parametrize("step", [0, LATER])
def test_data_that_are_not_finite_stop_it(step):
    learner, sampler = learner_and_sampler()
    learner.step = step
    batch = sampler.sample(8, np.random.default_rng(0))
    batch.rewards[0, 0] = np.nan
    with pytest.raises(FloatingPointError, match=f"at step {step}"):
        learner.update(type("Broken", (), {"sample": lambda *_: batch})())


def test_data_of_another_number_of_dynamics_are_refused_before_there_is_a_folder(tmp_path):
    config = MerPOConfig(**(TINY | {"steps": 2}))
    held_out = settings(tmp_path, evaluate_every=0, hold_out=1)
    data = dataclasses.replace(random_dataset((9, 8, 12)), episode_dynamics=np.array([0, 1, 19]))
    with pytest.raises(ValueError, match=r"^the data are of 2 dynamics, tasks is 3: give --tasks 2$"):
        train("merpo", config, held_out, data)
    assert not list(tmp_path.iterdir())
    assert train("merpo", dataclasses.replace(config, tasks=2), held_out, data).is_dir()  # as it is told to


def test_data_of_more_dynamics_than_nets_are_refused_and_measured():
    agent, batch = agent_and_batch(tasks=2)
    with pytest.raises(ValueError, match=r"the data are of 3 dynamics, tasks is 2: give --tasks 3"):
        agent.loss(batch, generator())
    loss, parts = agent.loss(batch, None)
    assert loss.item() == pytest.approx(parts["meta_model_fit"].item() + parts["meta_policy_fit"].item(), rel=1e-6)
    alone = [agent.loss(type(batch)(*(x[i : i + 1] for x in batch)), None)[0].item() for i in range(3)]
    assert loss.item() == pytest.approx(np.mean(alone), rel=1e-5)


def test_a_new_dynamics_begins_at_what_is_common_and_leaves_it_as_it_is():
    learner, sampler = learner_and_sampler(adaptation_model_share=0.25)
    for learner.step in (0, 1, 10, 11):
        learner.update(sampler)
    agent = learner.agent
    before = {name: p.clone() for name, p in agent.named_parameters()}
    new = agent.for_task()
    assert isinstance(agent, ForTask)
    assert new.config.tasks == 1
    torch.testing.assert_close(new.model.tasks.weights[0], agent.model.meta.weights[0])
    torch.testing.assert_close(new.actor.net.weights[0], agent.meta_policy.net.weights[0])
    torch.testing.assert_close(new.q.weights[0][1], agent.q.weights[0][3:].mean(dim=0))
    observations = np.random.default_rng(0).normal(size=(5, S))
    np.testing.assert_array_equal(*(x.policy().predict(observations)[0] for x in (agent, new)))
    dataset = random_dataset()
    adaptation = agent.config.sampler(dataset, dataset.normalization())  # of one dynamics
    begun = {name: p.clone() for name, p in new.named_parameters()}
    own = Learner("merpo", dataclasses.replace(new.config, learning_rate=1e-2), agent.spec, 0)
    own.agent = new
    own.optimizer = torch.optim.AdamW(new.parameters(), lr=1e-2, weight_decay=0.0)
    kinds = ["model_loss" in own.update(adaptation) for _ in range(12)]
    assert kinds == [False, False, False, True] * 3
    changed = {name.split(".")[0] for name, p in new.named_parameters() if not torch.equal(p, begun[name])}
    assert changed == {"model", "behaviour", "actor", "q", "slow_q"}
    assert all(torch.equal(p, begun[name]) for name, p in new.named_parameters() if name.startswith("model.meta"))
    assert all(torch.equal(p, before[name]) for name, p in agent.named_parameters())
    assert not np.array_equal(*(x.policy().predict(observations)[0] for x in (agent, new)))


def test_it_acts_alone_as_beside_others_bit_for_bit():
    agent, _ = agent_and_batch(hidden=64)
    observations = np.random.default_rng(0).normal(size=(3, 13, S), scale=20)

    def actions(lanes):
        policy = agent.policy()
        return np.stack([policy.predict(x[lanes])[0] for x in observations])

    together = actions(slice(None))
    assert np.abs(together).max() <= 1.0
    assert np.ptp(together) > 0.1
    for lane in range(13):
        assert np.array_equal(together[:, lane], actions(slice(lane, lane + 1))[:, 0])


def test_its_policy_is_one_for_the_benchmark():
    agent, _ = agent_and_batch()
    policy = agent.policy()
    assert isinstance(policy, Policy)
    assert isinstance(policy, RewardAware)
    assert evaluate(policy, "Hopper", indices=[0], episodes=2).returns.shape == (1, 2)
    with pytest.raises(ValueError, match=r"observations have shape \(2, 3\)"):
        policy.predict(np.zeros((2, 3)))


def one_step_toy(gains, rows=200):
    """One state; action a (of two numbers) gives reward a₀ + g a₁, and ends the episode."""
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, size=(1, 2)) for _ in range(rows * len(gains))]
    of = np.arange(len(actions)) % len(gains)
    rewards = [a[:, 0] + gains[i] * a[:, 1] for a, i in zip(actions, of, strict=True)]
    dataset = flat_dataset([rng.normal(0, 0.01, size=(2, 1)) for _ in actions], actions, rewards)
    dataset = dataclasses.replace(dataset, episode_dynamics=of, episode_terminated=np.ones(len(of), np.bool_))
    spec = dataclasses.replace(
        hopper_spec(), action_limit=np.ones(2, np.float32), normalization=dataset.normalization()
    )
    return dataset, spec


TOY = {
    "tasks": 2, "batch_size": 64, "starts": 32, "rollout": 1, "hidden": 32, "model_hidden": 32, "members": 2,
    "layers": 2, "model_layers": 1, "learning_rate": 3e-3, "steps": 400, "model_steps": 100, "beta": 0.1,
}  # fmt: skip


def test_it_learns_what_is_common_and_what_is_not():
    dataset, spec = one_step_toy([1.0, -1.0])
    config = MerPOConfig(**TOY)
    learner, sampler = Learner("merpo", config, spec, 0), config.sampler(dataset, spec.normalization)
    for _ in range(config.steps):
        learner.update(sampler)
    agent, state = learner.agent, torch.zeros(1, 1)
    own = agent.actor.best(state)[:, 0].detach()  # (dynamics, 2)
    (common,), _ = agent.policy().predict(np.zeros((1, 1)))
    (untrained,), _ = MerPO(config, spec, generator(0)).policy().predict(np.zeros((1, 1)))
    assert own[0, 1] > 0.5
    assert own[1, 1] < -0.5
    assert abs(common[1]) < 0.4  # the meta-policy between them
    assert common[0] > 0.5 > untrained[0] + 0.2


@pytest.mark.parametrize(("beta", "low", "high"), [(0.0, -0.5, 0.5), (1.0, -5.0, -1.5)])
def test_critics_value_imagined_steps_below_the_data(beta, low, high):
    """Every action gives 1; the data have those of one side, and the policy is held at those of the other."""
    dataset, spec = one_step_toy([0.0, 0.0])
    dataset = dataclasses.replace(dataset, actions=-np.abs(dataset.actions), rewards=np.ones_like(dataset.rewards))
    config = MerPOConfig(**(TOY | {"beta": beta}))
    learner, sampler = Learner("merpo", config, spec, 0), config.sampler(dataset, spec.normalization)
    for _ in range(config.model_steps):
        learner.update(sampler)
    agent, draws, gaps = learner.agent, generator(), []
    agent.begin(config.model_steps)
    with torch.no_grad():
        for parameter in agent.actor.parameters():
            parameter.zero_()
        agent.actor.net.biases[-1][:, 0, :2], agent.actor.net.biases[-1][:, 0, 2:] = 0.7, -1.0
    optimizer = torch.optim.Adam(agent.q.parameters(), lr=3e-3)
    for step in range(150):
        _, parts = agent.loss(sampler.sample(64, np.random.default_rng(step)), draws)
        optimizer.zero_grad()
        parts["q_loss"].backward()
        optimizer.step()
        gaps.append(parts["conservative_gap"].item())
    assert low < np.mean(gaps[-20:]) < high


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tasks": 0}, "tasks is 0"),
        ({"alpha": 1.5}, "alpha is 1.5"),
        ({"starts": 65}, "starts is 65 and batch_size 64: give a batch size of at least `starts`"),
        ({"starts": 0}, "starts is 0: give a whole number from 1 to"),
        ({"steps": 10, "model_steps": 10}, "model_steps is 10 of 10 steps"),
        ({"model_steps": 0}, "model_steps is 0"),
    ],
)
def test_bad_configs_are_one_line(changes, words):
    with pytest.raises(ValueError, match=words):
        MerPOConfig(**changes)


def test_half_of_the_steps_are_the_models():
    assert MerPOConfig(steps=30).for_robot("Hopper").model_steps == 15
    assert MerPOConfig(steps=30, model_steps=4).for_robot("Hopper").model_steps == 4
