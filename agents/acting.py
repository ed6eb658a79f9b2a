"""How a sequence agent acts: the last K steps of N episodes, kept as it was trained on them.

What is here: `ContextPolicy`, which an agent's `policy()` returns. It satisfies the policy protocol of
`dynagen_bench.evaluation`. It must not know which agent it acts for, nor the environment.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.interface import History, RobotSpec
from dynagen_bench.envs import HORIZON

LANES: Final = 10
"""Episodes in one forward pass: more gain little, and one episode alone costs as much as these."""


Seen = TypeVar("Seen", bound=tuple[Tensor, ...])
"""A named tuple of tensors whose first axis is that of episodes, such as `History`."""


def blockwise(act: Callable[[Seen], Tensor], device: torch.device) -> Callable[[Seen], Tensor]:
    """`act` (B, ...) → (B, A) on its device, for any number of episodes: each acts alone as beside others, bit for bit.

    A matrix product may round a row otherwise in a product of another shape, or where threads share it. So `act` gets
    blocks of `LANES` episodes, the last one filled up with padding, and each block is one thread's alone: torch's
    threads take blocks, not parts of products. What is left to chance is that a product treats all its rows alike; the
    tests hold the whole.
    """

    def act_alone(block: Seen) -> Tensor:
        with torch.inference_mode():  # of this thread
            return act(_like(block, (x.to(device) for x in block))).cpu()

    def act_in_blocks(seen: Seen) -> Tensor:
        lanes = len(seen[0])
        filled = (torch.cat((x, x.new_zeros(-lanes % LANES, *x.shape[1:]))) for x in seen)
        blocks = [_like(seen, parts) for parts in zip(*(torch.split(x, LANES) for x in filled), strict=True)]
        threads = torch.get_num_threads()
        if threads == 1 or device.type != "cpu":
            return torch.cat(list(map(act_alone, blocks)))[:lanes]
        try:
            with ThreadPoolExecutor(
                min(threads, len(blocks)), initializer=torch.set_num_threads, initargs=(1,)
            ) as pool:
                actions = list(pool.map(act_alone, blocks))
        finally:
            torch.set_num_threads(threads)  # a worker's call changes the default of the whole process, too
        return torch.cat(actions)[:lanes]

    return act_in_blocks


def _like(seen: Seen, tensors: Iterable[Tensor]) -> Seen:
    """A named tuple of the same kind."""
    return type(seen)(*tensors)


def checked_observations(observation: NDArray[np.floating[Any]], spec: RobotSpec) -> NDArray[np.floating[Any]]:
    """Observations (N, S) as an array; raises ValueError for another shape."""
    observation = np.asarray(observation)
    if observation.ndim != 2 or observation.shape[1] != spec.state_size:
        raise ValueError(f"observations have shape {observation.shape}: give (N, {spec.state_size})")
    return observation


def check_rewards(rewards: NDArray[np.floating[Any]], lanes: int) -> None:
    """Raise ValueError unless rewards are (N,), N being `lanes`."""
    if np.shape(rewards) != (lanes,):
        raise ValueError(f"rewards have shape {np.shape(rewards)}: give {(lanes,)}, one per episode")


class ContextPolicy:
    """N episodes at once: their last K steps, left padded, and the return still wanted in each."""

    def __init__(
        self, act: Callable[[History], Tensor], context: int, spec: RobotSpec, target_return: float = 0.0
    ) -> None:
        """A policy at the start of its episodes.

        Args:
            act: history (N, K) → actions (N, A) of its last step.
            context: K.
            spec: the robot's sizes and normalisation.
            target_return: wanted of a whole episode; agents that use no return are given none.
        """
        self._act, self._context, self._spec, self._target = act, context, spec, target_return
        self._allocate(0)

    def _allocate(self, lanes: int) -> None:
        window = (lanes, self._context)
        self._observations = np.zeros((*window, self._spec.state_size), dtype=np.float32)
        self._actions = np.zeros((*window, self._spec.action_size), dtype=np.float32)
        self._returns = np.zeros(window, dtype=np.float32)
        self._timesteps = np.zeros(window, dtype=np.int64)
        self._mask = np.zeros(window, dtype=np.bool_)
        self._wanted = np.full(lanes, self._target, dtype=np.float64)  # (N,), return still to be achieved
        self._now = np.zeros(lanes, dtype=np.int64)  # (N,) steps done in the episode

    def predict(
        self,
        observation: NDArray[np.floating[Any]],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        """Actions (N, A) float32 for observations (N, S), which become part of the history.

        Args:
            observation: (N, S), as the environment gives them.
            state: not used, the history is kept here; returned as it came.
            episode_start: (N,), where an episode begins. The first call, and one with another N, begins all of them.
            deterministic: not used, the agents have one action for a history.

        Raises:
            ValueError: observations of another shape, or an episode that is longer than any trained on.
        """
        observation = checked_observations(observation, self._spec)
        if len(observation) != len(self._now):
            self._allocate(len(observation))
        elif episode_start is not None:
            self._begin(np.asarray(episode_start, dtype=np.bool_))
        if (self._now >= HORIZON).any():
            lane = int(np.argmax(self._now))
            raise ValueError(f"episode {lane} is longer than {HORIZON} steps: set episode_start where a new one begins")
        self._shift()
        self._observations[:, -1] = self._spec.normalization.apply(observation)
        self._returns[:, -1], self._timesteps[:, -1], self._mask[:, -1] = self._wanted, self._now, True
        fields = (self._observations, self._actions, self._returns, self._timesteps, self._mask)
        with torch.inference_mode():
            actions = self._act(History(*map(torch.from_numpy, fields))).numpy()
        self._actions[:, -1] = actions
        self._now += 1
        return actions, state

    def observe(self, rewards: NDArray[np.floating[Any]]) -> None:
        """Lower the wanted returns by the rewards (N,) of the step just done (paper, section 4, Evaluation)."""
        check_rewards(rewards, len(self._wanted))
        self._wanted -= rewards

    def _begin(self, starting: NDArray[np.bool_]) -> None:
        for array in (self._observations, self._actions, self._returns, self._timesteps, self._mask, self._now):
            array[starting] = 0
        self._wanted[starting] = self._target

    def _shift(self) -> None:
        for array in (self._observations, self._actions, self._returns, self._timesteps, self._mask):
            array[:, :-1] = array[:, 1:]
        self._actions[:, -1] = 0.0  # not taken yet
