"""What every score is to be read against: random actions, none, and the data itself.

What is here: `RandomPolicy`, `ZeroPolicy`, the baselines' submissions, and `data_returns`. Called by the command line
and the leaderboard. It must not know agents.
"""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.collection.policies import POLICY_FOLDER
from dynagen_bench.datasets.scores import reference_scores
from dynagen_bench.evaluation.experts import behaviour_policy, best_policy, snapshots_of_tests
from dynagen_bench.evaluation.policy import Policy
from dynagen_bench.evaluation.rollout import action_space, evaluate
from dynagen_bench.evaluation.submission import FORMAT_VERSION, MAX_RUNS, Run, Submission
from dynagen_bench.evaluation.traces import Traces


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


class ZeroPolicy:
    """No action at all: in a robot that is paid for being upright it returns more than random ones do."""

    def __init__(self, robot: str) -> None:
        """Raises ValueError for an unknown robot."""
        self._size = len(action_space(robot).low)

    def predict(
        self,
        observation: NDArray[np.float64],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        """Actions (N, A) float32 of zeros; `state` is given back as it came."""
        return np.zeros((len(observation), self._size), dtype=np.float32), state


Baseline = Literal["random", "zero", "behaviour", "expert"]

_SEEDLESS: Final[tuple[Baseline, ...]] = ("zero", "expert")
"""What does the same in every run."""

_ABOUT: Final[dict[Baseline, dict[str, Any]]] = {
    "random": {
        "agent": "Random policy",
        "description": "Actions drawn uniformly from the action space, whatever is observed.",
        "privileged": "none",
    },
    "zero": {
        "agent": "Zero actions",
        "description": "No action at all, whatever is observed: what standing, or falling, returns by itself.",
        "privileged": "none",
    },
    "behaviour": {
        "agent": "Behaviour policies",
        "description": "What made the data of the test dynamics: twenty snapshots of a SAC run in each of them, acting "
        "there with their noise, every second of them in a run. A reference: it was trained in the test dynamics.",
        "privileged": "test-dynamics",
    },
    "expert": {
        "agent": "Best SAC policies",
        "description": "Of the twenty snapshots of the SAC run in each test dynamics the best one, without noise; "
        "chosen by its mean return in ten other episodes. A reference: it was trained in the test dynamics.",
        "privileged": "test-dynamics",
    },
}


def baseline_submission(
    policy: Baseline, robots: Sequence[str], runs: int = 5, folder: Path = POLICY_FOLDER
) -> tuple[Submission, list[Traces]]:
    """Evaluate a baseline in the test dynamics of robots, as an entry for the leaderboard, with its traces.

    What cannot become an entry is refused before the first evaluation.

    Args:
        policy: `random`; `zero`, no action; `behaviour`, what made the test dynamics' data; `expert`, the best of
            those.
        robots: on which robots.
        runs: seeds 0, 1, ... of each robot; `zero` and `expert` know no seed and have one run.
        folder: where the behaviour policies are stored.

    Raises:
        ValueError: an unknown robot, none, or one twice, no run, or more runs than a submission may have.
        FileNotFoundError: a robot has no stored behaviour policies.
    """
    runs = ids.check_count("runs", runs)
    if not robots:
        raise ValueError(f"no robot is given: name one or more of {', '.join(ids.ROBOTS)}")
    if len({ids.check_robot(robot) for robot in robots}) < len(robots):
        raise ValueError(f"a robot is named twice in {' '.join(robots)}: name each once")
    seeds = 1 if policy in _SEEDLESS else runs
    if seeds * len(robots) > MAX_RUNS:
        raise ValueError(f"{seeds * len(robots)} runs asked for: give at most {MAX_RUNS}, all robots together")
    if policy in ("behaviour", "expert"):
        for robot in robots:
            snapshots_of_tests(robot, folder)
    made, traces = [], []
    for robot in robots:
        for seed in range(seeds):
            found = evaluate(_make(policy, robot, seed, folder), robot, progress=True)
            made.append(Run.from_evaluation(found, seed=seed, gradient_steps=0))
            assert found.traces is not None
            traces.append(found.traces)
    options = "" if policy == "random" else f" --policy {policy}"
    options += "" if policy in _SEEDLESS or runs == 5 else f" --runs {runs}"
    submission = Submission(
        format_version=FORMAT_VERSION,
        authors=["DynaGen Bench"],
        track="zero-shot",
        checkpoint="last",
        hardware="any",
        hours=0.0,
        versions={package: version(package) for package in ("dynagen-bench", "mujoco", "gymnasium", "numpy")},
        commands=[f"dynagen baseline {' '.join(robots)} --output my-entry{options}"],
        runs=made,
        **_ABOUT[policy],
    )
    return submission, traces


def _make(policy: Baseline, robot: str, seed: int, folder: Path) -> Policy:
    if policy == "random":
        return RandomPolicy(robot, seed)
    if policy == "zero":
        return ZeroPolicy(robot)
    return behaviour_policy(robot, seed, folder) if policy == "behaviour" else best_policy(robot, folder)


def data_returns(robot: str) -> dict[str, float]:
    """Label of each test dynamics → mean return of its data: what the behaviour policies got there, in all snapshots.

    It is no policy's result (each behaviour policy was trained in its test dynamics), but it says what imitating the
    data would give.
    """
    references = reference_scores(robot)
    return {name.label: references[name.label].mean for name in ids.dynamics_ids(robot, ("test",))}
