"""What every predictor of the next state has to do, once for each of `PREDICTORS`, and what each is for."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch

from agents import PREDICTORS
from agents.cadm import deal, older
from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.interface import Agent, Predictor, RobotSpec
from agents.learner import Learner
from agents.lstm import moved
from dynagen_bench import ids
from dynagen_bench.datasets import Normalization, WindowSampler
from tests.agents.samples import A, K, S, flat_dataset, hopper_spec, random_dataset, random_windows


@pytest.fixture(params=PREDICTORS)
def name(request) -> str:
    """A predictor's name."""
    return request.param


def tiny_config(name, **changes):
    """A config of a net that trains in a blink."""
    tiny = {"context": K, "batch_size": 8, "steps": 20, "hidden": 16, "learning_rate": 3e-3}
    tiny |= {"history": 4, "future": 3, "code": 4, "members": 2, "layers": 2}
    fields = {field.name for field in dataclasses.fields(PREDICTORS[name][0])}
    return PREDICTORS[name][0](**{key: value for key, value in (tiny | changes).items() if key in fields})


def new_predictor(name, seed=0, **changes) -> Predictor:
    return PREDICTORS[name][1](tiny_config(name, **changes), hopper_spec(), torch.Generator().manual_seed(seed))


def changed(windows, where, fields=("observations", "actions", "next_observations", "returns_to_go")):
    """Windows with other numbers at the steps of `where` (B, K)."""
    rng, new = np.random.default_rng(1), {}
    for field in fields:
        old = getattr(windows, field)
        here = where if old.ndim == 2 else where[..., None]
        new[field] = np.where(here, rng.normal(0, 5, old.shape), old).astype(np.float32)
    return windows._replace(**new)


def seeded(seed=5):
    return torch.Generator().manual_seed(seed)


def predicted(predictor, windows):
    return predictor.predict(windows).detach()


def test_it_predicts_and_does_not_act(name):
    predictor = new_predictor(name)
    assert isinstance(predictor, Predictor)
    assert not isinstance(predictor, Agent)
    next_states = predicted(predictor, random_windows())
    assert next_states.shape == (8, K, S)
    assert next_states.dtype == torch.float32


def test_loss_and_predictions_ignore_padded_steps(name):
    predictor, windows = new_predictor(name), random_windows()
    other = changed(windows, ~windows.mask)
    assert not windows.mask.all()
    assert torch.equal(predicted(predictor, windows)[windows.mask], predicted(predictor, other)[windows.mask])
    for generator in (lambda: None, seeded):
        losses, grads = [], []
        for these in (windows, other):
            predictor.zero_grad()
            loss, _ = predictor.loss(these, generator())
            loss.backward()
            losses.append(loss.detach())
            grads.append([parameter.grad.clone() for parameter in predictor.parameters()])
        assert torch.equal(*losses)
        for grad, other_grad in zip(*grads, strict=True):
            torch.testing.assert_close(grad, other_grad, rtol=1e-5, atol=1e-7)


def test_padding_before_an_episode_is_as_no_steps_before_it(name):
    predictor, dataset = new_predictor(name), random_dataset((3,))
    short, padded = (
        WindowSampler(dataset, context, dataset.normalization()).windows_at(np.array([0])) for context in (3, K)
    )
    assert padded.mask.sum() == 3 == short.mask.sum()
    torch.testing.assert_close(predicted(predictor, short), predicted(predictor, padded)[:, K - 3 :])


def test_loss_is_the_mean_over_valid_steps_alone(name):
    predictor, windows = new_predictor(name), random_windows()
    alone = [predictor.loss(type(windows)(*(x[i : i + 1] for x in windows)), None)[0].item() for i in range(8)]
    whole = predictor.loss(windows, None)[0].item()
    assert whole == pytest.approx(np.average(alone, weights=windows.mask.sum(axis=1)), rel=1e-5)


@pytest.mark.parametrize("step", range(K - 1))
def test_changing_the_future_changes_no_earlier_prediction(name, step):
    predictor, windows = new_predictor(name), random_windows()
    future = np.zeros((8, K), dtype=bool)
    future[:, step + 1 :] = True
    before, after = predicted(predictor, windows), predicted(predictor, changed(windows, future))
    earlier = windows.mask & ~future
    assert torch.equal(before[earlier], after[earlier])
    assert not torch.equal(before[:, step + 1 :], after[:, step + 1 :])


def test_targets_and_returns_are_not_looked_at(name):
    predictor, windows = new_predictor(name), random_windows()
    other = changed(windows, np.ones((8, K), dtype=bool), ("next_observations", "returns_to_go"))
    assert torch.equal(predicted(predictor, windows), predicted(predictor, other))


def test_what_came_before_matters_to_all_but_the_mlp(name):
    predictor, windows = new_predictor(name), random_windows((0, 1, 2, 3, 12, 13, 14, 15))
    past = np.zeros((8, K), dtype=bool)
    past[:, :-1] = True
    before, after = (predicted(predictor, these)[:, -1] for these in (windows, changed(windows, past)))
    assert torch.equal(before, after) == (name == "mlp")


