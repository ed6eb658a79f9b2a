"""MLP-BC: its net by hand, and that nothing of an episode but the present state reaches an action."""

import numpy as np
import pytest
import torch

from tests.agents.samples import A, K, S, new_agent, random_windows


def test_an_action_by_hand():
    agent = new_agent("mlp_bc", layers=1, hidden=2)
    first, last = agent.net.weights
    shift, end = agent.net.biases
    state = np.arange(S, dtype=np.float32) / S
    hidden = np.maximum(first.detach().numpy()[0] @ state + shift.detach().numpy()[0, 0], 0.0)
    expected = np.tanh(last.detach().numpy()[0] @ hidden + end.detach().numpy()[0, 0])  # Hopper's limit is 1
    np.testing.assert_allclose(agent.policy().predict(state[None])[0][0], expected, rtol=1e-5)


def test_an_action_is_a_function_of_the_present_state():
    agent, rng = new_agent("mlp_bc"), np.random.default_rng(0)
    after_an_episode, anew = agent.policy(), agent.policy()
    for _ in range(2 * K):
        after_an_episode.predict(rng.normal(size=(4, S)))
    states = rng.normal(size=(4, S))
    np.testing.assert_array_equal(after_an_episode.predict(states)[0], anew.predict(states)[0])


def test_each_step_is_cloned_as_if_it_stood_alone():
    agent, windows = new_agent("mlp_bc"), random_windows()
    states, actions = (torch.from_numpy(x[windows.mask]) for x in (windows.observations, windows.actions))
    assert (states.shape[1:], actions.shape[1:]) == ((S,), (A,))
    expected = (agent.actions(states) - actions).square().mean()
    assert agent.loss(windows, None)[0].item() == pytest.approx(expected.item(), rel=1e-5)
