"""What an evaluation found: every episode's return, and the scores that follow from them.

What is here: `Evaluation` with its scores, and `EpisodeRecord`, its form as JSON. Called by `evaluate`, training,
submissions and the leaderboard. It must not know policies or how episodes are run.
"""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Final, TypeVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.datasets.scores import normalized_score, reference_scores
from dynagen_bench.envs import HORIZON
from dynagen_bench.evaluation.traces import Traces

STRICT: Final = pydantic.ConfigDict(
    strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
)
"""Files are read to the letter: a number in quotes, an unknown field or a NaN is an error and no guess is made."""

MAX_EPISODES: Final = 1000
"""Episodes in one dynamics that a file may hold; what is read stays small."""


MAX_RETURN: Final = 1e13
"""No episode has a larger return, either way: MuJoCo calls a velocity above 1e10 m/s a bad state. Means stay finite."""

Number = TypeVar("Number", int, float)
Rows = Annotated[
    list[Annotated[list[Number], pydantic.Field(min_length=1, max_length=MAX_EPISODES)]],
    pydantic.Field(min_length=1, max_length=max(ids.SPLIT_SIZES.values())),
]
"""A row a dynamics, a number an episode."""


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """The episodes of one policy in some dynamics of one robot.

    Attributes:
        robot, split: where it acted.
        indices: the dynamics of the split, in the order of the rows below.
        returns: (dynamics, episodes) float64, undiscounted.
        lengths: (dynamics, episodes) int64, steps, 1 to 200.
        seeds: (dynamics, episodes) int64, reset seeds: `env.reset(seed=...)` starts the same episode.
        mujoco: version of MuJoCo that ran the episodes; returns are the same only under the same version.
        physics: `traces.physics_digest` of the machine that ran them; None in files that are older than it.
        traces: what the episodes did, in the order of the rows; None if they were not kept. They have a file of their
            own and are not in the JSON.

    Raises:
        ValueError: the arrays are of different shapes, hold a number that cannot be, or do not belong to the indices.
    """

    robot: str
    split: str
    indices: tuple[int, ...]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    seeds: NDArray[np.int64]
    mujoco: str
    physics: str | None = None
    traces: Traces | None = None

    def __post_init__(self) -> None:
        ids.choose_ids(self.robot, self.split, self.indices)
        for name, array in (("returns", self.returns), ("lengths", self.lengths), ("seeds", self.seeds)):
            if array.ndim != 2 or array.size == 0 or array.shape != (len(self.indices), self.returns.shape[-1]):
                raise ValueError(
                    f"{name} have shape {array.shape}: give a row for each of the {len(self.indices)} indices, "
                    "with a number for each episode, in returns, lengths and seeds alike"
                )
        if not np.isfinite(self.returns).all():
            raise ValueError("returns hold a number that is not finite")
        if self.lengths.min() < 1 or self.lengths.max() > HORIZON:
            raise ValueError(
                f"lengths go from {self.lengths.min()} to {self.lengths.max()}: episodes have 1 to {HORIZON} steps"
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """The dynamics' labels in the order of the rows, `("test0", ...)`."""
        return tuple(ids.DynamicsId(self.robot, self.split, index).label for index in self.indices)

    @property
    def score(self) -> float:
        """The official score: 100·(mean return − min)/(max − min), min and max over all the test dynamics' data.

        That is the scale whatever the split.

        Raises:
            ValueError: the robot has no reference scores yet.
        """
        return float(normalized_score(self.robot, float(self.returns.mean())))

    @property
    def dynamics_scores(self) -> dict[str, float]:
        """Label → 100·(mean return − min)/(max − min), with min and max of that dynamics' own data.

        Their mean is not the official score: each has its own scale.

        Raises:
            ValueError: a dynamics has no reference scores (`nominal` has no data).
        """
        references = reference_scores(self.robot)
        scores = {}
        for label, mean in zip(self.labels, self.returns.mean(axis=1).tolist(), strict=True):
            if label not in references:
                raise ValueError(f"no reference scores for {self.robot} {label}: there are {', '.join(references)}")
            scores[label] = 100.0 * (mean - references[label].min) / (references[label].max - references[label].min)
        return scores

    def to_json(self) -> dict[str, Any]:
        """The plain form that `from_json` reads: strings, numbers and lists of them."""
        physics = {} if self.physics is None else {"physics": self.physics}
        return {
            "robot": self.robot,
            "split": self.split,
            "indices": list(self.indices),
            "returns": self.returns.tolist(),
            "lengths": self.lengths.tolist(),
            "seeds": self.seeds.tolist(),
            "mujoco": self.mujoco,
            **physics,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Evaluation":
        """Read the plain form; raises ValueError with one line naming the field that is wrong."""
        try:
            return EpisodeRecord.model_validate(dict(data)).evaluation()
        except pydantic.ValidationError as error:
            raise ValueError(f"not an evaluation: {first_error(error)}") from error


class EpisodeRecord(pydantic.BaseModel):
    """The JSON form of an `Evaluation`: the same fields, as lists; what it holds is checked when it is read."""

    model_config = STRICT

    robot: str
    split: str
    indices: list[int] = pydantic.Field(min_length=1, max_length=max(ids.SPLIT_SIZES.values()))
    returns: Rows[Annotated[float, pydantic.Field(ge=-MAX_RETURN, le=MAX_RETURN)]]
    lengths: Rows[Annotated[int, pydantic.Field(ge=1, le=HORIZON)]]
    seeds: Rows[Annotated[int, pydantic.Field(ge=0, lt=2**31)]]
    mujoco: str = pydantic.Field(pattern=r"^[0-9A-Za-z.+-]{1,32}$")
    physics: str | None = pydantic.Field(default=None, pattern=r"^[0-9a-f]{16}$")
    """Digest of the machine's arithmetic: where a replay finds the same, it has to be exact."""

    @classmethod
    def from_evaluation(cls, evaluation: Evaluation) -> "EpisodeRecord":
        """The record of an evaluation."""
        return cls.model_validate(evaluation.to_json())

    @pydantic.model_validator(mode="after")
    def _is_an_evaluation(self) -> "EpisodeRecord":
        self.evaluation()
        return self

    def evaluation(self) -> Evaluation:
        """The same as arrays; raises ValueError where the fields do not fit each other."""
        for name, rows in (("returns", self.returns), ("lengths", self.lengths), ("seeds", self.seeds)):
            if len({len(row) for row in rows}) != 1:
                raise ValueError(f"{name}: give as many episodes in each dynamics")
        return Evaluation(
            self.robot,
            self.split,
            tuple(self.indices),
            np.array(self.returns, dtype=np.float64),
            np.array(self.lengths, dtype=np.int64),
            np.array(self.seeds, dtype=np.int64),
            self.mujoco,
            self.physics,
        )


def first_error(error: pydantic.ValidationError) -> str:
    """The first thing that is wrong, as one line: `runs.0.evaluation.seeds.1.4: Input should be ...`."""
    details = error.errors(include_url=False, include_context=False, include_input=False)
    field = ".".join(str(part) for part in details[0]["loc"])
    message = details[0]["msg"].removeprefix("Value error, ")
    line = f"{field}: {message}" if field else message
    if len(details) > 1:
        line += f" (and {len(details) - 1} more)"
    # names of unknown fields come from the file: nothing but one printable line leaves here
    return "".join(c if c.isprintable() else "?" for c in line)[:500]
