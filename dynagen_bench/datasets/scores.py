"""Reference scores: what the data themselves return, and scores on their scale.

What is here: `reference_scores` and the official score made of them. Called by evaluation and the leaderboard. It reads
one committed file; it must not know the data that the file was made from, nor who is scored.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynagen_bench import ids
from dynagen_bench.whole import stored_json, update_json

REFERENCE_FILE: Final = Path(__file__).with_name("reference_scores.json")
"""robot → label → min, max and mean return of that dynamics' data; made with the data, from all of its snapshots."""


class Reference(NamedTuple):
    """Returns of the episodes in one dynamics' data (paper, Table 5), undiscounted."""

    min: float
    max: float
    mean: float


def reference_scores(robot: str, file: Path | None = None) -> dict[str, Reference]:
    """Reference scores of a robot: label (`train0` ... `test4`) → `Reference`.

    Args:
        robot: name of the robot.
        file: another file than the committed one.

    Raises:
        ValueError: an unknown robot, or one whose data have not been made yet.
    """
    content = stored_json(REFERENCE_FILE if file is None else file)
    if ids.check_robot(robot) not in content:
        raise ValueError(
            f"no reference scores for {robot}: make them with its data, `dynagen data build {robot} --write-manifest`"
        )
    return {label: Reference(**scores) for label, scores in content[robot].items()}


def score_range(robot: str, file: Path | None = None) -> tuple[float, float]:
    """The returns that are 0 and 100 on the official scale: min and max over all test dynamics' data of a robot.

    Raises:
        ValueError: as `reference_scores`.
    """
    scores = reference_scores(robot, file)
    tests = [scores[name.label] for name in ids.dynamics_ids(robot, ("test",))]
    return min(test.min for test in tests), max(test.max for test in tests)


def normalized_score(robot: str, returns: ArrayLike, file: Path | None = None) -> NDArray[np.float64]:
    """Official scores of returns of any shape: 100 (R − min) / (max − min), with `score_range`.

    Raises:
        ValueError: as `reference_scores`.
    """
    low, high = score_range(robot, file)
    return np.asarray(100.0 * (np.asarray(returns, dtype=np.float64) - low) / (high - low))


def write_reference_scores(robot: str, scores: Mapping[str, Reference], file: Path | None = None) -> None:
    """Put a robot's reference scores into the file, in place of those it had."""
    rounded: dict[str, Any] = {
        label: {field: round(value, 6) for field, value in score._asdict().items()} for label, score in scores.items()
    }
    update_json(REFERENCE_FILE if file is None else file, {robot: rounded})
