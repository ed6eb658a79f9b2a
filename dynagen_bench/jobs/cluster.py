"""Jobs on a Ray cluster, one task each.

What is here: what a node does with a job, and what the runner hears of it; the only file that knows Ray. It needs the
[cluster] extra. It must not know records, retries or what is shown.

No filesystem is shared: a node works in its own temporary folder (TMPDIR), in one folder for each folder of results,
from where outputs and log come back as bytes. That folder survives the task, so a job that died and comes to the same
node again finds what it left; one that has ended there is not run again, and its outputs stay until the runner has
recorded them: it may have died in the meantime. Nodes need
the packages that the jobs import, this one too, in the same versions. A lost node is not Ray's to mend (`max_retries`
is 0): the runner counts, and starts the job again.
"""

import json
import os
import secrets
import socket
import tempfile
import time
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from dynagen_bench.jobs.attempt import Attempt
from dynagen_bench.jobs.events import WAIT_SECONDS, Ended, Event, Progress
from dynagen_bench.jobs.job import Job
from dynagen_bench.jobs.records import JobFiles
from dynagen_bench.whole import exclusively, write_whole

QUEUED: Final = 2
"""Tasks given to Ray for each processor of the cluster: some wait, so that it sees that more nodes would help."""

CONNECT_SECONDS: Final = 10.0
"""A head node answers sooner than this, or is not there."""

FORGET_SECONDS: Final = 5.0
"""Given to the nodes in the end to delete what has been recorded; what is not deleted then stays."""

TELL_SECONDS: Final = 1.0
"""Between two progress reports of a task."""

_Message = tuple[str, str, Any]
"""What a node yields: ("node", "", its id), ("progress", "", units), ("log", "", bytes), ("output", path, bytes), and
last of all ("ended", host, (error, seconds))."""


