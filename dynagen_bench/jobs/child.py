"""A job's own process: `python -P child.py FD`.

What is here: finding the function and calling it. Started by `attempt`, which sends one line of JSON to stdin, leaves
it open for as long as it lives, and reads the progress from the file descriptor FD. It must not know why it runs, and
imports nothing of ours.
"""

import importlib
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

NICENESS: Final = 10
"""Jobs take hours: they leave the processor to whatever a user does beside them."""

REPORT_SECONDS: Final = 0.2
"""A job may report each step; one in this time is passed on."""


def die_with(lifeline: int) -> None:
    """End this process and all that it started when the other end of the pipe `lifeline` is closed."""

    def watch() -> None:
        while os.read(lifeline, 1 << 16):
            pass
        os.killpg(os.getpgid(0), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


def reporter(progress: int) -> Callable[[int], None]:
    """What the job calls with its units: writes them to the file descriptor `progress`, a line each."""
    last = -REPORT_SECONDS

    def report(units: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= REPORT_SECONDS:
            last = now
            os.write(progress, f"{int(units)}\n".encode())

    return report


def give_way(core: int | None) -> None:
    """Lower this process' priority, and keep it on one processor where the system lets it choose."""
    os.nice(max(0, NICENESS - os.nice(0)))
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})


def main() -> None:
    """Read what to do, and do it."""
    progress = int(sys.argv[1])
    os.set_inheritable(progress, False)
    lifeline = os.dup(0)  # the job has no stdin: what it or its children read must not be ours
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    with os.fdopen(lifeline, "rb", buffering=0, closefd=False) as requests:
        request: dict[str, Any] = json.loads(requests.readline())
    die_with(lifeline)
    give_way(request["core"])
    module, name = request["function"].split(":")
    function = getattr(importlib.import_module(module), name)
    function(Path(request["scratch"]), reporter(progress), **request["arguments"])


if __name__ == "__main__":
    main()
