"""A submission: who made an agent, how it was trained, and every episode of its evaluations.

What is here: the format as pydantic models, and writing and reading a folder that holds it. Called by the agents'
submit command, the demo and the leaderboard. It must not know agents or tables. Nothing in a submission is ever
executed, decompressed or unpickled, no path is ever taken from it, and there is no field for a score: scores are
computed from what a replay returns.

    my-submission/
      submission.json                      who, how, and every episode's return and length
      traces/Hopper-seed0.safetensors      what the episodes of a run did, see `traces`

Version 1 had no traces, commands and curves. It is read still.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import pydantic
from pydantic.json_schema import SkipJsonSchema

from dynagen_bench.evaluation.result import MAX_RETURN, STRICT, EpisodeRecord, Evaluation, first_error
from dynagen_bench.evaluation.sealed import read_inside
from dynagen_bench.evaluation.traces import Traces, file_size, parse_traces, save_traces
from dynagen_bench.whole import write_whole

FORMAT_VERSION: Final = 2
FILE_NAME: Final = "submission.json"
MAX_BYTES: Final = 4 * 2**20
"""Largest `submission.json` that is read; five robots with five runs each take under 0.2 MB."""

MAX_RUNS: Final = 100
MAX_POINTS: Final = 1000
"""Of runs, and of points in a learning curve: so many fit into `MAX_BYTES`."""


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


Sha256 = Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{64}$")]
Steps = Annotated[int, pydantic.Field(ge=0, lt=2**63)]


def _as_record(given: object) -> object:
    return EpisodeRecord.from_evaluation(given) if isinstance(given, Evaluation) else given


class CurvePoint(pydantic.BaseModel):
    """A point of a learning curve; nobody can replay it."""

    model_config = STRICT

    gradient_steps: Steps
    mean_return: float = pydantic.Field(ge=-MAX_RETURN, le=MAX_RETURN)
    """Over all episodes of an evaluation in the test dynamics."""


class Run(pydantic.BaseModel):
    """One training of the agent with one seed, and the evaluation of its checkpoint."""

    model_config = STRICT

    robot: str
    seed: int = pydantic.Field(ge=0, lt=2**63)
    gradient_steps: Steps
    """Updates of the parameters; 0 for what was not trained."""
    # an `Evaluation` is taken, too; `Run.from_evaluation` also takes the hash of its traces
    evaluation: Annotated[EpisodeRecord, pydantic.BeforeValidator(_as_record)]
    """Every episode's return, length and reset seed."""
    trace: Sha256 | None = None
    """SHA-256 of the run's trace file; null if there is none, and the run stays self-reported."""
    curve: list[CurvePoint] = pydantic.Field(default=[], max_length=MAX_POINTS)
    """The learning curve, if given."""
    commit: Commit | None = None
    """The state of the code that made this run, where it is not that of all runs."""

    @property
    def trace_name(self) -> str:
        """Where the trace file lies in the submission's folder; the format fixes it, no submission says it."""
        return f"traces/{self.robot}-seed{self.seed}.safetensors"

    @classmethod
    def from_evaluation(
        cls,
        evaluation: Evaluation,
        *,
        seed: int,
        gradient_steps: int,
        curve: Sequence[CurvePoint] = (),
        commit: str | None = None,
    ) -> "Run":
        """The run whose checkpoint was evaluated; its traces are to be given to `write_submission`, too."""
        return cls(
            robot=evaluation.robot,
            seed=seed,
            gradient_steps=gradient_steps,
            evaluation=EpisodeRecord.from_evaluation(evaluation),
            trace=None if evaluation.traces is None else evaluation.traces.sha256,
            curve=list(curve),
            commit=commit,
        )

    @pydantic.model_validator(mode="after")
    def _one_robot(self) -> "Run":
        if self.robot != self.evaluation.robot:
            raise ValueError(f"robot is {self.robot!r}, but the evaluation is of {self.evaluation.robot!r}")
        return self


class Submission(pydantic.BaseModel):
    """What an entry of the leaderboard is made of."""

    model_config = STRICT

    format_version: Literal[1, 2]
    agent: Name
    """What the table calls it."""
    authors: list[Name] = pydantic.Field(min_length=1, max_length=50)
    description: Text
    """What the agent is, in a sentence or a few."""
    paper: Link | None = None
    code: Link | None = None
    commit: Commit | None = None
    """The state of the code that made the runs, those that do not tell one of their own."""
    track: Literal["zero-shot", "adaptation"]
    """`zero-shot` used no data of the test dynamics, `adaptation` was fine-tuned on the fixed small set of each."""
    checkpoint: Literal["last", "best"]
    """`last` is official; `best` was chosen by its score in the test dynamics, as the paper did."""
    privileged: Literal["none", "own-history", "offline-context", "test-dynamics"]
    """What it knew beyond the last observation: nothing, a context made of the episode so far, data of the test
    dynamics, or the test dynamics themselves (a reference to compare with, and no competitor)."""
    hardware: Name
    hours: float = pydantic.Field(ge=0, le=1e6)
    """Wall-clock hours of training, all runs together."""
    versions: dict[Package, Version] = pydantic.Field(max_length=64)
    """Package name → version."""
    commands: list[Text] = pydantic.Field(default=[], max_length=2 * MAX_RUNS)
    """The command lines that made the runs, if there are such: one to train each, and one to adapt it."""
    runs: list[Run] = pydantic.Field(min_length=1, max_length=MAX_RUNS)
    traces: SkipJsonSchema[None] = pydantic.Field(default=None, exclude=True)
    """Version 1 wrote it, always null."""

    @property
    def commits(self) -> list[str]:
        """The states of the code that made the runs, as far as they are told; in the order of the runs."""
        return list(dict.fromkeys(commit for run in self.runs if (commit := run.commit or self.commit)))

    @property
    def untold(self) -> int:
        """Number of runs of which no state of the code is told."""
        return sum(not (run.commit or self.commit) for run in self.runs)

    @pydantic.model_validator(mode="after")
    def _version_has_the_fields(self) -> "Submission":
        if self.format_version == 1 and (
            self.commands or any(run.trace or run.curve or run.commit for run in self.runs)
        ):
            raise ValueError("format_version: 1 has no commands, traces, curves and commits of runs, write 2")
        return self

    @pydantic.model_validator(mode="after")
    def _distinct_runs(self) -> "Submission":
        seen: dict[tuple[str, int], int] = {}
        traces: dict[str | None, int] = {}
        for number, run in enumerate(self.runs):
            first = seen.setdefault((run.robot, run.seed), number)
            if first != number:
                raise ValueError(
                    f"runs {first} and {number} are both {run.robot} with seed {run.seed}: give each run once"
                )
            same = traces.setdefault(run.trace, number)
            if run.trace is not None and same != number:
                raise ValueError(
                    f"runs {same} and {number} have the same trace, they are one run: give it once, "
                    "runs of other seeds do something else"
                )
        return self

    @pydantic.model_validator(mode="after")
    def _zero_shot_has_no_data(self) -> "Submission":
        if self.track == "zero-shot" and self.privileged == "offline-context":
            raise ValueError(
                "track: 'zero-shot' takes no data of the test dynamics, and privileged is 'offline-context': "
                "write the track 'adaptation'"
            )
        return self


