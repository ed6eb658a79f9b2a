"""The history that an acting agent is shown."""

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.acting import LANES, ContextPolicy, blockwise
from agents.interface import History
from dynagen_bench.datasets import WindowSampler
from dynagen_bench.envs import HORIZON
from tests.agents.samples import A, K, S, hopper_spec, new_agent, random_dataset


class Recorder:
    """An agent's `act` that gives planned actions and keeps copies of the histories."""

    def __init__(self, planned) -> None:
        self.planned, self.seen = list(planned), []

    def __call__(self, history) -> torch.Tensor:
        self.seen.append(type(history)(*(x.clone() for x in history)))
        return torch.from_numpy(self.planned[len(self.seen) - 1])


def test_acting_shows_the_windows_of_training():
    dataset = random_dataset(lengths=(12,))
    spec = hopper_spec()
    recorder = Recorder(dataset.actions[t : t + 1] for t in range(12))
    policy = ContextPolicy(recorder, K, spec, target_return=float(dataset.returns_to_go[0]))
    for t in range(12):
        policy.predict(dataset.observations[t : t + 1], episode_start=np.array([t == 0]))
        policy.observe(dataset.rewards[t : t + 1])
    sampler = WindowSampler(dataset, K, spec.normalization)
    for t, history in enumerate(recorder.seen):
        size = min(t + 1, K)
        window = sampler.windows_at(np.array([max(0, t - K + 1)]))
        for field in ("observations", "actions", "returns_to_go", "timesteps"):
            shown, trained = getattr(history, field)[0].numpy(), getattr(window, field)[0][:size].copy()
            if field == "actions":
                trained[-1] = 0.0  # not taken yet
            np.testing.assert_allclose(shown[K - size :], trained, rtol=1e-5, atol=1e-5)
            assert not shown[: K - size].any()
        assert history.mask[0].tolist() == [False] * (K - size) + [True] * size


def test_an_episode_that_begins_anew_forgets_and_leaves_the_others_alone():
    recorder = Recorder(np.full((2, A), t + 1.0, np.float32) for t in range(4))
    policy = ContextPolicy(recorder, K, hopper_spec(), target_return=100.0)
    for t in range(4):
        policy.predict(np.full((2, S), float(t)), episode_start=np.array([t == 0, t in (0, 2)]))
        policy.observe(np.array([1.0, 10.0]))
    last = recorder.seen[-1]
    assert last.timesteps.tolist() == [[0, 0, 1, 2, 3], [0, 0, 0, 0, 1]]
    assert last.mask.sum(dim=1).tolist() == [4, 2]
    assert last.returns_to_go[0].tolist() == [0.0, 100.0, 99.0, 98.0, 97.0]
    assert last.returns_to_go[1].tolist() == [0.0, 0.0, 0.0, 100.0, 90.0]
    assert last.actions[:, :, 0].tolist() == [[0.0, 1.0, 2.0, 3.0, 0.0], [0.0, 0.0, 0.0, 3.0, 0.0]]


def test_another_number_of_episodes_begins_all_of_them():
    recorder = Recorder(np.zeros((n, A), np.float32) for n in (3, 3, 2))
    policy = ContextPolicy(recorder, K, hopper_spec())
    for lanes in (3, 3, 2):
        policy.predict(np.zeros((lanes, S)))
    assert [history.mask.sum().item() for history in recorder.seen] == [3, 6, 2]


def actions_of_lanes(agent, lanes, steps=8):
    """Actions (steps, N, A) in some of 13 episodes; the seventh begins anew at step 3."""
    rng = np.random.default_rng(0)
    observations, rewards = rng.normal(size=(steps, 13, S)), rng.uniform(0, 50, size=(steps, 13))
    policy, actions = agent.policy(), []
    for t in range(steps):
        starts = np.array([t == 0 or (lane == 6 and t == 3) for lane in lanes])
        actions.append(policy.predict(observations[t, lanes], episode_start=starts)[0])
        policy.observe(rewards[t, lanes])
    return np.stack(actions)


@pytest.mark.parametrize("threads", [1, 2])
def test_episodes_act_alone_as_they_do_together_bit_for_bit(transformer, threads):
    agent = new_agent(transformer, embedding=128, context=20)  # products as in the paper's
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        together = actions_of_lanes(agent, list(range(13)))
        for lane in (0, 4, 5, 6, 12):
            assert np.array_equal(actions_of_lanes(agent, [lane])[:, 0], together[:, lane])
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(actions_of_lanes(agent, list(range(13))), together)  # one thread again


def test_an_error_leaves_torch_its_threads():
    def broken(seen):
        raise RuntimeError("interrupted")

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        shown = History(*(torch.ones(3, K, *rest) for rest in ((S,), (A,), (), (), ())))
        with pytest.raises(RuntimeError, match="interrupted"):
            blockwise(broken, torch.device("cpu"))(shown)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_blocks_hold_every_episode_once():
    for lanes in (1, LANES - 1, LANES, 2 * LANES + 1):
        history = History(*(torch.full((lanes, K, *rest), 1.0) for rest in ((S,), (A,), (), (), ())))
        history.observations[:, -1, 0] = torch.arange(lanes)
        seen = []

        def act(block, seen=seen):
            seen.append(block.mask.shape)
            return block.observations[:, -1, :A] * 2

        actions = blockwise(act, torch.device("cpu"))(history)
        assert actions[:, 0].tolist() == [2.0 * lane for lane in range(lanes)]
        assert seen == [(LANES, K)] * -(-lanes // LANES)


def test_the_return_still_wanted_matters_to_who_is_conditioned_on_it(transformer):
    actions = []
    for reward in (0.0, 500.0):
        policy = new_agent(transformer).policy()
        policy.predict(np.zeros((1, S)))
        policy.observe(np.array([reward]))
        actions.append(policy.predict(np.zeros((1, S)))[0])
    assert np.array_equal(*actions) != hasattr(AGENTS[transformer][0](), "target_return")


def test_what_cannot_be_acted_on_is_said_in_one_line():
    policy = ContextPolicy(Recorder([np.zeros((1, A), np.float32)] * (HORIZON + 1)), K, hopper_spec())
    for wrong in (np.zeros(S), np.zeros((1, S + 1))):
        with pytest.raises(ValueError, match=r"observations have shape .*: give \(N, 11\)"):
            policy.predict(wrong)
    for _ in range(HORIZON):
        policy.predict(np.zeros((1, S)))
    with pytest.raises(ValueError, match="rewards have shape"):
        policy.observe(np.zeros(2))
    with pytest.raises(ValueError, match="episode 0 is longer than 200 steps: set episode_start"):
        policy.predict(np.zeros((1, S)))
