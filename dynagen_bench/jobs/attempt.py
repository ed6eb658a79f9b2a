"""One process at work on one job, seen from the process that started it.

What is here: starting it, its progress, how it ended, and ending it. Called by the local executor, and on a node of a
cluster by what works there. It must not know results, records or other jobs.

The process is started anew (no fork of our memory), with one thread for every library, in a process group of its own.
Whatever kills us closes a pipe that it watches, so that none is left working for nobody.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import BinaryIO, Final

from dynagen_bench.jobs.job import Job

ENVIRONMENT: Final = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "JAX_PLATFORMS": "cpu",
    "DYNAGEN_THREADS": "1",  # of our own physics
    "PYTHONUNBUFFERED": "1",  # a killed job's last words are in its log
    "PYTHONFAULTHANDLER": "1",
}
"""Set before the job's first import: libraries read it once, when they are loaded."""

_CHILD: Final = Path(__file__).with_name("child.py")
"""Run as a file: as a module it would import this package, and the libraries that it takes, before all else."""


class Attempt:
    """A job's process.

    Attributes:
        units: of its progress, as it last reported.
    """

    def __init__(self, job: Job, scratch: Path, log: BinaryIO, core: int | None) -> None:
        """Start the process.

        Args:
            job: what it does.
            scratch: the job's folder; made if it is not there.
            log: where what it prints goes; a lock on this file is the process' too.
            core: the processor it keeps to; None leaves that to the system.
        """
        self.units = 0
        self._started = time.monotonic()
        self._partial = b""
        scratch.mkdir(parents=True, exist_ok=True)
        log.write(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {job.name}: {job.function}\n".encode())
        log.flush()
        self._progress, theirs = os.pipe()
        os.set_blocking(self._progress, False)
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(_CHILD), str(theirs)],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            pass_fds=(theirs,),
            process_group=0,
            env={
                **os.environ,
                **ENVIRONMENT,
                "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path),  # "" is where we stand
            },
        )
        os.close(theirs)
        request = {"function": job.function, "arguments": dict(job.arguments), "scratch": str(scratch), "core": core}
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is dead already; `ended` will say so
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()

    def fileno(self) -> int:
        """The pipe of the progress: readable when there is some, and when the process has ended."""
        return self._progress

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.monotonic() - self._started

    def read_progress(self) -> bool:
        """Bring `units` up to date; waits for nothing. Returns whether there can be more."""
        try:
            while some := os.read(self._progress, 1 << 16):
                *lines, self._partial = (self._partial + some).split(b"\n")
                if lines:
                    self.units = int(lines[-1])
        except BlockingIOError:
            return True
        return False

    def wait(self, seconds: float) -> bool:
        """Whether it has ended, after at most `seconds`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self._process.returncode is not None

    def close(self) -> str | None:
        """End it, and all that it started; returns how it failed, or None if it had ended well."""
        code = self._process.poll()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # of a request that was never read
            self._process.stdin.close()
        os.close(self._progress)
        if code is None:
            return "ended by its runner"
        if code < 0:
            return f"killed by signal {-code} ({signal.strsignal(-code)})"
        return f"exit code {code}" if code else None
