"""Models of several dynamics: their likelihood and steps by hand, what they learn, and what the meta-model is for."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from agents.merpo.world_model import LOG_VARIANCE, Steps, WorldModel
from agents.nets import move_to_mean, spread


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def small(tasks=2, members=3, state_size=1, limit=(1.0,), hidden=(16,), seed=0):
    return WorldModel(tasks, members, state_size, np.asarray(limit, np.float32), hidden, generator(seed))


def only_biases(model, biases):
    """Make every net say the same whatever it is given: biases (K, M, outputs)."""
    with torch.no_grad():
        for parameter in model.tasks.parameters():
            parameter.zero_()
        model.tasks.biases[-1].copy_(biases.flatten(0, 1)[:, None])


def gains_data(gains, rows, seed=0):
    """The dynamics s' = s + g a, with reward g; one dynamics for each g."""
    rng = np.random.default_rng(seed)
    s, a = (torch.from_numpy(rng.uniform(-1, 1, (len(gains), rows, 1)).astype(np.float32)) for _ in range(2))
    g = torch.tensor(gains)[:, None]
    return Steps(s, a, g.expand(-1, rows), s + g[..., None] * a, torch.zeros(len(gains), rows, dtype=torch.bool))


def train(model, data, steps, eta=0.0, rate=0.0, batch=32, stop=None, learning_rate=3e-3):
    """Gradient steps as MerPO makes them; returns how many were made until `stop` of the model was true."""
    optimizer, draws, rng = torch.optim.Adam(model.tasks.parameters(), learning_rate), generator(1), generator(2)
    for step in range(steps):
        if stop is not None and stop(model):
            return step
        rows = torch.randint(data.rewards.shape[1], (batch,), generator=rng)
        loss = model.negative_log_likelihood(Steps(*(x[:, rows] for x in data)), draws) + eta * model.distance()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        model.follow(rate)
    return steps


def error(model, data):
    """Mean square error of the ensembles' mean, of the next state."""
    with torch.no_grad():
        change = model.predict(data.observations, data.actions).mean[..., :-1].mean(dim=0)
    return (data.observations + change - data.following).square().mean().item()


def test_likelihood_is_that_of_a_gaussian_and_of_an_end():
    model = small(tasks=2, members=1)
    outputs = torch.tensor([[[0.5, 2.0, -1.0, 0.3, 0.7], [0.1, -1.0, 0.5, -2.0, -1.5]]])
    only_biases(model, outputs)
    steps = gains_data([0.5, -0.5], 4)._replace(terminal=torch.tensor([[True, False, False, True]] * 2))
    expected = 0.0
    for n in range(2):
        mean, raw, end = outputs[0, n, :2], outputs[0, n, 2:4], outputs[0, n, 4]
        low, high = LOG_VARIANCE
        bounded = high - functional.softplus(high - raw)
        bounded = low + functional.softplus(bounded - low)
        normal = torch.distributions.Normal(mean, (0.5 * bounded).exp())
        target = torch.cat((steps.following[n] - steps.observations[n], steps.rewards[n, :, None]), dim=1)
        ends = torch.distributions.Bernoulli(logits=end).log_prob(steps.terminal[n].float())
        expected -= (normal.log_prob(target).sum(dim=1) + ends).mean()
    torch.testing.assert_close(model.negative_log_likelihood(steps, None), expected)


def test_log_variance_stays_in_its_bounds():
    model = small()
    for raw, bound in ((-1e4, LOG_VARIANCE[0]), (1e4, LOG_VARIANCE[1])):
        only_biases(model, torch.tensor([0.0, 0.0, raw, raw, 0.0]).expand(3, 2, 5))
        found = model.predict(torch.zeros(2, 4, 1), torch.zeros(2, 4, 1)).log_variance
        torch.testing.assert_close(found, torch.full_like(found, bound), atol=1e-2, rtol=0)


def test_members_of_one_dynamics_see_different_samples():
    model, steps = small(tasks=1, members=2), gains_data([1.0], 8)
    with torch.no_grad():
        for parameter in model.tasks.parameters():
            parameter[1] = parameter[0]
    for draws, alike in ((None, True), (generator(), False)):
        model.zero_grad()
        model.negative_log_likelihood(steps, draws).backward()
        gradient = model.tasks.weights[0].grad
        assert torch.equal(gradient[0], gradient[1]) == alike


@pytest.mark.parametrize("rows", [1, 2, 7, 9])
def test_each_imagined_step_is_of_one_net_of_its_own_dynamics(rows):
    model = small(tasks=2, members=3)
    biases = torch.zeros(3, 2, 5)
    biases[:, :, 1] = torch.tensor([[0.0, 100.0], [10.0, 110.0], [20.0, 120.0]])  # reward: ten by net, 100 by dynamics
    biases[:, :, 2:4] = -1e4  # next to no deviation
    biases[:, :, 4] = -1e4
    only_biases(model, biases)
    found = model.step(torch.zeros(2, rows, 1), torch.zeros(2, rows, 1), generator())
    net = (found.rewards / 10).round()
    assert set(net[0].tolist()) <= {0.0, 1.0, 2.0}
    torch.testing.assert_close(net[1], net[0] + 10)