def submission_text(submission: Submission) -> str:
    """The text of the file: the same bytes for the same submission, a dynamics' episodes on one line for review."""
    text = json.dumps(submission.model_dump(mode="json", exclude_defaults=True), indent=1, ensure_ascii=False)
    # only lists of numbers are pulled together: a line break inside a string is written as \n and cannot match
    text = re.sub(r"\[\n([-+.\deE,\s]+)\]", lambda match: "[" + " ".join(match[1].split()) + "]", text)
    return text + "\n"


def submission_content(submission: Submission) -> bytes:
    """The bytes of the file; raises ValueError if they are more than what is read again."""
    content = submission_text(submission).encode("utf-8")
    if len(content) > MAX_BYTES:
        raise ValueError(f"the submission takes {len(content)} bytes, at most {MAX_BYTES} are read: give fewer runs")
    return content


def schema_text() -> str:
    """The JSON Schema of `submission.json`, as text; the limits that only code can state are in the documentation."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"} | Submission.model_json_schema()
    return json.dumps(schema, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def write_submission(folder: Path, submission: Submission, traces: Iterable[Traces | None] = ()) -> Path:
    """Write a submission into `folder` and return the path of its `submission.json`, which is written last.

    Each file is written whole or not at all. The runs name their traces by hash: a reader notices if a file is missing
    or another one.

    Args:
        folder: made if it is not there; what else it holds stays.
        submission: what to write.
        traces: those of the runs, in any order; of all runs that have some. None, of an evaluation that recorded none,
            is passed over: such a run stays self-reported.

    Raises:
        ValueError: the text would be larger than what is read again, or a run's traces are not given.
    """
    content = submission_content(submission)
    given = {one.sha256: one for one in traces if one is not None}
    for number, run in enumerate(submission.runs):
        if run.trace is not None and run.trace not in given:
            raise ValueError(f"runs.{number}.trace: these traces are not given: pass its evaluation's `traces`")
    for run in submission.runs:
        if run.trace is not None:
            save_traces(folder / run.trace_name, given[run.trace])
    path = folder / FILE_NAME
    write_whole(path, content)
    return path


def read_submission(folder: Path) -> Submission:
    """Read and check `submission.json` in `folder`; nothing else is opened.

    Raises:
        FileNotFoundError: there is no such file; a link is none.
        ValueError: one line that names the file and, where one is wrong, the field.
    """
    path = folder / FILE_NAME
    try:
        content = read_inside(folder, FILE_NAME, MAX_BYTES)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} is no file: give the folder that holds {FILE_NAME}") from None
    return parse_submission(content, path)


def parse_submission(content: bytes, path: Path) -> Submission:
    """Check the bytes of a `submission.json`; raises ValueError, one line with `path` and the field that is wrong."""
    try:
        return Submission.model_validate_json(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 ({error.reason} at byte {error.start})") from error
    except pydantic.ValidationError as error:
        raise ValueError(f"{path}: {first_error(error)}") from error


def trace_content(folder: Path, run: Run) -> bytes:
    """The bytes of a run's trace file, which are those that the run names by hash.

    Raises:
        FileNotFoundError: there is no such file; a link is none.
        ValueError: the run has no traces, or the file is another one or too large; one line that names it.
    """
    path = folder / run.trace_name
    if run.trace is None:
        raise ValueError(f"{path}: the run has no field `trace`")
    content = read_inside(folder, run.trace_name, file_size(run.robot, _lengths(run)))
    found = hashlib.sha256(content).hexdigest()
    if found != run.trace:
        raise ValueError(f"{path}: its SHA-256 is {found[:16]}..., {FILE_NAME} says trace {run.trace[:16]}...")
    return content


def read_traces(folder: Path, run: Run) -> Traces:
    """Read and check the trace file of a run of the submission in `folder`.

    Raises:
        FileNotFoundError, ValueError: as `trace_content` does, and for content that is not the trace of such a run.
    """
    content = trace_content(folder, run)
    try:
        return parse_traces(content, run.robot, _lengths(run))
    except ValueError as error:
        raise ValueError(f"{folder / run.trace_name}: {error}") from error


def _lengths(run: Run) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return run.evaluation.evaluation().lengths.reshape(-1)
