"""DADT and its parents, against the formulas of their papers."""

import numpy as np
import pytest
import torch

from agents.interface import History
from agents.learner import Learner
from tests.agents.samples import TRANSFORMERS, K, hopper_spec, new_agent, random_windows, tiny_config
from tests.agents.test_trunk import gpt2_with_weights_of


def original_forward(model, history, gpt2):
    """kzl/decision-transformer's forward (models/decision_transformer.py) on our weights: tokens (B, 3, K, D)."""
    encoder = model.encoder
    embed_return, embed_state, embed_action = encoder.embed_inputs
    time_embeddings = encoder.embed_time(history.timesteps)
    stacked_inputs = (
        torch.stack(
            (
                embed_return(history.returns_to_go[..., None] / 1000.0) + time_embeddings,
                embed_state(history.observations) + time_embeddings,
                embed_action(history.actions) + time_embeddings,
            ),
            dim=1,
        )
        .permute(0, 2, 1, 3)
        .reshape(8, 3 * K, -1)
    )
    mask = torch.stack((history.mask,) * 3, dim=1).permute(0, 2, 1).reshape(8, 3 * K)
    x = gpt2(inputs_embeds=encoder.norm(stacked_inputs), attention_mask=mask.long()).last_hidden_state
    return x.reshape(8, K, 3, -1).permute(0, 2, 1, 3)


def test_dadt_computes_what_the_paper_and_the_original_dt_say():
    agent, windows = new_agent("dadt"), random_windows()
    history = History.of(windows)
    with torch.no_grad():
        x = original_forward(agent.dt, history, gpt2_with_weights_of(agent.dt.encoder.trunk, agent.dt.config))
        action_preds, state_preds = torch.tanh(agent.dt.action_head(x[:, 1])), agent.next_state_head(x[:, 2])
        valid = history.mask.reshape(-1)
        action_loss = ((action_preds - history.actions) ** 2).reshape(-1, 3)[valid].mean()
        state_loss = ((state_preds - torch.from_numpy(windows.next_observations)) ** 2).reshape(-1, 11)[valid].mean()
        loss, parts = agent.loss(windows, None)
    assert parts["action_loss"].item() == pytest.approx(action_loss.item(), rel=1e-5)
    assert parts["next_state_loss"].item() == pytest.approx(state_loss.item(), rel=1e-5)
    assert loss.item() == pytest.approx((action_loss + 0.05 * state_loss).item(), rel=1e-5)


def test_without_the_state_prediction_it_is_decision_transformer():
    dadt, dt, windows = new_agent("dadt", next_state_weight=0.0), new_agent("dt"), random_windows()
    dt.load_state_dict(dadt.dt.state_dict())
    torch.testing.assert_close(*(agent.loss(windows, None)[0] for agent in (dadt, dt)), rtol=1e-6, atol=0.0)


def test_transformer_bc_knows_no_return():
    agent, windows = new_agent("transformer_bc"), random_windows()
    other = windows._replace(returns_to_go=windows.returns_to_go + 100)
    assert torch.equal(agent.loss(windows, None)[0], agent.loss(other, None)[0])
    assert not torch.equal(*(new_agent("dt").loss(w, None)[0] for w in (windows, other)))


class TheSameWindows:
    """A sampler that draws nothing."""

    def sample(self, batch_size, rng):
        return random_windows()


@pytest.mark.parametrize(("warmup", "rate"), [(0, 1e-3), (4, 0.25e-3)])
def test_an_update_is_adamw_with_the_configs_values(name, warmup, rate):
    quiet = {"dropout": 0.0} if name in TRANSFORMERS else {}
    config = tiny_config(name, weight_decay=0.1, gradient_clip=1e-3, warmup_steps=warmup, **quiet)
    learner = Learner(name, config, hopper_spec(), seed=0)
    before = {key: value.detach().clone() for key, value in learner.agent.named_parameters()}
    loss, _ = learner.agent.loss(random_windows(), None)
    loss.backward()
    gradients = {key: x.grad.clone() for key, x in learner.agent.named_parameters() if x.grad is not None}
    norm = float(np.sqrt(sum(float(gradient.square().sum()) for gradient in gradients.values())))
    assert learner.update(TheSameWindows())["gradient_norm"] == pytest.approx(norm, rel=1e-5)
    for key, value in learner.agent.named_parameters():
        if key not in gradients:  # of another phase: not even its weights decay
            assert torch.equal(value, before[key])
            continue
        gradient = gradients[key] * 1e-3 / norm  # clipped: the first step of Adam is sign-like, up to its epsilon
        expected = before[key] * (1 - rate * 0.1) - rate * gradient / (gradient.abs() + 1e-8)
        torch.testing.assert_close(value.detach(), expected, rtol=1e-4, atol=1e-5)


def test_every_update_has_the_learning_rate_of_its_step():
    config = tiny_config("dt", steps=8, warmup_steps=2, decay_steps=4, learning_rate=1e-3)
    learner, rates = Learner("dt", config, hopper_spec(), seed=0), []
    for _ in range(8):
        learner.update(TheSameWindows())
        rates += [group["lr"] for group in learner.optimizer.param_groups]
    assert rates == pytest.approx([0.5e-3, 1e-3, 1e-3, 1e-3, 1e-3, 0.75e-3, 0.5e-3, 0.25e-3])


def test_every_update_has_dropout_of_its_own(transformer):
    learner = Learner(transformer, tiny_config(transformer, learning_rate=0.0, dropout=0.5), hopper_spec(), seed=0)
    assert len({learner.update(TheSameWindows())["loss"] for _ in range(3)}) == 3  # nothing else differs
