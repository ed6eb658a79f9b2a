"""Beam search, in models of which everything is known."""

import itertools

import numpy as np
import pytest
import torch

from agents.interface import History
from agents.trajectory_transformer.planning import BeamSearch, Planning, beam_search, draw
from tests.agents.samples import A, K, S

S1, A2, BINS = 1, 2, 3  # sizes of a state and an action in the model below
J = S1 + A2 + 2
WORTH = torch.tensor([0.0, 1.0, 5.0])
"""What a reward's and a value's tokens stand for."""


class Chain:
    """A model of a small decision process: every token after the first state is a function of the whole sequence.

    Actions may be any, by chances of the table; state, reward and value are sure, from a table by what was done so far.
    """

    def __init__(self, tables, lanes: int) -> None:
        self.tables, self.sequences = tables, torch.zeros(lanes, 1, 0, dtype=torch.int64)

    def spread(self, times, coming) -> None:
        self.sequences = self.sequences.repeat_interleave(times, dim=1)

    def choose(self, rows, coming) -> None:
        self.sequences = torch.stack([x[y] for x, y in zip(self.sequences, rows, strict=True)])

    def add(self, tokens) -> torch.Tensor:
        self.sequences = torch.cat((self.sequences, tokens[..., None]), dim=2)
        return self.logits()

    def logits(self) -> torch.Tensor:
        lanes, rows, _ = self.sequences.shape
        out = torch.empty(lanes, rows, BINS + 1)
        for lane, row in itertools.product(range(lanes), range(rows)):
            out[lane, row] = next_logits(self.tables[lane], self.sequences[lane, row].tolist())
        return out


def next_logits(table, tokens) -> torch.Tensor:
    """Of the token after a sequence that begins with the first action."""
    dimension = (len(tokens) + S1) % J
    place = sum((token + 1) * 7**i for i, token in enumerate(tokens)) % 997
    if S1 <= dimension < S1 + A2:
        return torch.cat((table[place, dimension], torch.tensor([-30.0])))
    sure = torch.full((BINS + 1,), -40.0)
    sure[int(table[place, dimension].argmax())] = 40.0
    return sure


def expect(probabilities, dimension) -> torch.Tensor:
    assert dimension in (S1 + A2, S1 + A2 + 1)
    return probabilities[..., :-1] @ WORTH


def search_in(tables, search) -> tuple[np.ndarray, np.ndarray]:
    chain = Chain(tables, len(tables))
    plans = beam_search(chain, chain.logits()[:, 0], search, expect, search.uniforms())
    return plans.actions.numpy(), plans.scores.numpy()


def score_of(table, actions, discount=0.9) -> float:
    """Of a sequence of actions (horizon, A2)."""
    tokens, total = [], 0.0
    for t, action in enumerate(actions):
        tokens += list(action)
        for power in (t, t + 1):  # of the reward, and of the value
            tokens.append(int(next_logits(table, tokens).argmax()))
            worth = discount**power * WORTH[tokens[-1]].item()
            total, value = (total + worth, None) if power == t else (total, worth)
        tokens.append(int(next_logits(table, tokens).argmax()))
    return total + value


def random_tables(lanes, seed=0) -> torch.Tensor:
    return torch.randn(lanes, 997, J, BINS, generator=torch.Generator().manual_seed(seed))


def tiny_search(**changes) -> BeamSearch:
    return BeamSearch(S1, A2, **({"horizon": 2, "beams": 8, "expand": 2, "cdf": 0.0, "discount": 0.9} | changes))


def test_with_beams_for_all_sequences_it_finds_the_best_one():
    tables = random_tables(3)
    actions, scores = search_in(tables, tiny_search(beams=500))
    pairs = list(itertools.product(range(BINS), repeat=A2))
    for table, found, score in zip(tables, actions, scores, strict=True):
        best = max(score_of(table, sequence) for sequence in itertools.product(pairs, repeat=2))
        assert score == pytest.approx(best, rel=1e-5)
        assert score_of(table, found.tolist()) == pytest.approx(best, rel=1e-5)


def test_a_score_is_that_of_its_actions():
    tables = random_tables(4, seed=1)
    actions, scores = search_in(tables, tiny_search(horizon=4))
    for table, found, score in zip(tables, actions, scores, strict=True):
        assert score == pytest.approx(score_of(table, found.tolist()), rel=1e-5)


def test_more_beams_find_no_less_in_the_mean():
    tables = random_tables(6, seed=2)
    means = [search_in(tables, tiny_search(beams=beams))[1].mean() for beams in (1, 8, 200)]
    assert means[0] < means[1] <= means[2]


