"""What every score is to be read against: random actions, and the data itself.

What is here: `RandomPolicy`, its submission, and `data_returns`. Called by the command line and the leaderboard. It
must not know agents.
"""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.scores import reference_scores
from dynagen_bench.evaluation.result import EpisodeRecord
from dynagen_bench.evaluation.rollout import action_space, evaluate
from dynagen_bench.evaluation.submission import Run, Submission


class RandomPolicy:
    """Actions drawn uniformly from a robot's action space, whatever is observed.

    They are random also where `deterministic` is asked for: the generator's seed makes them repeatable.
    """

    def __init__(self, robot: str, seed: int = 0) -> None:
        """The actions are a function of `seed`; raises ValueError for an unknown robot."""
        space = action_space(robot)
        self._low, self._high = space.low, space.high
        self._rng = np.random.default_rng(seed)

    def predict(
        self,
        observation: NDArray[np.float64],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        """Draw actions (N, A) float32; `state` is given back as it came."""
        shape = (len(observation), len(self._low))
        return self._rng.uniform(self._low, self._high, shape).astype(np.float32), state


def random_submission(robot: str, seeds: Sequence[int] = range(5)) -> Submission:
    """Evaluate the random policy of each seed in the test dynamics, as an entry for the leaderboard."""
    runs = [
        Run(
            robot=robot,
            seed=seed,
            gradient_steps=0,
            evaluation=EpisodeRecord.from_evaluation(evaluate(RandomPolicy(robot, seed), robot)),
        )
        for seed in seeds
    ]
    return Submission(
        format_version=1,
        agent="Random policy",
        authors=["DynaGen Bench"],
        description="Actions drawn uniformly from the action space, whatever is observed.",
        track="zero-shot",
        checkpoint="last",
        privileged="none",
        hardware="any",
        hours=0.0,
        versions={package: version(package) for package in ("dynagen-bench", "mujoco", "gymnasium", "numpy")},
        runs=runs,
    )


def data_returns(robot: str) -> dict[str, float]:
    """Label of each test dynamics → mean return of its data: what the behaviour policies got there, in all snapshots.

    It is no policy's result (each behaviour policy was trained in its test dynamics), but it says what imitating the
    data would give.
    """
    references = reference_scores(robot)
    return {name.label: references[name.label].mean for name in ids.dynamics_ids(robot, ("test",))}
