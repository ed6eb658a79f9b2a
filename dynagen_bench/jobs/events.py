"""What an executor tells the runner, and what the runner asks of one.

What is here: two records and a protocol. Called by the runner and the executors. It must not know either.
"""

import dataclasses
from pathlib import Path
from typing import BinaryIO, Final, Protocol

from dynagen_bench.jobs.job import Job

WAIT_SECONDS: Final = 0.5
"""The longest that an executor waits for something to happen: what is shown is refreshed at least as often."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """A job has done `units` of its total."""

    key: str
    units: int


@dataclasses.dataclass(frozen=True)
class Ended:
    """An attempt has ended.

    Attributes:
        key: of the job.
        error: how it failed; None if the function returned.
        lost: it was not the job that failed but the machine it ran on.
        seconds: how long it took.
        host: the machine's name.
    """

    key: str
    error: str | None
    lost: bool = False
    seconds: float = 0.0
    host: str = ""


Event = Progress | Ended


class Executor(Protocol):
    """Where jobs run: `LocalProcesses` or `RayCluster`."""

    kind: str

    @property
    def free(self) -> int:
        """How many more jobs can be started now."""

    def start(self, job: Job, scratch: Path, log: BinaryIO) -> None:
        """Start a job: its outputs will be in `scratch`, what it prints in `log`, which stays open until it ended."""

    def wait(self) -> list[Event]:
        """What has happened since the last call; waits a moment if nothing has."""

    def forget(self, job: Job) -> None:
        """What a job has made is recorded: nothing need be kept of it elsewhere."""

    def close(self) -> None:
        """End all that run."""
