"""What is on disk of a job: its log, its scratch folder, its record, and its outputs.

What is here: who may work on a job, whether it is done, and how its outputs get from the scratch folder to their
places. Called by the runner, and on a node of a cluster by what works there. It must not know how jobs run.

In the folder of the results, KEY being `Job.key`:

    .jobs/KEY.log   what its attempts printed, one after another. Whoever works on the job holds this file (flock), the
                    job's own process too, as its stdout: the kernel lets go when the last of them is dead
    .jobs/KEY/      the scratch folder; gone when the job is done
    .jobs/KEY.json  the record, written when the outputs are complete in the scratch folder and before they are moved

A record beside a scratch folder thus is a job of which all is there and some is not moved: moving it is all that is
left to do. A record alone, with outputs of the recorded sizes, is a job done.
"""

import fcntl
import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any, BinaryIO, Final

from dynagen_bench.jobs.job import RECORDS, Job
from dynagen_bench.whole import write_whole

_TAIL: Final = 4096
"""Bytes of a log in which its last line is looked for."""


class JobFiles:
    """One job's files in one folder of results. All but `done` and `recorded_outputs` need `hold`."""

    def __init__(self, folder: Path, job: Job) -> None:
        self.scratch = folder / RECORDS / job.key
        self.log = folder / RECORDS / f"{job.key}.log"
        self.record = folder / RECORDS / f"{job.key}.json"
        self._folder = folder
        self._job = job

    def hold(self) -> BinaryIO | None:
        """The log, open to append to, if nobody else works on this job; closing it lets go."""
        self.log.parent.mkdir(parents=True, exist_ok=True)
        file = self.log.open("ab")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        return file

    def done(self) -> bool:
        """Whether the record and all outputs are there, with the recorded sizes; reads no output."""
        outputs = self.recorded_outputs()
        return outputs is not None and not self.scratch.exists() and self._in_place(outputs)

    def recorded_outputs(self) -> dict[str, dict[str, Any]] | None:
        """Output → its `bytes` and `sha256`, or None where there is no record of all outputs that can be read."""
        try:
            outputs = json.loads(self.record.read_text(encoding="utf-8"))["outputs"]
            return {
                output: {"bytes": int(outputs[output]["bytes"]), "sha256": str(outputs[output]["sha256"])}
                for output in self._job.outputs
            }
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None

    def settle(self) -> bool:
        """Move what is recorded and not moved yet; returns whether the job is done."""
        outputs = self.recorded_outputs()
        if outputs is None:
            return False
        for output, about in outputs.items():
            made, place = self.scratch / output, self._folder / output
            if _size(made) == about["bytes"]:
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(made, place)
        if not self._in_place(outputs):
            return False
        shutil.rmtree(self.scratch, ignore_errors=True)
        return True

    def begin(self) -> None:
        """Before an attempt: no record, and a scratch folder with what earlier attempts left."""
        self.record.unlink(missing_ok=True)
        self.scratch.mkdir(parents=True, exist_ok=True)

    def missing_outputs(self) -> list[str]:
        """The outputs that are not in the scratch folder."""
        return [output for output in self._job.outputs if _size(self.scratch / output) is None]

    def last_words(self) -> str:
        """The last line that the latest attempt printed, of an exception its name and message; "" if there is none."""
        with self.log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
            lines = file.read().decode(errors="replace").rstrip().splitlines()
        return lines[-1] if lines and not lines[-1].startswith("---") else ""

    def finish(self, about: dict[str, Any]) -> None:
        """After an attempt that left all outputs: write the record, with `about` in it, and move them."""
        outputs = {
            output: {"bytes": _size(self.scratch / output), "sha256": _sha256(self.scratch / output)}
            for output in self._job.outputs
        }
        what = {"name": self._job.name, "function": self._job.function, "arguments": dict(self._job.arguments)}
        write_whole(self.record, json.dumps({**what, **about, "outputs": outputs}, indent=1) + "\n")
        self.settle()

    def _in_place(self, outputs: dict[str, dict[str, Any]]) -> bool:
        return all(_size(self._folder / output) == about["bytes"] for output, about in outputs.items())


def changed_outputs(job: Job, folder: Path) -> list[str]:
    """Read a job's outputs again: those that are missing or have not the SHA-256 of the record.

    Raises:
        FileNotFoundError: the folder has no record of this job.
    """
    files = JobFiles(folder, job)
    outputs = files.recorded_outputs()
    if outputs is None:
        raise FileNotFoundError(f"{folder} has no record of job {job.name!r}: run it first")
    return [
        output
        for output, about in outputs.items()
        if _size(folder / output) is None or _sha256(folder / output) != about["sha256"]
    ]


def _size(path: Path) -> int | None:
    return path.stat().st_size if path.is_file() else None


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
