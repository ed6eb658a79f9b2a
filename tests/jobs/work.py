"""What the jobs of these tests do, in processes of their own."""

import hashlib
import json
import os
import signal
import sys
import time
from pathlib import Path

from dynagen_bench.dynamics import Dynamics
from dynagen_bench.envs import BatchPhysics


def note(journal, *words):
    """Append a line to a file that outlives all processes."""
    with Path(journal).open("a") as file:
        file.write(" ".join(map(str, words)) + "\n")


def digests(scratch, report, journal, name, steps, seconds=0.0):
    """A chain of `steps` hashes from `name`, continued from a checkpoint; two files."""
    note(journal, "start", name, os.getpid())
    checkpoint = scratch / "checkpoint.json"
    step, digest = json.loads(checkpoint.read_text()) if checkpoint.is_file() else (0, name)
    if step:
        note(journal, "continue", name, step)
    while step < steps:
        digest = hashlib.sha256(digest.encode()).hexdigest()
        step += 1
        time.sleep(seconds)
        unfinished = scratch / "checkpoint.unfinished"
        unfinished.write_text(json.dumps([step, digest]))
        unfinished.replace(checkpoint)
        report(step)
    (scratch / name).mkdir(exist_ok=True)
    (scratch / name / "digest.txt").write_text(digest)
    (scratch / name / "large.bin").write_bytes(bytes.fromhex(digest) * 30_000)  # too large for Ray to keep in line
    note(journal, "end", name)


def surroundings(scratch, report):
    """What a job finds itself in."""
    found = {
        "affinity": sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "niceness": os.nice(0),
        "threads": os.environ["OMP_NUM_THREADS"],
        "physics_threads": BatchPhysics("Hopper", [Dynamics()]).threads,
        "stdin": sys.stdin.read(),
    }
    (scratch / "found.json").write_text(json.dumps(found))
    report(1)


def killed_once(scratch, report):
    """Die by kill -9 in the middle, the first time."""
    first = scratch / "first"
    if not first.exists():
        first.touch()
        (scratch / "out.txt").write_text("hal")
        os.kill(os.getpid(), signal.SIGKILL)
    (scratch / "out.txt").write_text("whole")


def broken(scratch, report):
    """Fail whenever it is tried."""
    print("before the worst")
    raise ValueError("the worst")


def lazy(scratch, report):
    """End well and leave nothing."""


def journal_lines(journal):
    """What was noted, split into words."""
    return [line.split() for line in Path(journal).read_text().splitlines()] if Path(journal).exists() else []