def test_every_net_is_drawn_as_often_as_another():
    model, none = small(tasks=1, members=3), torch.zeros(1, 7, 1)
    only_biases(model, torch.tensor([[0.0, k, -1e4, -1e4, -1e4] for k in range(3)])[:, None])
    drawn = torch.cat([model.step(none, none, generator(seed)).rewards.round() for seed in range(300)])
    shares = torch.stack([(drawn == k).float().mean(dim=0) for k in range(3)])  # (3, 7)
    torch.testing.assert_close(shares, torch.full((3, 7), 1 / 3), atol=0.1, rtol=0)


def test_rows_keep_their_places_when_they_are_dealt():
    model = small(tasks=2, members=3)
    with torch.no_grad():
        for first, parameter in zip(model.meta.parameters(), model.tasks.parameters(), strict=True):
            parameter.copy_(first[:1].expand_as(parameter))  # all nets alike
        model.tasks.weights[-1][:, 2:] = 0.0
        model.tasks.biases[-1][:, :, 2:] = -1e4
    s, a = torch.randn(2, 8, 1, generator=generator()), torch.rand(2, 8, 1, generator=generator())
    found = model.step(s, a, generator())
    expected = model.predict(s, a).mean[0]
    torch.testing.assert_close(found.rewards, expected[..., 1], atol=0.05, rtol=0)  # of deviation exp(-5)
    torch.testing.assert_close(found.following, s + expected[..., :1], atol=0.05, rtol=0)


def test_imagined_steps_end_and_stay_near():
    model, none = small(tasks=1, members=2), torch.zeros(1, 4000, 1)
    for logit, share in ((-1e4, 0.0), (-1.0, 0.2689), (1e4, 1.0)):
        only_biases(model, torch.tensor([1e4, 0.0, -1e4, -1e4, logit]).expand(2, 1, 5))
        found = model.step(none, none, generator())
        assert found.terminal.float().mean().item() == pytest.approx(share, abs=0.03)
        assert found.following.max().item() == 10.0


def test_actions_are_seen_in_shares_of_their_limit():
    half, whole = small(limit=(0.5,)), small(limit=(1.0,))
    s, a = torch.zeros(2, 4, 1), torch.full((2, 4, 1), 0.5)
    torch.testing.assert_close(half.predict(s, a).mean, whole.predict(s, 2 * a).mean)


def test_all_models_begin_as_the_meta_model_and_the_distance_is_a_sum_of_squares():
    model = small(tasks=4, members=3)
    assert model.distance().item() == 0.0
    with torch.no_grad():
        model.tasks.biases[0][4 + 1, 0, 2] += 3.0  # net 1 of dynamics 1
        model.tasks.weights[1][2 * 4 + 3, 0, 0] -= 2.0  # net 2 of dynamics 3
    before = {name: p.clone() for name, p in model.meta.named_parameters()}
    distance = model.distance()
    assert distance.item() == pytest.approx(13.0)
    distance.backward()
    assert model.tasks.biases[0].grad[5, 0, 2].item() == pytest.approx(6.0)
    assert all(p.grad is None for p in model.meta.parameters())
    model.follow(0.5)
    after = dict(model.meta.named_parameters())
    assert (after["biases.0"] - before["biases.0"])[1, 0, 2].item() == pytest.approx(0.5 * 3.0 / 4)
    assert (after["weights.1"] - before["weights.1"])[2, 0, 0].item() == pytest.approx(-0.5 * 2.0 / 4)
    assert torch.equal(after["weights.0"], before["weights.0"])


def test_spreading_and_moving_to_the_mean_are_each_others_inverse():
    few, many, back = (small(tasks=t, members=2, seed=s) for t, s in ((1, 0), (5, 1), (1, 2)))
    spread(few.tasks, many.tasks)
    move_to_mean(back.tasks, many.tasks)
    for one, other in zip(few.tasks.parameters(), back.tasks.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_error_falls_with_data():
    new, errors = gains_data([1.0, -0.5], 500, seed=9), []
    for rows in (4, 32, 256):
        model = small()
        if not errors:
            errors.append(error(model, new))
        train(model, gains_data([1.0, -0.5], rows), 300)
        errors.append(error(model, new))
    assert errors[1] < 0.3 * errors[0]
    assert errors[3] < 0.5 * errors[1]


def test_the_penalty_holds_the_models_together():
    data, distances = gains_data([1.0, -1.0], 64), []
    for eta in (0.0, 1e-2, 1e3):
        model = small()
        train(model, data, 150, eta, rate=0.1)
        distances.append(model.distance().item())
    assert distances[1] < 0.7 * distances[0]
    assert distances[2] < 1e-2 * distances[0]


def test_a_model_that_begins_at_the_meta_model_needs_fewer_steps():
    """Dynamics s' = s + g a: trained on six g, adapted to another with twenty steps of data."""
    meta = small(tasks=6)
    train(meta, gains_data([0.5, 0.7, 0.9, 1.1, 1.3, 1.5], 256), 200, eta=1e-2, rate=0.1)
    data, new = gains_data([1.4], 20, seed=5), gains_data([1.4], 200, seed=6)
    scratch, adapted = small(tasks=1, seed=7), small(tasks=1, seed=8)
    spread(meta.meta, adapted.tasks)
    needed = [train(model, data, 300, stop=lambda x: error(x, new) < 0.01) for model in (scratch, adapted)]
    assert needed[1] < 0.5 * needed[0]
