"""The factors of a robot's 25 bodies as a table of colours.

What is here: `factor_groups`, rows of elements and columns of dynamics, each cell with its level on the colour scale
and its words. Called by the gallery. It must not know HTML or which colours the levels have.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids
from dynagen_bench.dynamics import DRAWN, Parameter, factor_array, load_dynamics, nominal_robot

SCALE_BASE: Final = 1.5
LEVELS: Final = 6
"""A factor's colour is the nearest of ×1.5^(k/2), k from −6 to 6: the range of mass, inertia and friction. Damping is
drawn from a smaller one and has paler colours, as it should."""


class Cell(NamedTuple):
    """One factor: its level from −6 to 6, what stands in the cell, and what is said of it."""

    level: int
    text: str
    words: str


class Row(NamedTuple):
    """One element; `idle` where its nominal value is 0, so that a factor does nothing."""

    element: str
    idle: bool
    cells: list[Cell]


class Group(NamedTuple):
    """One parameter and its elements."""

    parameter: Parameter
    rows: list[Row]


def level_of(factor: float) -> int:
    """The colour level of a factor: half steps of 1.5, 0 at ×1, ±6 and beyond at the ends."""
    return max(-LEVELS, min(LEVELS, round(2 * math.log(factor, SCALE_BASE))))


def legend() -> list[tuple[int, str]]:
    """Every level with the factor it stands for, in words, from the lowest."""
    return [(level, f"×{SCALE_BASE ** (level / 2):.2f}") for level in range(-LEVELS, LEVELS + 1)]


def factor_groups(robot: str) -> list[Group]:
    """The table of a robot: a group a parameter, a row an element that has factors, 25 cells in the order of ids.

    Raises:
        ValueError: an unknown robot.
    """
    names = list(ids.dynamics_ids(robot))
    drawn = [load_dynamics(robot, name.split, name.index) for name in names]
    nominal = nominal_robot(robot)
    groups = []
    for parameter in DRAWN:
        factors = np.stack([factor_array(robot, dynamics, parameter) for dynamics in drawn])  # (25, elements)
        rows = []
        for i, element in enumerate(nominal.names[parameter.element]):
            if not any(element in getattr(dynamics, parameter.field) for dynamics in drawn):
                continue  # the world's mass
            value = np.atleast_1d(nominal.values[parameter.field][i])
            labelled = [(name.label, float(factor)) for name, factor in zip(names, factors[:, i], strict=True)]
            cells = [_cell(parameter, element, value, label, factor) for label, factor in labelled]
            rows.append(Row(element, not np.any(value), cells))
        groups.append(Group(parameter, rows))
    return groups


def _cell(parameter: Parameter, element: str, value: NDArray[np.float64], label: str, factor: float) -> Cell:
    text = f"{factor:.2f}"
    words = f"{label}, {parameter.field} of {element}: ×{text}"
    if not np.any(value):
        return Cell(0, text, f"{words}, of 0: no effect")
    before, after = (" ".join(f"{number:.3g}" for number in numbers) for numbers in (value, value * factor))
    return Cell(level_of(factor), text, f"{words}, {before} → {after} {parameter.unit}")