def test_windows_of_one_step(name):
    predictor, dataset = new_predictor(name, context=1), random_dataset()
    windows = WindowSampler(dataset, 1, dataset.normalization()).windows_at(np.arange(6))
    loss, _ = predictor.loss(windows, seeded())
    loss.backward()
    assert torch.isfinite(loss)
    assert predicted(predictor, windows).shape == (6, 1, S)


def test_wrong_shapes_are_refused(name):
    windows = random_windows()
    with pytest.raises(AssertionError):
        new_predictor(name).predict(windows._replace(observations=windows.observations[..., :-1]))


def test_overfits_eight_windows(name):
    predictor = new_predictor(name, hidden=64)
    windows = random_windows((0, 2, 5, 9, 12, 14, 17, 19))
    optimizer = torch.optim.Adam(predictor.parameters(), lr=1e-2)
    first, _ = predictor.loss(windows, None)
    for _ in range(200):
        loss, parts = predictor.loss(windows, None)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.02 * first
    assert all(part < 0.1 for part in parts.values())


def learned(name, seed=0, steps=5, dataset=None, spec=None, **changes) -> Learner:
    dataset, spec = dataset or random_dataset(), spec or hopper_spec()
    config = tiny_config(name, **changes)
    sampler = WindowSampler(dataset, config.context, spec.normalization)
    learner = Learner(name, config, spec, seed)
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


def test_saved_and_loaded_it_predicts_the_same(name, tmp_path):
    learner = learned(name)
    save_checkpoint(tmp_path / "last.safetensors", learner.checkpoint())
    found = load_checkpoint(tmp_path / "last.safetensors", agent=name, robot="Hopper")
    assert (found.config, found.step) == (learner.config, 5)
    windows = random_windows()
    assert torch.equal(predicted(found.build_agent(), windows), predicted(learner.agent, windows))


def test_a_loss_that_is_no_number_stops_before_it_does_harm(name):
    dataset = random_dataset()
    broken = dataset.observations.copy()
    broken[5] = np.nan
    sampler = WindowSampler(dataclasses.replace(dataset, observations=broken), K, dataset.normalization())
    learner = Learner(name, tiny_config(name, batch_size=64), hopper_spec(), seed=0)
    with pytest.raises(FloatingPointError, match=r"loss is nan at step 0: .*check the data"):
        learner.update(sampler)
    untouched = Learner(name, learner.config, hopper_spec(), 0).checkpoint().parameters
    assert all(torch.equal(value, untouched[key]) for key, value in learner.checkpoint().parameters.items())


SIZES = {"mlp": ("layers", "hidden"), "lstm": ("hidden",), "cadm": ("hidden", "history", "future", "code", "members")}


def test_sizes_below_one_are_refused(name):
    for field in SIZES[name]:
        with pytest.raises(ValueError, match=f"{field} is 0: give a whole number from 1"):
            tiny_config(name, **{field: 0})


def episodes_of(step, rng, count=60, length=20, states=2, actions=1):
    """Episodes in which the next state is step(s, a, episode's number), from random states by random actions."""
    observations, taken = [], []
    for episode in range(count):
        a = rng.uniform(-1, 1, size=(length, actions))
        s = [rng.normal(size=states)]
        for action in a:
            s.append(step(s[-1], action, episode))
        observations.append(np.array(s))
        taken.append(a)
    return flat_dataset(observations, taken, [np.ones(length)] * count)


def plain_spec(states, actions) -> RobotSpec:
    """A robot whose states are left as they are."""
    unit = Normalization(np.zeros(states, np.float32), np.full(states, 1 - 1e-6, np.float32))
    return RobotSpec("Hopper", np.ones(actions, np.float32), unit)


def errors_of(learner, dataset, context):
    """Square errors (E, K, S) at the first steps of the episodes of a dataset."""
    sampler = WindowSampler(dataset, context, learner.spec.normalization)
    windows = sampler.windows_at(np.cumsum(dataset.episode_lengths) - dataset.episode_lengths)
    return np.square(predicted(learner.agent, windows).numpy() - windows.next_observations)


def test_learns_a_linear_system(name):
    rotation, push = np.array([[0.9, 0.3], [-0.3, 0.9]]), np.array([0.2, 0.5])

    def step(s, a, _):
        return rotation @ s + push * a

    rng = np.random.default_rng(0)
    train, test = episodes_of(step, rng), episodes_of(step, rng)
    sizes = {"hidden": 32, "context": 10, "batch_size": 16, "learning_rate": 1e-2}
    learner = learned(name, 0, 250, train, plain_spec(2, 1), **sizes)
    learner.config = dataclasses.replace(learner.config, learning_rate=1e-3)  # the noise of a high rate hides the fit
    sampler = WindowSampler(train, 10, learner.spec.normalization)
    for _ in range(100):
        learner.update(sampler)
    assert errors_of(learner, test, 10).mean() < 1e-3 * test.observations.var()


