"""Running jobs: each once, again when it died, never when it is done.

What is here: `run_jobs`: the queue, the retries, and what is said in the end. Called by whatever has many long things
to do. It must not know what a job does, nor where it runs.
"""

import collections
import dataclasses
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Final

from dynagen_bench.ids import check_count
from dynagen_bench.jobs.events import Ended, Executor, Progress
from dynagen_bench.jobs.job import Job, check_jobs
from dynagen_bench.jobs.local import LocalProcesses
from dynagen_bench.jobs.records import JobFiles
from dynagen_bench.jobs.table import Table

FAILURES: Final = 2
"""A job that fails this often is given up."""

LOSSES: Final = 5
"""A machine that is lost says nothing of the job that ran on it, unless it happens this often."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        name: of the job.
        key: of the job.
        attempts: how often this call started it; 0 if it was done.
        sha256: output → its SHA-256, hexadecimal.
    """

    name: str
    key: str
    attempts: int
    sha256: dict[str, str]


def run_jobs(
    jobs: Sequence[Job], folder: Path, *, processes: int | None = None, ray: str | None = None
) -> list[Outcome]:
    """Run what is not done of `jobs`; their outputs appear in `folder`.

    A job that was stopped, with the call or by itself, is started again and finds its scratch folder. Several calls
    may work on one folder; each job is run by one of them.

    Args:
        jobs: they are started in this order.
        folder: of the results; in its `.jobs` are records and logs.
        processes: how many at once; None is one per processor, or on a cluster as many as it has room for.
        ray: None runs them here; "local" on Ray on this machine; else the address of a cluster, "auto" or HOST:PORT.

    Returns:
        One outcome a job, in the order of `jobs`.

    Raises:
        ValueError: two jobs have one name or make one file, or `processes` makes no sense.
        RuntimeError: some failed twice; the message names them and their logs, and all others are done. Or Ray is
            wanted, and is not installed or not there.
    """
    check_jobs(jobs)
    if processes is not None:
        processes = check_count("processes", processes)
    folder = folder.absolute()
    files = {job.key: JobFiles(folder, job) for job in jobs}
    todo = [job for job in jobs if not files[job.key].done()]
    attempts: collections.Counter[str] = collections.Counter()
    if todo:
        executor = _executor(processes, ray)
        try:
            with Table(len(jobs), len(jobs) - len(todo)) as table:
                run = _Run(todo, files, executor, table)
                run.run()
        finally:
            executor.close()
        attempts = run.attempts
        if run.errors:
            raise RuntimeError(_failure(run.errors, files, len(jobs)))
    outcomes = []
    for job in jobs:
        outputs = files[job.key].recorded_outputs() or {}
        hashes = {output: about["sha256"] for output, about in outputs.items()}
        outcomes.append(Outcome(job.name, job.key, attempts[job.key], hashes))
    return outcomes


def _executor(processes: int | None, ray: str | None) -> Executor:
    if ray is None:
        return LocalProcesses(processes)
    if importlib.util.find_spec("ray") is None:
        raise RuntimeError("running jobs on a cluster needs one more package: pip install 'dynagen-bench[cluster]'")
    from dynagen_bench.jobs.cluster import RayCluster  # here: Ray is large, and an extra

    return RayCluster(ray, processes)


class _Run:
    """The state of one call."""

    def __init__(self, todo: Sequence[Job], files: dict[str, JobFiles], executor: Executor, table: Table) -> None:
        self.attempts: collections.Counter[str] = collections.Counter()
        self.errors: list[tuple[Job, str]] = []
        self._waiting = collections.deque(todo)
        self._running: dict[str, tuple[Job, BinaryIO]] = {}
        self._losses: collections.Counter[str] = collections.Counter()
        self._files, self._executor, self._table = files, executor, table

    def run(self) -> None:
        """Until nothing is left to do."""
        try:
            while self._waiting or self._running:
                self._table.refresh(elsewhere=self._start_some())
                for event in self._executor.wait():
                    job, log = self._running[event.key]
                    if isinstance(event, Progress):
                        self._table.move(job.name, event.units)
                    else:
                        with log:
                            self._end(job, log, event)
                        del self._running[event.key]
            self._table.refresh(elsewhere=0)
        finally:
            for _, log in self._running.values():
                log.close()

    def _start_some(self) -> int:
        """Start what there is room for; returns how many were passed over because another runner has them."""
        elsewhere = 0
        for _ in range(len(self._waiting)):
            if self._executor.free < 1:
                break
            job = self._waiting.popleft()
            log = self._files[job.key].hold()
            if log is None:
                elsewhere += 1
                self._waiting.append(job)
            elif self._files[job.key].settle():  # by another runner, or by one that was killed while it moved outputs
                log.close()
                self._table.count("done")
            else:
                self._running[job.key] = (job, log)
                self._start(job, log)
        return elsewhere

    def _start(self, job: Job, log: BinaryIO) -> None:
        self._files[job.key].begin()
        self._executor.start(job, self._files[job.key].scratch, log)
        self._table.start(job.name, job.total)
        self.attempts[job.key] += 1

    def _end(self, job: Job, log: BinaryIO, ended: Ended) -> None:
        """Keep what an attempt made, or see to another one, or give up."""
        files, error = self._files[job.key], ended.error
        if error is None and (missing := files.missing_outputs()):
            error = f"it ended well and left no {', '.join(missing)}"
        if error is None:
            about = {"attempts": self.attempts[job.key], "seconds": round(ended.seconds, 1)}
            files.finish({**about, "executor": self._executor.kind, "host": ended.host})
            self._executor.forget(job)
            self._table.end(job.name, "done")
            return
        words = files.last_words()
        log.write(f"--- {error}\n".encode())
        self._losses[job.key] += ended.lost
        failures = self.attempts[job.key] - self._losses[job.key]
        if failures >= FAILURES or self._losses[job.key] >= LOSSES:
            self.errors.append((job, f"{error} ({words})" if words else error))
            self._table.end(job.name, "failed")
        else:
            self._waiting.append(job)  # last, when what it was short of may be there again
            self._table.end(job.name, "again")


def _failure(errors: Sequence[tuple[Job, str]], files: dict[str, JobFiles], count: int) -> str:
    """One line for all jobs that were given up."""
    each = "; ".join(f"{job.name}: {error}, see {files[job.key].log}" for job, error in errors)
    return f"{len(errors)} of {count} jobs failed, run the same again to repeat them: {each}"
