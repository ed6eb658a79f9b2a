"""The ratios that the README's performance section reports, of one run of the benchmarks.

python -m pytest tests/benchmarks --benchmark-only --benchmark-json run.json
python -m tests.benchmarks.ratios run.json
"""

import json
import sys
from pathlib import Path

from dynagen_bench import ids


def medians(path: Path) -> dict[str, dict[str, float]]:
    """Group → name of the benchmark → median seconds."""
    groups: dict[str, dict[str, float]] = {}
    for run in json.loads(path.read_text(encoding="utf-8"))["benchmarks"]:
        names = [str(value) for key, value in (run["params"] or {}).items() if key != "robot"]
        groups.setdefault(run["group"], {})[names[0] if names else run["name"]] = run["stats"]["median"]
    return groups


def main(path: Path) -> None:
    """Print the tables, Markdown."""
    groups = medians(path)
    print("| robot | one, beside Gymnasium's v5 | 50, beside bare `Batch.step` | 2 threads beside 1 |", end="")
    print(" beside SyncVectorEnv | beside AsyncVectorEnv | steps/s |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for robot in ids.ROBOTS:
        single = next(times for group, times in groups.items() if group.startswith(f"{robot}: one environment"))
        many = next(times for group, times in groups.items() if group.startswith(f"{robot}: 50 environments"))
        theirs = single["Gymnasium's v5"]
        ours, steps = many["ours"], 50 * 20
        print(
            f"| {robot} | {single['ours'] / theirs:.2f} × the time "
            f"| {ours / many['bare Batch.step']:.2f} × the time | {many['ours, 1 thread'] / ours:.2f} × the rate "
            f"| {many['SyncVectorEnv'] / ours:.1f} × | {many['AsyncVectorEnv'] / ours:.1f} × | {steps / ours:,.0f} |"
        )
    print("\n| N | " + " | ".join(("steps/s", "µs a step of one environment")) + " |\n| ---: | ---: | ---: |")
    sizes = next(times for group, times in groups.items() if group.startswith("Hopper: N environments"))
    for size, seconds in sizes.items():
        steps = 20 * int(size)
        print(f"| {size} | {steps / seconds:,.0f} | {1e6 * seconds / steps:.1f} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
