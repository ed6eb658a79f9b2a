"""Random damage to an honest submission: `python -m tests.leaderboard.fuzz --inputs 100000`.

Every input is a folder that is read as a board reads it, trace and all; what is still accepted is replayed now and
then. An input may be accepted, or refused in one printable line; any other error ends the run, with the number of the
input, from which it can be made again.
"""

import collections
import copy
import hashlib
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rich.progress
import tyro

from dynagen_bench.evaluation.submission import FILE_NAME, read_traces
from leaderboard.entries import read_official
from leaderboard.verify import verify
from tests.evaluation.samples import traced

Rng = np.random.Generator

VALUES: list[Any] = [
    *(None, True, 0, -1, 1e999, float("nan"), -0.0, 2**63, 10**400, 1e-320),
    *("", "\x00", "\u202e", "\ud800", "a" * 5000, "<script>alert(1)</script>", "../../etc/passwd", "/etc/passwd"),
    *([], {}, [[]], [[1.0] * 2000], {"__class__": "os.system"}),
]
"""What is put in place of a value."""


def damaged_bytes(content: bytes, rng: Rng) -> bytes:
    """A few bytes flipped, cut out, doubled, put in from elsewhere, or made a number that means much."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data) + 1)) if rng.random() < 0.7 else int(rng.integers(min(len(data), 200) + 1))
        size = int(rng.integers(1, 40))
        match rng.integers(6):
            case 0:
                data[at : at + 1] = bytes([int(rng.integers(256))])
            case 1:
                del data[at : at + size]
            case 2:
                data[at:at] = data[at : at + size]
            case 3:
                data[at:at] = rng.bytes(size)
            case 4:
                data[at : at + 8] = rng.choice([np.nan, np.inf, -np.inf, 1e308, 5e-324, -1e10]).astype("<f8").tobytes()
            case _:
                data[0:8] = int(rng.integers(2**63) >> int(rng.integers(63))).to_bytes(8, "little")
    return bytes(data)


def damaged_json(content: Any, rng: Rng) -> Any:
    """A value somewhere in the structure replaced, removed, doubled, renamed or exchanged for another."""
    content = copy.deepcopy(content)
    for _ in range(rng.integers(1, 3)):
        inner, key = content, rng.choice(sorted(content)) if content else None
        while key is not None and isinstance(inner[key], (dict, list)) and inner[key] and rng.random() < 0.8:
            inner = inner[key]
            keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
            key = keys[int(rng.integers(len(keys)))]
        if key is None:
            break
        match rng.integers(5):
            case 0 | 1:
                inner[key] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
            case 2:
                del inner[key]
            case 3 if isinstance(inner, list):
                inner.insert(0, inner[key])
            case 3:
                inner["x" * int(rng.integers(1, 9))] = inner[key]
            case _ if isinstance(inner[key], (int, float)) and abs(inner[key]) < 1e300:
                inner[key] = inner[key] + rng.choice([-1, 1, 0.5, 1e-9, 1e12])
    return content


def fuzz(folder: Path, inputs: int, seed: int, done: Callable[[], None] = lambda: None) -> dict[str, int]:
    """Damage the honest submission in `folder` in `inputs` ways and read each; how they ended → how many.

    Raises:
        AssertionError: a complaint is not one printable line of reasonable length.
    """
    text = (folder / FILE_NAME).read_bytes()
    trace = folder / read_official(folder).runs[0].trace_name
    honest_trace, ends = trace.read_bytes(), collections.Counter[str]()
    for number in range(inputs):
        rng = np.random.default_rng([seed, number])
        kind = int(rng.integers(4))
        content = json.loads(text)
        data = damaged_bytes(honest_trace, rng) if kind >= 2 else honest_trace
        if kind == 1:
            content = damaged_json(content, rng)
        elif kind == 3:  # with the hash of the damaged trace, so that what is behind it is reached
            content["runs"][0]["trace"] = hashlib.sha256(data).hexdigest()
        written = json.dumps(content).encode("utf-8")
        (folder / FILE_NAME).write_bytes(damaged_bytes(text, rng) if kind == 0 else written)
        trace.write_bytes(data)
        try:
            ends[_end(folder, replayed=rng.random() < (0.2 if kind == 3 else 0.01))] += 1
        except BaseException as error:
            error.add_note(f"input {number} of seed {seed}")
            raise
        done()
    return dict(ends)


def _end(folder: Path, replayed: bool) -> str:
    """How one input ends."""
    try:
        submission = read_official(folder)
        for run in submission.runs:
            if run.trace is not None:
                read_traces(folder, run)
    except (ValueError, FileNotFoundError) as error:
        complaint = str(error)
        assert complaint.isprintable(), complaint
        assert len(complaint) < 1000
        return "refused by the reader"
    if not replayed:
        return "read"
    faults = [fault for check in verify(folder, submission) for fault in check.faults]
    assert all(fault.isprintable() and len(fault) < 1000 for fault in faults)
    return "read, refused by the replay" if faults else "read and replayed"


def main(inputs: int = 100_000, seed: int = 0) -> None:
    """Fuzz the reader, and say how the inputs ended."""
    with tempfile.TemporaryDirectory() as folder, rich.progress.Progress() as bar:
        traced(Path(folder))
        task = bar.add_task("fuzzing", total=inputs)
        ends = fuzz(Path(folder), inputs, seed, lambda: bar.advance(task))
    print(f"{inputs:,} inputs, no unhandled exception: " + ", ".join(f"{n:,} {end}" for end, n in sorted(ends.items())))


if __name__ == "__main__":
    tyro.cli(main)
