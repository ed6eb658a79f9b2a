"""Beam search for actions, in a model of tokens.

What is here: the search, the drawing of tokens, and `Planning`, which lets the first actions of the best sequence be
taken. Called by Trajectory Transformer. It must not know the net: `Branches` is all that it asks.

A plan's step: each of `beams` sequences goes on `expand` times, with actions drawn from the model and the most likely
reward and value; the best `beams` of all are kept, by the rewards so far and the value after them; their next state is
the most likely one.

    beams    ──┬─ a a r v ─╮           ╭─ s s s ─┬─ a a r v ─╮
             ──┴─ a a r v ─┤  the best ├─ s s s ─┴─ a a r v ─┤  …  the best one's first action
             ──┬─ a a r v ─┤           │                     │
             ──┴─ a a r v ─╯           ╰─ s s s ─┬─ a a r v ─╯

After github.com/JannerM/trajectory-transformer (trajectory/search/core.py, beam_plan). Differences: actions are drawn
by the same uniform numbers in every episode and at every step, so that an action is a function of what the episode has
shown; the first action is never stop, as the episode goes on; and a plan does not crop what it began with.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from agents.interface import History


@dataclasses.dataclass(frozen=True)
class BeamSearch:
    """How is searched; see `TrajectoryTransformerConfig`, which has the defaults."""

    state_size: int
    """S, tokens of a state."""
    action_size: int
    """A, tokens of an action."""
    horizon: int
    """Transitions of a plan."""
    beams: int
    """Sequences that are kept."""
    expand: int
    """Continuations of each."""
    cdf: float
    """Share of the probability that no action is drawn from, the least likely tokens; of 1 the likeliest is taken."""
    discount: float
    """γ of rewards and values."""

    def uniforms(self, seed: int = 0) -> Tensor:
        """What actions are drawn by, (horizon, A, beams · expand) in [0, 1)."""
        shape = (self.horizon, self.action_size, self.beams * self.expand)
        return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


class Continuations(Protocol):
    """Sequences of tokens that go on: R for each of B beginnings.

    `coming` tokens are added before the next call of `spread` or `choose`, values not counted.
    """

    def spread(self, times: int, coming: int) -> None:
        """Go on with each sequence `times` times."""

    def choose(self, rows: Tensor, coming: int) -> None:
        """Go on with sequences `rows` (B, R') of 0 … R - 1."""

    def add(self, tokens: Tensor) -> Tensor:
        """Add tokens (B, R), one per sequence → logits (B, R, N + 1) of the next."""


class Plans(NamedTuple):
    """The best sequence of each of B beginnings."""

    actions: Tensor
    """(B, horizon, A) int64, tokens."""
    scores: Tensor
    """(B,), discounted rewards and the value after the last."""


def beam_search(
    branches: Continuations,
    logits: Tensor,
    search: BeamSearch,
    expect: Callable[[Tensor, int], Tensor],
    uniforms: Tensor,
) -> Plans:
    """Search for the best sequences.

    Args:
        branches: begun with one sequence each, to the last token of a state; it goes on.
        logits: (B, N + 1) of the next token, the first of an action. The last of N + 1 is stop.
        search: how.
        expect: probabilities (B, R, N + 1) and the dimension in a transition → the mean (B, R) of what they say.
        uniforms: of `search`, on the device of `logits`.
    """
    states, actions = search.state_size, search.action_size
    logits = logits[:, None]
    taken = torch.zeros(len(logits), 1, search.horizon, actions, dtype=torch.int64, device=logits.device)
    achieved = torch.zeros(len(logits), 1, device=logits.device)
    for t in range(search.horizon):
        times = search.expand if t else search.beams * search.expand  # there is one sequence at first
        branches.spread(times, actions + 1)
        logits, taken, achieved = (x.repeat_interleave(times, dim=1) for x in (logits, taken, achieved))
        for a in range(actions):
            taken[:, :, t, a] = draw(logits, search.cdf, uniforms[t, a, : logits.shape[1]], may_stop=t > 0)
            logits = branches.add(taken[:, :, t, a])
        achieved = achieved + search.discount**t * expect(logits.softmax(dim=2), states + actions)
        logits = branches.add(logits.argmax(dim=2))
        scores = achieved + search.discount ** (t + 1) * expect(logits.softmax(dim=2), states + actions + 1)
        scores, best = scores.topk(min(search.beams, scores.shape[1]), dim=1)
        taken, achieved, value = _of(best, taken), _of(best, achieved), _of(best, logits.argmax(dim=2))
        if t < search.horizon - 1:
            branches.choose(best, states)
            logits = branches.add(value)
            for _ in range(states):
                logits = branches.add(logits.argmax(dim=2))
    return Plans(taken[:, 0], scores[:, 0])


def _of(rows: Tensor, x: Tensor) -> Tensor:
    """Rows (B, R') of x (B, R, ...)."""
    return x[torch.arange(len(x), device=x.device)[:, None], rows]


def draw(logits: Tensor, cdf: float, uniforms: Tensor, may_stop: bool) -> Tensor:
    """Tokens (B, R) of logits (B, R, N + 1), without the least likely ones that have `cdf` of the probability together.

    Args:
        logits: the last is of stop.
        cdf: as the original's `cdf_act`; the likeliest token stays whatever it is.
        uniforms: (R,) in [0, 1): which part of the probability is taken.
        may_stop: whether stop may be drawn.
    """
    if not may_stop:
        logits = logits.clone()
        logits[..., -1] = -torch.inf
    chances = logits.softmax(dim=-1)
    ordered = chances.sort(dim=-1).values
    left_out = torch.where(ordered.cumsum(dim=-1) < cdf, ordered, -1.0).amax(dim=-1, keepdim=True)
    kept = torch.where((chances > left_out) | (chances == ordered[..., -1:]), chances, 0.0).cumsum(dim=-1)
    wanted = uniforms.clamp(max=1 - 1e-6)[:, None] * kept[..., -1:]  # below the sum, also when rounded
    return (kept <= wanted).sum(dim=-1)


class Planning:
    """The actions of N episodes: from new plans every `every` steps, from those in between."""

    def __init__(self, plan: Callable[[History], Tensor], every: int) -> None:
        """`plan`: histories of n steps without padding (N, n) → actions (N, horizon, A), any N."""
        self._plan, self._every = plan, every
        self._plans = torch.zeros(0)

    def __call__(self, history: History) -> Tensor:
        """The last step's actions (N, A), of history (N, K) left padded.

        Episodes are planned for together where they are as long. One that is over is not: it shows the state before
        again and a reward of 0 (see `dynagen_bench.evaluation.Policy`), and keeps its last action, which nobody takes.
        """
        due = history.timesteps[:, -1] % self._every == 0
        over = torch.zeros(len(due), dtype=torch.bool)
        if history.mask.shape[1] > 1:
            still = (history.observations[:, -1] == history.observations[:, -2]).all(dim=1)
            over = still & (history.returns_to_go[:, -1] == history.returns_to_go[:, -2]) & history.mask[:, -2]
        lengths = history.mask.sum(dim=1)
        for length in torch.unique(lengths[due & ~over]).tolist():
            chosen = (due & ~over & (lengths == length)).nonzero()[:, 0]
            plans = self._plan(History(*(x[chosen, -length:] for x in history)))
            if len(self._plans) != len(due):
                self._plans = plans.new_zeros(len(due), *plans.shape[1:])
            self._plans[chosen] = plans
        step = history.timesteps[:, -1] % self._every
        actions = self._plans[torch.arange(len(due)), step]
        before = history.actions[:, -2:-1].sum(dim=1)  # 0 where a history is of one step
        return torch.where(over[:, None], before, actions)
