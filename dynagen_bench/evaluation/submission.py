"""A submission: who made an agent, how it was trained, and every episode of its evaluations, as one JSON file.

What is here: the format, version 1, as pydantic models, and writing and reading a folder that holds it. Called by the
agents' submit command, the demo and the leaderboard. It must not know agents or tables. Nothing in a submission is ever
executed or unpickled, and there is no field for a score: scores are computed from the returns.

    my-submission/
      submission.json     all there is in version 1; traces will be files beside it
"""

import json
import re
from pathlib import Path
from typing import Annotated, Final, Literal

import pydantic

from dynagen_bench.evaluation.result import STRICT, EpisodeRecord, Evaluation, first_error
from dynagen_bench.whole import whole_file

FORMAT_VERSION: Final = 1
FILE_NAME: Final = "submission.json"
MAX_BYTES: Final = 4 * 2**20
"""Largest file that is read; five robots with five runs each take under 0.2 MB."""

MAX_RUNS: Final = 100


def _one_line(text: str) -> str:
    # neither line breaks nor control characters nor marks that turn the direction of writing
    if not text.isprintable() or text != text.strip():
        raise ValueError("must be one line of printable characters without spaces at its ends")
    return text


Name = Annotated[str, pydantic.Field(min_length=1, max_length=80), pydantic.AfterValidator(_one_line)]
Text = Annotated[str, pydantic.Field(min_length=1, max_length=2000), pydantic.AfterValidator(_one_line)]
Link = Annotated[str, pydantic.Field(max_length=300, pattern=r"^https://[A-Za-z0-9._~:/?#@!$&*+,;=%-]+$")]
Commit = Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{7,64}$")]
Package = Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
Version = Annotated[str, pydantic.Field(pattern=r"^[0-9A-Za-z][0-9A-Za-z.+!_-]{0,63}$")]


def _as_record(given: object) -> object:
    return EpisodeRecord.from_evaluation(given) if isinstance(given, Evaluation) else given


class Run(pydantic.BaseModel):
    """One training of the agent with one seed, and the evaluation of its checkpoint."""

    model_config = STRICT

    robot: str
    seed: int = pydantic.Field(ge=0, lt=2**63)
    gradient_steps: int = pydantic.Field(ge=0, lt=2**63)
    """Updates of the parameters; 0 for what was not trained."""
    evaluation: Annotated[EpisodeRecord, pydantic.BeforeValidator(_as_record)]
    """An `Evaluation` is taken as it is."""

    @pydantic.model_validator(mode="after")
    def _one_robot(self) -> "Run":
        if self.robot != self.evaluation.robot:
            raise ValueError(f"robot is {self.robot!r}, but the evaluation is of {self.evaluation.robot!r}")
        return self


class Submission(pydantic.BaseModel):
    """What an entry of the leaderboard is made of."""

    model_config = STRICT

    format_version: Literal[1]
    agent: Name
    """What the table calls it."""
    authors: list[Name] = pydantic.Field(min_length=1, max_length=50)
    description: Text
    """What the agent is, in a sentence or a few."""
    paper: Link | None = None
    code: Link | None = None
    commit: Commit | None = None
    """The state of the code that made the runs."""
    track: Literal["zero-shot", "adaptation"]
    """`zero-shot` used no data of the test dynamics, `adaptation` was fine-tuned on the fixed small set of each."""
    checkpoint: Literal["last", "best"]
    """`last` is official; `best` was chosen by its score in the test dynamics, as the paper did."""
    privileged: Literal["none", "own-history", "offline-context"]
    """What it knew beyond what a policy sees: nothing, a context made of the episode so far, or test dynamics' data."""
    hardware: Name
    hours: float = pydantic.Field(ge=0, le=1e6)
    """Wall-clock hours of training, all runs together."""
    versions: dict[Package, Version] = pydantic.Field(max_length=64)
    """Package name → version."""
    runs: list[Run] = pydantic.Field(min_length=1, max_length=MAX_RUNS)
    traces: None = None
    """The name of a file of traces; none in version 1."""

    @pydantic.model_validator(mode="after")
    def _distinct_runs(self) -> "Submission":
        seen: dict[tuple[str, int], int] = {}
        for number, run in enumerate(self.runs):
            first = seen.setdefault((run.robot, run.seed), number)
            if first != number:
                raise ValueError(
                    f"runs {first} and {number} are both {run.robot} with seed {run.seed}: give each run once"
                )
        return self


def submission_text(submission: Submission) -> str:
    """The text of the file: the same bytes for the same submission, a dynamics' episodes on one line for review."""
    text = json.dumps(submission.model_dump(mode="json"), indent=1, ensure_ascii=False)
    # only lists of numbers are pulled together: a line break inside a string is written as \\n and cannot match
    text = re.sub(r"\[\n([-+.\deE,\s]+)\]", lambda match: "[" + " ".join(match[1].split()) + "]", text)
    return text + "\n"


def write_submission(folder: Path, submission: Submission) -> Path:
    """Write `submission.json` into `folder`, whole or not at all, and return its path.

    Raises:
        ValueError: the text would be larger than what is read again.
    """
    content = submission_text(submission).encode("utf-8")
    if len(content) > MAX_BYTES:
        raise ValueError(f"the submission takes {len(content)} bytes, at most {MAX_BYTES} are read: give fewer runs")
    path = folder / FILE_NAME
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
    return path


def read_submission(folder: Path) -> Submission:
    """Read and check the submission in `folder`; nothing but its `submission.json` is opened.

    Raises:
        FileNotFoundError: there is no such file; a link is none.
        ValueError: one line that names the file and, where one is wrong, the field.
    """
    path = folder / FILE_NAME
    if path.is_symlink() or not path.is_file():
        raise FileNotFoundError(f"{path} is no file: give the folder that holds {FILE_NAME}")
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise ValueError(f"{path}: larger than {MAX_BYTES} bytes, the most that is read")
    try:
        return Submission.model_validate_json(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 ({error.reason} at byte {error.start})") from error
    except pydantic.ValidationError as error:
        raise ValueError(f"{path}: {first_error(error)}") from error