class RayCluster:
    """Tasks of one processor each, on the nodes of a cluster."""

    kind = "ray"

    def __init__(self, address: str, processes: int | None) -> None:
        """Connect to the cluster at `address`, or start Ray on this machine if it is "local".

        Raises:
            RuntimeError: there is no cluster at this address.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else Ray prints that this will change
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
        try:
            if address == "local":
                ray.init(address="local", num_cpus=processes, include_dashboard=False, **quiet)
            else:
                _check_reachable(address)
                ray.init(address=address, **quiet)
        except (OSError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise RuntimeError(
                f"no Ray cluster at {address!r} ({reason}): give 'local', 'auto' or the HOST:PORT of its head node"
            ) from error
        self._processes = processes
        self._task = ray.remote(num_cpus=1, max_retries=0, num_returns="streaming")(work)
        self._forget = ray.remote(num_cpus=0, max_retries=0)(forget)
        self._running: dict[Any, _Task] = {}  # Ray's generator of messages → whose they are
        self._ended: dict[str, _Task] = {}  # key of a job → the task that has ended it
        self._forgetting: list[Any] = []

    @property
    def free(self) -> int:
        """How many more jobs can be given to Ray now; the cluster may grow and shrink."""
        resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
        room = self._processes or max(1, QUEUED * int(resources.get("CPU", 0)))
        return room - len(self._running)

    def start(self, job: Job, scratch: Path, log: BinaryIO) -> None:
        """Give a job to Ray, which finds a node for it."""
        owner = _identity(scratch.parent)
        self._running[self._task.remote(job, owner)] = _Task(job.key, owner, scratch, log)

    def wait(self) -> list[Event]:
        """What has happened since the last call; waits a moment if nothing has."""
        if not self._running:
            time.sleep(WAIT_SECONDS)
            return []
        waiting = list(self._running)
        ready, _ = ray.wait(waiting, num_returns=len(waiting), timeout=WAIT_SECONDS, fetch_local=False)
        events: list[Event] = []
        for messages in ready:
            event = self._running[messages].take(messages)
            events.extend([event] if event else [])
            if isinstance(event, Ended):
                self._ended[event.key] = self._running.pop(messages)
        return events

    def forget(self, job: Job) -> None:
        """Have the node that ended a job delete what it keeps of it."""
        task = self._ended.pop(job.key)
        there = NodeAffinitySchedulingStrategy(task.node, soft=False)
        self._forgetting.append(self._forget.options(scheduling_strategy=there).remote(job, task.owner))

    def close(self) -> None:
        """End all that run, and leave the cluster; Ray of this machine alone is ended with it."""
        for messages in self._running:
            ray.cancel(messages, force=True)
        self._running.clear()
        if self._forgetting:
            ray.wait(self._forgetting, num_returns=len(self._forgetting), timeout=FORGET_SECONDS, fetch_local=False)
        ray.shutdown()


def _check_reachable(address: str) -> None:
    """Raise an OSError or ValueError if nobody answers at HOST:PORT, which Ray finds out in minutes."""
    if address != "auto":
        place = urllib.parse.urlsplit(f"//{address}")
        if not place.hostname or not place.port:
            raise ValueError("this is no HOST:PORT")
        socket.create_connection((place.hostname, place.port), CONNECT_SECONDS).close()


def _identity(records: Path) -> str:
    """What tells a folder of results from any other, one that was in its place too; made once, in its `.jobs`."""
    file = records / "id"
    with exclusively(file):
        if not file.is_file():
            write_whole(file, secrets.token_hex(16))
        return file.read_text(encoding="ascii")


class _Task:
    """A task as the runner's side knows it: where what comes back is put.

    Attributes:
        owner: `_identity` of the folder of results.
        node: Ray's id of the node that runs it, when it has told it.
    """

    def __init__(self, key: str, owner: str, scratch: Path, log: BinaryIO) -> None:
        self.owner, self.node = owner, ""
        self._key, self._scratch, self._log = key, scratch, log

    def take(self, messages: Any) -> Event | None:
        """Take what is there; returns the last thing worth telling."""
        event: Event | None = None
        try:
            while not isinstance(event, Ended) and ray.wait([messages], timeout=0, fetch_local=False)[0]:
                event = self._understand(*ray.get(next(messages))) or event
        except StopIteration:
            return Ended(self._key, "the task said nothing of how it ended", lost=True)
        except (
            ray.exceptions.RayTaskError
        ) as error:  # our own code on the node: it cannot be imported, its disk is full
            self._log.write(f"{error}\n".encode())
            self._log.flush()
            return Ended(self._key, f"on the node: {error.cause!r}")
        except ray.exceptions.RayError as error:
            return Ended(self._key, f"lost by the cluster: {type(error).__name__}", lost=True)
        return event

    def _understand(self, kind: str, detail: str, content: Any) -> Event | None:
        if kind == "progress":
            return Progress(self._key, content)
        if kind == "node":
            self.node = content
        if kind == "log":
            self._log.write(content)
            self._log.flush()
        elif kind == "output":
            write_whole(self._scratch / detail, content)
        elif kind == "ended":
            error, seconds = content
            return Ended(self._key, error, seconds=seconds, host=detail)
        return None


def work(job: Job, owner: str) -> Iterator[_Message]:
    """On a node: run a job in a process of its own, and yield how it goes, what it printed and what it made.

    What it made is kept and recorded here, as in a folder of results, until `forget`.
    """
    folder = _folder(owner)
    files = JobFiles(folder, job)
    while (log := files.hold()) is None:
        time.sleep(WAIT_SECONDS)  # a process of an earlier attempt is just being ended
    with log:
        yield "node", "", ray.get_runtime_context().get_node_id()
        error, seconds = None, 0.0
        if not files.settle():  # else it has ended well, and nobody was there to take what it made
            log.truncate(0)
            files.begin()
            attempt = Attempt(job, files.scratch, log, core=None)
            told = 0
            try:
                while not attempt.wait(TELL_SECONDS):
                    attempt.read_progress()
                    if attempt.units != told:
                        told = attempt.units
                        yield "progress", "", told
            finally:
                seconds = attempt.seconds
                error = attempt.close()
            if error is None and not files.missing_outputs():
                files.finish({"seconds": seconds})
        yield "log", "", files.log.read_bytes()
        if files.done():
            seconds = json.loads(files.record.read_text(encoding="utf-8"))["seconds"]
            for output in job.outputs:
                yield "output", output, (folder / output).read_bytes()
        yield "ended", socket.gethostname(), (error, seconds)


def forget(job: Job, owner: str) -> None:
    """On a node: delete what it keeps of a job that has ended well."""
    folder = _folder(owner)
    files = JobFiles(folder, job)
    for path in (*(folder / output for output in job.outputs), files.record, files.log):
        path.unlink(missing_ok=True)


def _folder(owner: str) -> Path:
    """A node's folder of what it does for one folder of results."""
    return Path(tempfile.gettempdir()) / f"dynagen-jobs-{os.getuid()}" / owner
