"""A run's folder: what training leaves behind, and how it knows a run again.

What is here: the folder's files, `RunSettings`, and the curves. Called by whatever makes, continues or reads a run. It
must not know any agent.

    runs/dadt-Hopper-seed0/
      config.json             resolved config and settings, data, package versions, git commit: of the last command that
                              took a step, not of one that found the run complete; a commit that was untold stays so
      curves.csv              a line every `log_every` steps; TensorBoard's events beside it in tensorboard/
      last.safetensors        the last checkpoint, from which a killed run continues
      evaluation.json         the official result: the last checkpoint's in the test dynamics; `stopped_early` in it
                              tells a run that `patience` ended before its last step; its episodes' traces in
      evaluation.safetensors  which a submission shows
      best.safetensors        the checkpoint that did best in the test dynamics during training, and its result in
      evaluation-best.json    the paper's way of reporting, never mixed with the official one; its traces beside it in
                              evaluation-best.safetensors
      adaptation.json         the result of fine-tuning the last checkpoint for each test dynamics (`adapt`), its traces
      adaptation.safetensors  beside it; adaptation/ holds the dynamics that are done, until all are
      adaptation-curve.csv    returns by steps of fine-tuning, in train dynamics that the run held out (`adapt --curve`)
                              adaptation-curve/, too, holds the dynamics that are done, until all are
      target-curve.csv        returns by what is asked for, in train dynamics that the run held out (`agents.targets`);
                              target-curve/ holds the targets that are done, until all are
      prediction.json         the last checkpoint's next-state errors in the data of the test dynamics: what a predictor
                              has in place of evaluations, and `predict` adds for agents that can
      evaluation-train.json   returns in train dynamics, beside the untrained agent's and those of random actions
                              (`agents.evaluate`)
"""

import contextlib
import csv
import dataclasses
import fcntl
import json
import subprocess
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from torch.utils.tensorboard.writer import SummaryWriter

from agents import TRAINABLE
from agents.config import TrainingConfig
from dynagen_bench import ids
from dynagen_bench.datasets.subsets import check_quality
from dynagen_bench.whole import whole_file, write_whole

_LENGTH: Final = ("steps", "patience")
"""What may end a run earlier or later: it may continue with others."""

DATA: Final = ("every", "quality", "hold_out")
"""Settings that choose what is trained on: a mean over runs that differ in one means nothing."""

_RECORD_ONLY: Final = ("runs", "name", "evaluate_every", "checkpoint_every", "log_every", "threads")
"""Settings that a run may continue with others of; another number of threads moves the last bits of its parameters."""

PREDICTION: Final = "prediction.json"
"""Of a run folder: errors of next states in the test dynamics."""

TENSORBOARD: Final = "tensorboard"
"""Of a run folder: a folder of TensorBoard's events, where the run was trained."""

LEARNED: Final = "evaluation-train.json"
"""Of a run folder: mean returns in train dynamics (`agents.evaluate`)."""

ADAPTATION_CURVE: Final = "adaptation-curve.csv"
"""Of a run folder: returns by steps of fine-tuning, in held-out train dynamics (`agents.adapt --curve`)."""

TARGET_CURVE: Final = "target-curve.csv"
"""Of a run folder: returns by the return that is asked for, in held-out train dynamics (`agents.targets`)."""


@dataclasses.dataclass(frozen=True)
class RunSettings:
    """What is trained on and recorded, whatever the agent.

    Raises:
        ValueError: an unknown robot, or numbers that do not fit together.
    """

    robot: str
    """Walker, Hopper, HalfCheetah, SlimHumanoid or Ant."""
    seed: int = 0
    """Of everything random in the run; below 2**63."""
    every: int = 1
    """Train on every n-th snapshot's data alone (made by `dynagen data build ROBOT --every n`)."""
    quality: float = 1.0
    """Train on this share of the episodes, those of the lowest returns; 0.3 is the paper's low-quality data."""
    hold_out: int = 0
    """Leave the last n train dynamics out, and measure `validation_loss` and `validation_return` in them."""
    patience: int = 0
    """Stop after so many evaluations without a better `validation_return`; 0 never does."""
    evaluate_every: int = 10_000
    """Steps between evaluations in the test dynamics, for the record only; 0 evaluates at the end alone."""
    checkpoint_every: int = 1_000
    """Steps between checkpoints, a multiple of `log_every`."""
    log_every: int = 100
    """Steps in a line of the curves, which holds their means."""
    runs: Path = Path("runs")
    """Where run folders are made."""
    name: str | None = None
    """Name of the run folder; if left out AGENT-ROBOT-seedSEED, and -everyN, -qualityQ, -holdoutN where these are
    set."""
    threads: int = 0
    """Processor threads for torch; 0 leaves it to torch."""

    def __post_init__(self) -> None:
        ids.check_robot(self.robot)
        limits = {"seed": 0, "every": 1, "evaluate_every": 0, "checkpoint_every": 1, "log_every": 1, "threads": 0}
        for field, least in (limits | {"hold_out": 0, "patience": 0}).items():
            ids.check_count(field, getattr(self, field), least)
        if self.seed >= 2**63:
            raise ValueError(f"seed is {self.seed}: give a whole number below 2**63")
        if self.checkpoint_every % self.log_every:
            raise ValueError(f"checkpoint_every {self.checkpoint_every} is no multiple of log_every {self.log_every}")
        check_quality(self.quality)
        if self.hold_out >= ids.SPLIT_SIZES["train"]:
            most = ids.SPLIT_SIZES["train"] - 1
            raise ValueError(f"hold_out is {self.hold_out}: give at most {most} dynamics, so that some are trained on")
        if self.patience and not (self.hold_out and self.evaluate_every):
            raise ValueError(
                f"patience is {self.patience}, hold_out {self.hold_out} and evaluate_every {self.evaluate_every}: give "
                "--hold-out and --evaluate-every too, training stops by returns in held-out dynamics"
            )

    def folder(self, agent: str) -> Path:
        """The run folder of an agent trained with these settings."""
        part = "" if self.every == 1 else f"-every{self.every}"
        part += "" if self.quality == 1 else f"-quality{self.quality:g}"
        part += "" if self.hold_out == 0 else f"-holdout{self.hold_out}"
        return self.runs / (self.name or f"{agent}-{self.robot}-seed{self.seed}{part}")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    write_whole(path, json.dumps(content, indent=1) + "\n")