def test_one_beam_of_the_likeliest_tokens_is_greedy():
    tables = random_tables(5, seed=3)
    actions, _ = search_in(tables, tiny_search(horizon=3, beams=1, expand=1, cdf=1.0))
    for table, found in zip(tables, actions, strict=True):
        tokens = []
        for _ in range(3 * J - S1 - 2):
            tokens.append(int(next_logits(table, tokens).argmax()))
        greedy = [tokens[t * J + a] for t in range(3) for a in range(A2)]
        assert found.flatten().tolist() == greedy


def test_lanes_are_searched_alone_as_together():
    tables = random_tables(4, seed=4)
    together, scores = search_in(tables, tiny_search())
    for lane in range(4):
        alone, score = search_in(tables[lane : lane + 1], tiny_search())
        assert np.array_equal(alone[0], together[lane])
        assert score[0] == scores[lane]


def test_draws_have_the_chances_of_what_is_kept():
    chances = torch.tensor([0.05, 0.4, 0.1, 0.25, 0.2])
    uniforms = (torch.arange(1000) + 0.5) / 1000
    logits = chances.log().expand(1, 1000, 5)
    for cdf, expected in (
        (0.0, chances / chances.sum()),
        (0.3, torch.tensor([0, 0.4, 0, 0.25, 0.2]) / 0.85),  # the original keeps what reaches the share
        (0.5, torch.tensor([0, 0.4, 0, 0.25, 0]) / 0.65),
        (1.0, torch.tensor([0, 1.0, 0, 0, 0])),
    ):
        drawn = draw(logits, cdf, uniforms, may_stop=True)
        np.testing.assert_allclose(torch.bincount(drawn[0], minlength=5) / 1000, expected, atol=0.002)


def test_equal_chances_are_all_kept_and_stop_is_not_drawn_unless_it_may():
    uniforms = (torch.arange(100) + 0.5) / 100
    drawn = draw(torch.zeros(1, 100, 4), 0.6, uniforms, may_stop=False)
    assert torch.bincount(drawn[0], minlength=4).tolist() == [33, 34, 33, 0]
    stopping = torch.tensor([0.0, 0.0, 0.0, 50.0]).expand(1, 100, 4)
    assert (draw(stopping, 0.6, uniforms, may_stop=True) == 3).all()
    assert (draw(stopping, 0.6, uniforms, may_stop=False) < 3).all()
    ones = torch.ones(100)  # no uniform number, but a rounded one may come near
    assert (draw(torch.zeros(1, 100, 4), 0.0, ones, may_stop=True) == 3).all()


class Counter:
    """Plans of which an action is (length of the history, call, step of the plan)."""

    def __init__(self) -> None:
        self.calls = []

    def __call__(self, history) -> torch.Tensor:
        lanes, length = history.mask.shape
        assert history.mask.all()
        self.calls.append((length, history.observations[:, -1, 0].tolist()))
        steps = torch.arange(3.0).expand(lanes, 3)
        return torch.stack((torch.full((lanes, 3), float(length)), torch.full((lanes, 3), len(self.calls)), steps), 2)


def history_of(lengths, timesteps, first=0.0) -> History:
    """Lanes of these lengths; no two observations alike, no reward 0."""
    mask = torch.arange(K) >= K - torch.tensor(lengths)[:, None]
    observations = (torch.arange(len(lengths) * K * S) + first).view(len(lengths), K, S).float() * mask[:, :, None]
    returns = -torch.arange(float(K)).expand(len(lengths), K)
    return History(observations, torch.ones(len(lengths), K, A), returns, timesteps_of(timesteps), mask)


def timesteps_of(now) -> torch.Tensor:
    return torch.tensor(now)[:, None] + torch.arange(1 - K, 1)


def test_episodes_of_one_length_are_planned_for_together():
    plan = Counter()
    actions = Planning(plan, every=1)(history_of([2, 5, 2], [1, 9, 1]))
    assert [(length, len(lanes)) for length, lanes in plan.calls] == [(2, 2), (5, 1)]
    assert actions.tolist() == [[2, 1, 0], [5, 2, 0], [2, 1, 0]]


def test_steps_between_plans_are_those_of_the_last_plan():
    plan = Counter()
    planning = Planning(plan, every=3)
    taken = [planning(history_of([5, 5], [t, t + 1], first=t)).tolist() for t in range(2, 7)]
    assert [[step for *_, step in both] for both in taken][1:] == [[0, 1], [1, 2], [2, 0], [0, 1]]
    assert len(plan.calls) == 4


def test_what_is_over_is_not_planned_for():
    plan, history = Counter(), history_of([5, 5, 5], [4, 4, 4])
    history.observations[:2, -1] = history.observations[:2, -2]
    history.returns_to_go[::2, -1] = history.returns_to_go[::2, -2]
    actions = Planning(plan, every=1)(history)
    assert actions.tolist() == [[1, 1, 1], [5, 1, 0], [5, 1, 0]]  # only the first has both
    assert len(plan.calls[0][1]) == 2
