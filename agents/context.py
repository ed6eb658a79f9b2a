"""How an agent acts that is told the dynamics by a set of transitions.

What is here: `ContextActor` and the order of a transition's numbers. FOCAL's `policy()` returns one. It must not know
how an action is chosen or transitions are encoded, nor the environment.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.acting import blockwise, check_rewards, checked_observations
from agents.interface import RobotSpec


class Known(NamedTuple):
    """What an action is chosen from."""

    observations: Tensor
    """(N, S) float32, normalised."""
    z: Tensor
    """(N, Z) float32, what is known of the dynamics."""


class Step(NamedTuple):
    """One transition an episode."""

    transitions: Tensor
    """(N, 2 S + A + 1) float32."""


def transitions_of(observations: Tensor, actions: Tensor, rewards: Tensor, following: Tensor) -> Tensor:
    """Transitions (..., 2 S + A + 1) of (..., S) normalised, (..., A), (...) and the next (..., S)."""
    return torch.cat((observations, actions, rewards[..., None], following), dim=-1)


class ContextActor:
    """N episodes at once, each with the mean z of its own transitions so far; or all with one z that is given."""

    def __init__(
        self,
        act: Callable[[Known], Tensor],
        encode: Callable[[Step], Tensor],
        device: torch.device,
        spec: RobotSpec,
        latent: int,
        given: Tensor | None = None,
    ) -> None:
        """A policy at the start of its episodes.

        Args:
            act: what is known (N) → actions (N, A).
            encode: transitions (N) → z (N, Z) of each.
            device: where these two compute.
            spec: the robot's sizes and normalisation.
            latent: Z.
            given: (Z,), in place of what the episodes show.
        """
        self._act = blockwise(act, device)
        self._encode = blockwise(encode, device)
        self._spec, self._latent, self._given = spec, latent, given
        self._allocate(0)

    def _allocate(self, lanes: int) -> None:
        self._sum = torch.zeros(lanes, self._latent)
        self._count = torch.zeros(lanes, 1)
        self._before = torch.zeros(lanes, self._spec.state_size)
        self._actions = torch.zeros(lanes, self._spec.action_size)
        self._rewards = torch.zeros(lanes)
        self._begun = torch.zeros(lanes, dtype=torch.bool)  # has a step behind it

    def predict(
        self,
        observation: NDArray[np.floating[Any]],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        """Actions (N, A) float32 for observations (N, S); what the last step has shown becomes part of z.

        `state` and `deterministic` are not used, as in `acting.ContextPolicy`. An episode may have any length.

        Raises:
            ValueError: observations of another shape.
        """
        observation = checked_observations(observation, self._spec)
        lanes = len(observation)
        if lanes != len(self._begun):
            self._allocate(lanes)
        elif episode_start is not None:
            starting = torch.from_numpy(np.asarray(episode_start, dtype=np.bool_))
            for tensor in (self._sum, self._count, self._begun):
                tensor[starting] = 0
        now = torch.from_numpy(self._spec.normalization.apply(observation))
        with torch.inference_mode():
            if self._given is None and self._begun.any():
                step = Step(transitions_of(self._before, self._actions, self._rewards, now))
                self._sum += torch.where(self._begun[:, None], self._encode(step), 0.0)
                self._count += self._begun[:, None]
            z = self._sum / self._count.clamp(min=1) if self._given is None else self._given.expand(lanes, -1)
            actions = self._act(Known(now, z))
        self._before, self._actions, self._begun = now, actions, torch.ones(lanes, dtype=torch.bool)
        return actions.numpy().copy(), state

    def observe(self, rewards: NDArray[np.floating[Any]]) -> None:
        """Take the rewards (N,) of the step just made."""
        check_rewards(rewards, len(self._rewards))
        self._rewards = torch.from_numpy(np.asarray(rewards, dtype=np.float32))
