"""The tables that the README's performance section shows, from one run of the benchmarks: minima, as ratios.

    python -m pytest tests/benchmarks --benchmark-only --benchmark-json run.json
    python -m tests.benchmarks.ratios run.json

Minima, because what else a machine does can only add to a time.
"""

import json
import sys
from pathlib import Path
from typing import Any

from dynagen_bench import ids
from dynagen_bench.markdown import table


def runs(path: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Group → parameter of the benchmark that is not the robot → what pytest-benchmark says of it."""
    groups: dict[str, dict[str, dict[str, Any]]] = {}
    for run in json.loads(path.read_text(encoding="utf-8"))["benchmarks"]:
        names = [str(value) for key, value in (run["params"] or {}).items() if key != "robot"]
        groups.setdefault(run["group"], {})[names[0] if names else run["name"]] = run
    return groups


def stepping(groups: dict[str, dict[str, dict[str, Any]]]) -> str:
    """One environment and fifty, a row a robot."""
    rows = []
    for robot in ids.ROBOTS:
        one = next(g for name, g in groups.items() if name.startswith(f"{robot}: one environment"))
        many = next(g for name, g in groups.items() if name.startswith(f"{robot}: 50 environments"))
        single = {name: run["stats"]["min"] for name, run in one.items()}
        times = {name: run["stats"]["min"] for name, run in many.items()}
        ours, theirs = times["ours"], single["Gymnasium's v5"]
        rows.append(
            [
                robot,
                f"{single['ours'] / theirs:.2f}",
                f"{ours / times['bare Batch.step']:.2f}",
                f"{times['ours, 1 thread'] / ours:.2f}",
                f"{times['SyncVectorEnv'] / ours:.1f}",
                f"{times['AsyncVectorEnv'] / ours:.1f}",
                f"{many['ours']['extra_info']['environment_steps'] / ours:,.0f}",
            ]
        )
    header = ["robot", "one: time beside Gymnasium's v5", "50: time beside bare `Batch.step`", "rate beside one thread"]
    return table([*header, "rate beside `SyncVectorEnv`", "rate beside `AsyncVectorEnv`", "steps/s"], rows)


def growth(groups: dict[str, dict[str, dict[str, Any]]]) -> str:
    """Any number of environments, a row a number."""
    rows = []
    for number, run in next(g for name, g in groups.items() if name.startswith("Hopper: N environments")).items():
        steps, seconds = run["extra_info"]["environment_steps"], run["stats"]["min"]
        memory = run["extra_info"]["bytes"] / 1e6
        rows.append([number, f"{steps / seconds:,.0f}", f"{1e6 * seconds / steps:.1f}", f"{memory:.1f}"])
    return table(["N", "steps/s", "µs a step of one environment", "MB"], rows)


if __name__ == "__main__":
    read = runs(Path(sys.argv[1]))
    print(f"{stepping(read)}\n\n{growth(read)}")