def test_a_hidden_gain_is_inferred_from_history_by_all_but_the_mlp(name):
    rng = np.random.default_rng(0)
    gains = rng.choice([-1.0, 1.0], size=400)

    def step(s, a, episode):
        return s + gains[episode] * a

    train = episodes_of(step, rng, 300, 10, 1)
    test = episodes_of(step, rng, 100, 10, 1)
    sizes = {"hidden": 32, "context": 10, "batch_size": 32, "learning_rate": 1e-2, "history": 6}
    learner = learned(name, 0, 300, train, plain_spec(1, 1), **sizes)
    late = errors_of(learner, test, 10)[:, 4:].mean()  # after some steps that show the gain
    change = 1 / 3  # the mean square of g · a, a uniform in ±1
    assert late > 0.8 * change if name == "mlp" else late < 0.2 * change


def test_windows_are_moved_to_the_left_and_back():
    steps = torch.arange(10.0).view(2, 5, 1)
    mask = torch.tensor([[False, False, True, True, True], [True] * 5])
    left = moved(steps, mask, left=True)
    assert left[:, :, 0].tolist() == [[2, 3, 4, 4, 4], [5, 6, 7, 8, 9]]
    assert torch.equal(moved(left, mask, left=False)[mask], steps[mask])


def test_contexts_of_training_are_as_old_as_the_future_is_long_and_of_the_window():
    steps = torch.arange(8.0).expand(500, 8)[:, :, None]
    mask = torch.ones(500, 8, dtype=torch.bool)
    mask[:250, :3] = False
    age = (steps - older(steps, mask, 4, seeded()))[:, :, 0]
    assert sorted(set(age[250:, 7].tolist())) == [0, 1, 2, 3]
    assert sorted(set(age[:250, 5].tolist())) == [0, 1, 2]
    assert (age[:250, 3] == 0).all()
    assert torch.equal(older(steps, mask, 4, None), steps)


@pytest.mark.parametrize(("windows", "members"), [(64, 5), (5, 5), (3, 5), (1, 5), (6, 1)])
def test_every_window_is_dealt_and_members_get_equal_shares(windows, members):
    dealt = deal(windows, members, seeded())
    assert dealt.shape == (members, -(-windows // members))
    counts = torch.bincount(dealt.flatten(), minlength=windows)
    assert counts.min() >= 1
    assert counts.max() - counts.min() <= 1
    assert torch.equal(deal(windows, members, None), torch.arange(windows).repeat(members, 1))


def test_a_prediction_is_the_mean_of_the_members():
    predictor, windows = new_predictor("cadm", members=3), random_windows()
    whole = predicted(predictor, windows)
    alone = []
    for member in range(3):
        single = new_predictor("cadm", members=1)
        state = {
            key: value[member : member + 1] if "nets" in key else value for key, value in predictor.state_dict().items()
        }
        single.load_state_dict(state)
        alone.append(predicted(single, windows))
    torch.testing.assert_close(torch.stack(alone).mean(dim=0), whole)


def test_a_context_is_of_the_last_pairs_before_its_step():
    predictor, windows = new_predictor("cadm", history=2), random_windows((0,))
    seen = []
    hook = predictor.encoder.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    predictor.predict(windows)
    hook.remove()
    pairs = seen[0].view(1, K, S + A, 2).detach().numpy()
    s, a = windows.observations[0], windows.actions[0]
    assert not pairs[0, 0].any()
    assert not pairs[0, 1, :, 0].any()
    for step in range(2, K):
        for place, before in enumerate((step - 2, step - 1)):
            expected = np.concatenate([s[before + 1] - s[before], a[before]])
            np.testing.assert_array_equal(pairs[0, step, :, place], expected)


def test_cadm_learns_both_ways_by_hand():
    predictor, windows = new_predictor("cadm", members=2, backward_weight=0.25), random_windows()
    with torch.no_grad():
        for nets, change in ((predictor.forward_nets, 0.5), (predictor.backward_nets, 2.0)):
            for parameter in nets.parameters():
                parameter.zero_()
            nets.biases[-1].fill_(change)
    seen = []
    hook = predictor.backward_nets.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    loss, parts = predictor.loss(windows, None)
    hook.remove()
    change = (windows.next_observations - windows.observations)[windows.mask]
    forward, backward = np.square(0.5 - change).mean(), np.square(2.0 + change).mean()
    assert parts["next_state_loss"].item() == pytest.approx(forward, rel=1e-5)
    assert parts["backward_loss"].item() == pytest.approx(backward, rel=1e-5)
    assert loss.item() == pytest.approx(forward + 0.25 * backward, rel=1e-5)
    np.testing.assert_array_equal(seen[0][0, :, :S].detach(), windows.next_observations.reshape(-1, S))


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_robots_limit_is_that_of_its_environment(robot):
    spec = RobotSpec.of_robot(robot, Normalization(np.zeros(2, np.float32), np.ones(2, np.float32)))
    with gymnasium.make(f"{robot}-RandDyn-test0") as env:
        np.testing.assert_array_equal(spec.action_limit, env.action_space.high)
    assert set(spec.action_limit.tolist()) == {np.float32(0.4 if robot == "SlimHumanoid" else 1.0).item()}