def made_of(path: Path, facts: Mapping[str, Any]) -> bool:
    """Whether there is a JSON file of a result at `path`, and it was made of these facts."""
    return path.is_file() and facts.items() <= read_json(path).items()


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; raises ValueError with one line where it is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON ({error}): delete the run folder and train again") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no JSON object: delete the run folder and train again")
    return content


def read_config(folder: Path) -> dict[str, Any]:
    """A run's config.json; what it does not tell, being older than a setting or a field of its config, has its default.

    Raises:
        ValueError: one line, it is not what training writes.
    """
    path = folder / "config.json"
    about = read_json(path)
    parts = (about.get("agent"), about.get("config"), about.get("settings"))
    if not all(isinstance(part, kind) for part, kind in zip(parts, (str, dict, dict), strict=True)):
        raise ValueError(f"{path} tells no agent, config and settings: delete the run folder and train again")
    if not isinstance(about["settings"].get("robot"), str) or not isinstance(about["settings"].get("seed"), int):
        raise ValueError(f"{path} tells no robot and seed: delete the run folder and train again")
    fields = (field for field in dataclasses.fields(RunSettings) if field.name not in ("robot", "runs"))
    robot = about["settings"]["robot"]
    about["settings"] = {field.name: field.default for field in fields} | about["settings"]
    about["config"] = usual_config(about["agent"], robot, about["config"].get("steps")) | about["config"]
    return about


def usual_config(agent: str, robot: str, steps: int | None = None) -> dict[str, Any]:
    """The config of a run of so many steps, or of as many as is usual, if nothing else is told.

    Fields that follow the steps are filled in. Of an unknown agent it is what all have.

    Raises:
        ValueError: no agent trains for so many steps.
    """
    kind = TRAINABLE[agent][0] if agent in TRAINABLE else TrainingConfig
    usual = kind() if steps is None else kind(steps=steps)
    return dataclasses.asdict(usual.for_robot(robot) if robot in ids.ROBOTS else usual)


@contextlib.contextmanager
def claimed(folder: Path, description: Mapping[str, Any]) -> Iterator[dict[str, Any] | None]:
    """Be the only process in a run folder, which is new or of the same run; gives what its config.json says, if any.

    Nothing is written: a command that is refused later, or has nothing to do, leaves the run as it is.

    Args:
        folder: made if it is not there.
        description: with `agent`, `config`, `settings` and `data`, which tell whether it is the same run. More
            steps, and other intervals, are the same run continued.

    Raises:
        ValueError: another run has the folder, or another process is training it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        there = read_config(folder) if (folder / "config.json").is_file() else None
        if there is not None:
            check_same_run(folder, identity(there), identity(description), instead="--name")
        yield there


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Be the only process that writes in a run folder; raises ValueError if another one does."""
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"another process works in {folder}: wait for it, or use another run folder") from None
        yield


