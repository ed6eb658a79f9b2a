"""How far the intervals of a few runs can be trusted: the tables of docs/statistics.md, by simulation.

    python -m tests.leaderboard.coverage --entries 400

What is here: entries whose true scores are known. Called from the command line alone; it takes some minutes.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from rich.progress import track

from dynagen_bench import ids
from leaderboard.statistics import Scores, improvement, interquartile_mean

DYNAMICS = 5
TRUE = 50.0
"""Mean and, because what is drawn is symmetrical, interquartile mean of every simulated score."""

CASES = ((1, 5, 5.0, 5.0), (1, 5, 5.0, 0.5), (1, 5, 0.0, 5.0), (5, 5, 5.0, 5.0), (5, 5, 5.0, 0.5), (5, 10, 5.0, 5.0))
"""Robots, runs, standard deviation between runs, and within a run between its dynamics."""


def entries(
    count: int, robots: int, runs: int, between: float, within: float, rng: np.random.Generator
) -> Iterator[Scores]:
    """Entries whose runs, and the dynamics of a run, differ by these standard deviations."""
    for _ in range(count):
        yield {
            robot: TRUE + rng.normal(0, between, (runs, 1)) + rng.normal(0, within, (runs, DYNAMICS))
            for robot in ids.ROBOTS[:robots]
        }


def apart(scores: Scores) -> Scores:
    """The same scores, each dynamics drawn by itself."""
    return {f"{robot}{i}": column[:, None] for robot, of in scores.items() for i, column in enumerate(of.T)}


def holds(scores: Scores) -> bool:
    """Whether the interval has the true value in it."""
    low, high = interquartile_mean(scores).interval or (np.nan, np.nan)
    return bool(low <= TRUE <= high)


def decided(scores: Scores, others: Scores) -> bool:
    """Whether the probability of improvement is told to be another than one half."""
    found = improvement(scores, others)
    assert found is not None
    assert found.interval is not None
    return not found.interval[0] <= 0.5 <= found.interval[1]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--entries", type=int, default=400, help="simulated entries a line")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    print("robots, runs, between runs, within a run: true value inside, of whole runs and of dynamics apart")
    for case in CASES:
        drawn = track(entries(given.entries, *case, rng), f"{case}", given.entries, transient=True)
        found = np.array([(holds(scores), holds(apart(scores))) for scores in drawn]).mean(axis=0)
        print(*case, *(f"{100 * part:.0f} %" for part in found))
    print("runs each: equal agents that are told apart")
    for runs in (2, 3, 5, 10):
        ones, others = (entries(given.entries, 1, runs, 5.0, 5.0, rng) for _ in range(2))
        pairs = track(zip(ones, others, strict=True), f"{runs}", given.entries, transient=True)
        print(runs, f"{100 * np.mean([decided(*pair) for pair in pairs]):.0f} %")


if __name__ == "__main__":
    main()
