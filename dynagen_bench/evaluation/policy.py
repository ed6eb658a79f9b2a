"""What evaluation asks of a policy: one method, and a second one if the policy wants its rewards.

What is here: two protocols. Evaluation calls their methods; anything that has them can be evaluated, no class of ours
has to be inherited. They must not tell a policy which dynamics it is in.
"""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Policy(Protocol):
    """A policy for N episodes at once; Stable-Baselines3's call, so that its models are policies as they are.

    An own policy is as short as this:

        class Still:
            def predict(self, observation, state=None, episode_start=None, deterministic=False):
                return np.zeros((len(observation), 3)), state
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Choose the actions of one step.

        Each row is an episode of its own: its action may depend on what that row has shown so far, and on no other row.

        The parameters are typed Any because Stable-Baselines3's own signature is wider and narrower than ours in turn.

        Args:
            observation: (N, S) float64, the environments' observations. Rows of finished episodes keep their last one.
            state: what the last call returned as state; None in the first. Recurrent policies keep their memory here.
            episode_start: (N,) bool, True where an episode begins with this observation.
            deterministic: the policy should choose its best action and not draw one; evaluation always asks so.

        Returns:
            actions (N, A), finite numbers, of finished episodes too; and the state for the next call.
        """
        ...


@runtime_checkable
class RewardAware(Protocol):
    """A policy that is told its rewards, as one conditioned on a return that is still to come needs."""

    def observe(self, rewards: NDArray[np.float64]) -> None:
        """Take the rewards (N,) float64 of the step just made; 0 for finished episodes."""
        ...
