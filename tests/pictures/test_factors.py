"""The table says what was drawn."""

import json
import math
from importlib import resources

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.pictures.factors import factor_groups, legend, level_of


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_drawn_factor_has_its_cell(robot):
    text = (resources.files("dynagen_bench.dynamics") / "data" / f"{robot}.json").read_text(encoding="utf-8")
    drawn = json.loads(text)
    bodies = drawn["train"] + drawn["test"]
    for group in factor_groups(robot):
        expected = {
            name: [body[group.parameter.field][name] for body in bodies] for name in bodies[0][group.parameter.field]
        }
        found = {row.element: [float(cell.text) for cell in row.cells] for row in group.rows}
        assert found.keys() == expected.keys()
        for element, factors in expected.items():
            assert found[element] == pytest.approx(factors, abs=0.00501)
            assert len(factors) == 25


def test_a_cell_says_who_what_and_how_much():
    groups = {group.parameter.field: {row.element: row for row in group.rows} for group in factor_groups("Hopper")}
    cell = groups["body_mass"]["torso"].cells[23]
    assert cell.words.startswith(f"test3, body_mass of torso: ×{cell.text}, 3.67 → ")
    assert cell.words.endswith(" kg")
    assert groups["dof_damping"]["rootx"].idle
    assert groups["dof_damping"]["rootx"].cells[0].words.endswith("of 0: no effect")
    assert not groups["dof_damping"]["thigh_joint"].idle


@given(st.floats(0.05, 20.0))
def test_levels_are_even_around_one(factor):
    level = level_of(factor)
    assert level_of(1 / factor) == -level
    assert abs(level) == 6 or abs(2 * math.log(factor, 1.5) - level) <= 0.5 + 1e-9


def test_the_legend_names_the_ends_of_the_draws():
    assert [text for _, text in legend()][::6] == ["×0.30", "×1.00", "×3.38"]  # 1.5 to the −3, 0, 3
