"""Run folders as the page needs them: read, and in groups that differ in their seed alone.

What is here: `Run`, `Group`, `read_runs` and `grouped`. Called by the builder and the reference results. It must not
know how anything looks.
"""

import collections
import csv
import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from agents.run_folder import read_config

_RECORD_ONLY: Final = ("runs", "name", "seed", "threads", "evaluate_every", "checkpoint_every", "log_every")
"""Settings in which the runs of a group may differ."""

Curve = dict[int, float]
"""Gradient steps → value."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A run as its folder tells.

    Attributes:
        name: of the folder.
        about: config.json.
        curves: column of curves.csv → its points; only finite numbers.
    """

    name: str
    about: Mapping[str, Any]
    curves: Mapping[str, Curve]

    @property
    def seed(self) -> int:
        """Of everything random in it."""
        return int(self.about["settings"]["seed"])

    @property
    def step(self) -> int:
        """The last that the curves tell of."""
        return max((step for curve in self.curves.values() for step in curve), default=0)

    @property
    def hours(self) -> float:
        """Of training."""
        seconds = self.curves.get("seconds", {})
        return seconds[max(seconds)] / 3600 if seconds else 0.0

    @property
    def facts(self) -> dict[str, Any]:
        """All that other seeds of the run have in common with it, flat."""
        settings = {key: value for key, value in self.about["settings"].items() if key not in _RECORD_ONLY}
        return {**self.about.get("data", {}), **settings, **self.about["config"], "agent": self.about["agent"]}


@dataclasses.dataclass(frozen=True)
class Group:
    """Runs that differ in their seed alone.

    Attributes:
        robot: theirs.
        label: agent, and what tells it from other groups of the agent and robot.
        order: groups are shown in its order.
        runs: by seed.
    """

    robot: str
    label: str
    order: tuple[Any, ...]
    runs: tuple[Run, ...]

    def ends(self, name: str) -> list[float]:
        """The last value of a curve, of each run that has it, at its own last step: runs may end apart."""
        return [curve[max(curve)] for run in self.runs if (curve := run.curves.get(name))]

    def curves(self, name: str) -> list[Curve]:
        """A curve of each run that has it, at the steps that all of these have."""
        given = [run.curves[name] for run in self.runs if run.curves.get(name)]
        steps = sorted(set.intersection(*(set(curve) for curve in given))) if given else []
        return [{step: curve[step] for step in steps} for curve in given] if steps else []


def read_runs(folder: Path) -> list[Run]:
    """The runs in a folder, by name; those that have no curves yet are left out.

    Raises:
        ValueError: a config.json or curves.csv is not what training writes.
    """
    found = []
    for path in sorted(folder.glob("*/config.json")):
        curves = path.with_name("curves.csv")
        if path.parent.name.startswith(".") or not curves.is_file():
            continue
        about = read_config(path.parent)
        found.append(Run(path.parent.name, about, _read_curves(curves)))
    return found


def _read_curves(path: Path) -> dict[str, Curve]:
    curves: dict[str, Curve] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                for name, text in row.items():
                    if name != "step" and text and math.isfinite(value := float(text)):
                        curves.setdefault(name, {})[int(row["step"])] = value
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is no table of curves ({error!r}): delete the run folder and train again") from error
    return curves


def grouped(runs: Sequence[Run]) -> list[Group]:
    """The groups of runs, by robot, agent and what else tells them apart.

    A seed counts once: runs that have the seed of another one, and all else too, are a group of their own, `again`.
    """
    together: dict[tuple[str, int], list[Run]] = {}
    times: collections.Counter[tuple[str, int]] = collections.Counter()
    for run in sorted(runs, key=lambda run: (run.seed, run.name)):
        kind = json.dumps(run.facts, sort_keys=True)
        together.setdefault((kind, times[kind, run.seed]), []).append(run)
        times[kind, run.seed] += 1
    every = list(together.values())
    groups = []
    for (_, again), some in together.items():
        facts = some[0].facts
        rivals = [other[0].facts for other in every if _kind(other[0].facts) == _kind(facts)]
        differing = [
            key
            for key in dict.fromkeys(key for one in rivals for key in one)
            if len({str(one.get(key)) for one in rivals}) > 1
        ]
        told = [f"{key.replace('_', '-')} {_plain(facts[key])}" for key in differing if facts.get(key) is not None]
        told += [f"again{f' ({again})' * (again > 1)}"] if again else []
        # pairs throughout: the agent's groups on another robot may differ in fewer facts, and are sorted with these
        order = (facts["robot"], facts["agent"], *(_sortable(facts.get(key)) for key in differing), _sortable(again))
        groups.append(Group(facts["robot"], ", ".join([facts["agent"], *told]), order, tuple(some)))
    return sorted(groups, key=lambda group: group.order)


def _kind(facts: Mapping[str, Any]) -> tuple[str, str]:
    return facts["robot"], facts["agent"]


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _sortable(value: Any) -> tuple[float, str]:
    number = isinstance(value, int | float)
    return (float(value), "") if number else (-math.inf if value is None else math.inf, str(value))