def read_finished(folder: Path, agents: Collection[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """config.json and evaluation.json of a run that training has ended, at its last step or early.

    Args:
        folder: of the run.
        agents: names of those that act; others have no evaluation.

    Raises:
        FileNotFoundError: the folder is no run, or training has not ended it.
        ValueError: it is of no agent, or was continued and has not come to its last step.
    """
    if not (folder / "config.json").is_file():
        if not folder.is_dir():
            raise FileNotFoundError(f"{folder} is no folder: name run folders, as runs/*/")
        if any(folder.glob("*/config.json")):
            raise FileNotFoundError(f"{folder} is no run, but holds some: name these, as {folder}/*/")
    for file in ("config.json", "last.safetensors", "evaluation.json", "evaluation-best.json"):
        if not (folder / file).is_file():
            raise FileNotFoundError(f"{folder} is no finished run, it has no {file}: train it to the end first")
        if file == "config.json" and (agent := read_config(folder)["agent"]) not in agents:
            raise ValueError(f"{folder} is of {agent!r}, which does not act: give a run of {', '.join(agents)}")
    config, record = read_config(folder), read_json(folder / "evaluation.json")
    found, wanted = record["gradient_steps"], config["config"]["steps"]
    if not ends_run(record, wanted):
        raise ValueError(f"{folder} was evaluated at step {found} of {wanted}: train it to the end first")
    return config, record


def ends_run(record: Mapping[str, Any], steps: int) -> bool:
    """Whether a result is of the end of a run of so many steps: of the last one, or of where `patience` ended it."""
    return record.get("gradient_steps") == steps or bool(record.get("stopped_early"))


def same_length(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two descriptions of a run say alike when it ends."""
    first, second = facts_of(one), facts_of(other)
    return all(first[key] == second[key] for key in _LENGTH)


def check_same_run(folder: Path, there: Mapping[str, Any], here: Mapping[str, Any], instead: str) -> None:
    """Raise ValueError if facts of a folder's run differ from those wanted; `instead` is the option for another one."""
    for key in sorted(there.keys() | here.keys()):
        if there.get(key) != here.get(key):
            raise ValueError(
                f"{folder} is of another run, {key} is {there.get(key)!r} there and {here.get(key)!r} here: "
                f"give another {instead}, or delete the folder"
            )


def identity(description: Mapping[str, Any]) -> dict[str, Any]:
    """What tells runs apart; the number of steps is a part of it where the learning rate falls towards the last."""
    facts = facts_of(json.loads(json.dumps(description)))
    length = {"patience"} if facts.get("decay_steps") else set(_LENGTH)
    return {key: value for key, value in facts.items() if key not in {*_RECORD_ONLY, *length}}


def facts_of(description: Mapping[str, Any]) -> dict[str, Any]:
    """All that a description tells of what is trained, its agent, config, settings and data, flat."""
    parts = {"agent": description["agent"]}
    for group in ("config", "settings", "data"):
        parts |= description.get(group, {})
    return parts


def git_commit() -> str | None:
    """The checkout's commit, with `-dirty` where files have been changed since; None outside of a repository."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    folder = Path(__file__).parent
    with contextlib.suppress(OSError, subprocess.CalledProcessError):
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    return None


def is_committed(commit: str | None) -> bool:
    """Whether what `git_commit` gave is a state of the code that anybody can check out."""
    return commit is not None and not commit.endswith("-dirty")


def commit_of_all(commits: Sequence[str | None]) -> str | None:
    """What to tell of a result that was made in parts: the last commit, or the first that nobody can check out."""
    return next((commit for commit in commits if not is_committed(commit)), commits[-1])


class Curves:
    """The learning curves: kept here, written to curves.csv as a whole with each checkpoint, and to TensorBoard.

    A continued run drops the lines after its checkpoint: their steps are done again, with the same result.
    """

    def __init__(self, folder: Path, step: int) -> None:
        """The curves of a run that stands at `step`."""
        self._path = folder / "curves.csv"
        self._rows: list[dict[str, str]] = []
        if self._path.is_file():
            with self._path.open(newline="", encoding="utf-8") as file:
                self._rows = [row for row in csv.DictReader(file) if int(row["step"]) <= step]
        self._board = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add numbers to the line of a step."""
        if not self._rows or self._rows[-1]["step"] != str(step):
            self._rows.append({"step": str(step)})
        for name, value in values.items():
            self._rows[-1][name] = f"{value:.7g}"
            self._board.add_scalar(name, value, step)

    def points(self, name: str) -> list[tuple[int, float]]:
        """The points (step, value) of one curve so far, as they are in the file: a continued run knows no others."""
        return _points(self._rows, name)

    def save(self) -> None:
        """Write what there is, whole or not at all."""
        columns = list(dict.fromkeys(name for row in self._rows for name in row))
        with whole_file(self._path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
            writer.writeheader()
            writer.writerows(self._rows)
        self._board.flush()

    def close(self) -> None:
        """Close TensorBoard's file."""
        self._board.close()


def read_curve(folder: Path, name: str) -> list[tuple[int, float]]:
    """The points (step, value) of one curve of a run; none if it has no such curve."""
    path = folder / "curves.csv"
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return _points(csv.DictReader(file), name)


def _points(rows: Iterable[Mapping[str, str]], name: str) -> list[tuple[int, float]]:
    return [(int(row["step"]), float(row[name])) for row in rows if row.get(name)]
