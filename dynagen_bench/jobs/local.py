"""Jobs on this machine's processors, one process each.

What is here: which processor is free, and what the processes have to say. Called by the runner. It must not know
records, retries or what is shown.
"""

import os
import selectors
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Final

from dynagen_bench.jobs.attempt import Attempt
from dynagen_bench.jobs.events import WAIT_SECONDS, Ended, Event, Progress
from dynagen_bench.jobs.job import Job

_EXIT_SECONDS: Final = 0.1
"""Between the end of its progress and its own, a process has little left to do."""


class LocalProcesses:
    """As many processes at once as there are processors that this process may use, or as it is told."""

    kind = "local"

    def __init__(self, processes: int | None) -> None:
        cores: Sequence[int | None]
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
        count = len(cores) if processes is None else processes
        # who takes some of the processors alone leaves the choice to the system: two such runners take the same ones
        own = cores if count >= len(cores) else [None]
        self._free_cores = [own[i % len(own)] for i in range(count)]
        self._selector = selectors.DefaultSelector()
        self._running: dict[str, tuple[Attempt, int | None]] = {}

    @property
    def free(self) -> int:
        """How many more jobs can be started now."""
        return len(self._free_cores)

    def start(self, job: Job, scratch: Path, log: BinaryIO) -> None:
        """Start a job."""
        core = self._free_cores.pop(0)
        attempt = Attempt(job, scratch, log, core)
        self._running[job.key] = (attempt, core)
        self._selector.register(attempt, selectors.EVENT_READ)

    def wait(self) -> list[Event]:
        """What has happened since the last call; waits a moment if nothing has."""
        self._selector.select(WAIT_SECONDS)
        events: list[Event] = []
        for key, (attempt, core) in list(self._running.items()):
            more = attempt.read_progress()
            events.append(Progress(key, attempt.units))
            if attempt.wait(0 if more else _EXIT_SECONDS):
                self._selector.unregister(attempt)
                del self._running[key]
                self._free_cores.append(core)
                seconds = attempt.seconds
                events.append(Ended(key, attempt.close(), seconds=seconds, host=socket.gethostname()))
        return events

    def forget(self, job: Job) -> None:
        """Nothing is kept elsewhere."""

    def close(self) -> None:
        """End all that run."""
        for attempt, _ in self._running.values():
            attempt.close()
        self._running.clear()
        self._selector.close()
