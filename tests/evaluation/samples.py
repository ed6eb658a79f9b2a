"""Small evaluations and submissions with round numbers, for the tests of evaluation and of the leaderboard."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.datasets.scores import Reference, write_reference_scores
from dynagen_bench.evaluation import EPISODES, Evaluation, RandomPolicy, evaluate, reset_seeds
from dynagen_bench.evaluation.submission import Run, Submission, write_submission


def write_references(file: Path, robots: tuple[str, ...] = ids.ROBOTS) -> None:
    """Reference scores of which one can compute with: test dynamics i has min 10·i, max 100 + 25·i, mean 50 + i.

    A robot's official scale goes from 0 to 200, so that its score is half its mean return; training data do not count.
    """
    for robot in robots:
        scores = {f"test{i}": Reference(10.0 * i, 100.0 + 25.0 * i, 50.0 + i) for i in range(5)}
        scores |= {f"train{i}": Reference(-1000.0, 1000.0, 0.0) for i in range(20)}
        write_reference_scores(robot, scores, file)


def evaluation(robot: str = "Hopper", mean: float = 100.0, episodes: int = EPISODES) -> Evaluation:
    """An evaluation in all test dynamics whose returns are `mean` throughout, with the official seeds."""
    indices = tuple(range(5))
    shape = (len(indices), episodes)
    seeds = reset_seeds(robot, "test", indices, episodes)
    return Evaluation(robot, "test", indices, np.full(shape, mean), np.full(shape, 200), seeds, "4.0.0")


def submission(runs: dict[str, list[float]] | None = None, **fields: Any) -> Submission:
    """A submission with one run for each mean return given; `fields` replace its texts."""
    means = {"Hopper": [100.0]} if runs is None else runs
    given: dict[str, Any] = {
        "format_version": 1,
        "agent": "DADT",
        "authors": ["A. Author"],
        "description": "A transformer.",
        "track": "zero-shot",
        "checkpoint": "last",
        "privileged": "none",
        "hardware": "two cores",
        "hours": 0.5,
        "versions": {"mujoco": "4.0.0"},
        "runs": [
            Run(robot=robot, seed=seed, gradient_steps=1000, evaluation=evaluation(robot, mean))
            for robot, robot_means in means.items()
            for seed, mean in enumerate(robot_means)
        ],
    }
    return Submission.model_validate(given | fields)


def traced(
    folder: Path,
    robots: tuple[str, ...] = ("Hopper",),
    seeds: tuple[int, ...] = (0,),
    *,
    apart: int = 0,
    **fields: Any,
) -> Submission:
    """Write a submission of short real episodes, of random actions, with their traces, and return it.

    Those of the same seed and the same `apart` are the same episodes: two agents of one board need another.
    """
    found = {(robot, seed): evaluate(RandomPolicy(robot, apart + seed), robot) for robot in robots for seed in seeds}
    runs = [Run.from_evaluation(one, seed=seed, gradient_steps=0) for (_, seed), one in found.items()]
    made = submission().model_copy(update={"format_version": 2, "runs": runs} | fields)
    write_submission(folder, made, [one.traces for one in found.values() if one.traces is not None])
    return made


def with_other_arithmetic(code: str, *arguments: str) -> Any:
    """What a Python process prints as JSON whose C library has another sine: it is told that there is no AVX2 and FMA.

    Skips the test where that changes nothing, as on another processor or C library.
    """
    sine = "import math; print(sum(hash(math.sin(x / 7)) for x in range(10_000)))"
    other = os.environ | {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA", "OMP_NUM_THREADS": "1"}

    def printed(program: str, environment: Any) -> str:
        command = [sys.executable, "-c", program, *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    if printed(sine, other) == printed(sine, os.environ):
        pytest.skip("the C library computes the same here, whatever it is told of the processor")
    return json.loads(printed(code, other))
