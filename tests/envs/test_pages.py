"""The pages of the environments: they are those that were committed, and say what the environments do."""

import dataclasses
import inspect
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.dynamics import load_dynamics, nominal_robot
from dynagen_bench.dynamics.draws import DRAWN
from dynagen_bench.envs import ROBOT_CLASSES, Rules
from dynagen_bench.envs.pages import attribute_docs, environment_page, write_page
from dynagen_bench.envs.rules import keyword_fields
from dynagen_bench.envs.vector import RandomDynamicsVector

FOLDER = Path(__file__).parents[2] / "docs" / "environments"


def page_file(robot: str) -> str:
    """Name of a robot's page, that of its module: `half_cheetah.md`."""
    return f"{ROBOT_CLASSES[robot].__module__.rpartition('.')[2]}.md"


def rows(text: str) -> list[list[str]]:
    """All table rows of a page, cell by cell."""
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in text.splitlines() if line.startswith("|")]


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """The page of each robot, as it is generated now."""
    return {robot: environment_page(robot) for robot in ids.ROBOTS}


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_the_committed_page_is_the_generated_one(robot, pages):
    committed = (FOLDER / page_file(robot)).read_text(encoding="utf-8")
    assert committed == pages[robot], (
        f"make it anew: dynagen page {robot} --output docs/environments/{page_file(robot)}"
    )


def test_the_index_has_a_line_a_robot_with_its_sizes():
    index = rows((FOLDER / "README.md").read_text(encoding="utf-8"))
    for robot in ids.ROBOTS:
        env = gymnasium.make(f"{robot}-RandDyn-test0")
        sizes = [f"{env.observation_space.shape[0]}", f"{env.action_space.shape[0]}"]
        assert [f"[{robot}]({page_file(robot)})", *sizes] in [row[:3] for row in index]


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_section_is_there_and_every_block_is_closed(robot, pages):
    headings = re.findall(r"^## (.*)$", pages[robot], re.MULTILINE)
    assert headings == [
        "Make it",
        "Actions",
        "Observations",
        "Reward",
        "Termination",
        "Start",
        "Differences from Gymnasium",
        "Info",
        "Keyword arguments",
        "Many at once",
        "What varies",
        "How it was drawn",
    ]
    assert pages[robot].count("```") == 4
    assert pages[robot].count("<details>") == pages[robot].count("</details>") == 1


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_keyword_has_its_default_and_a_meaning(robot, pages):
    table = {row[0].strip("`"): row for row in rows(pages[robot]) if len(row) == 4}
    env = ROBOT_CLASSES[robot]()
    fields = {field.name for field in dataclasses.fields(Rules)}
    assert table.keys() & fields == set(keyword_fields(env.rules))
    for name in keyword_fields(env.rules):
        _, default, _, meaning = table[name]
        assert meaning.endswith(".")
        value = getattr(env.rules, name)
        if isinstance(value, bool):
            assert default == str(value)
        else:
            ends = [float(end.replace("−", "-").replace("∞", "inf")) for end in default.split(" to ")]
            assert ends == pytest.approx(np.atleast_1d(value))


def test_every_keyword_of_a_vector_environment_is_there(pages):
    section = pages["Hopper"].partition("## Many at once")[2].partition("##")[0]
    table = {row[0].strip("`"): row[1] for row in rows(section)[2:]}
    parameters = inspect.signature(RandomDynamicsVector).parameters
    assert set(table) == set(parameters) - {"robot", "kwargs"}
    assert (table["num_envs"], table["autoreset_mode"], table["indices"]) == ("1", "NextStep", "None")


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_info_keys_are_those_of_the_environment(robot, pages):
    section = pages[robot].partition("## Info")[2].partition("##")[0]
    table = {row[0].strip("`"): row[1:3] for row in rows(section)[2:]}
    env = gymnasium.make(f"{robot}-RandDyn-test1")
    at_reset = env.reset(seed=1)[1]
    at_step = env.step(env.action_space.sample())[4]
    assert {key for key, (reset, _) in table.items() if reset} == set(at_reset)
    assert {key for key, (_, step) in table.items() if step} == set(at_step)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_what_varies_is_every_element_with_the_range_of_its_draws(robot, pages):
    varies = pages[robot].partition("## What varies")[2].partition("## How")[0]
    nominal = nominal_robot(robot)
    for parameter in DRAWN:
        section = varies.partition(f"### {parameter.field}\n")[2].partition("###")[0]
        found = {row[0].strip("`"): row for row in rows(section)[2:]}
        values = dict(zip(nominal.names[parameter.element], nominal.values[parameter.field], strict=True))
        assert set(found) == {name for name, value in values.items() if value.any()}
        for name, (_, shown, *limits) in found.items():
            assert [float(number) for number in shown.split()] == pytest.approx(values[name].flatten(), rel=1e-3)
            draws = [
                [getattr(load_dynamics(robot, split, i), parameter.field)[name] for i in range(ids.SPLIT_SIZES[split])]
                for split in ("train", "test")
            ]
            expected = [limit for drawn in draws for limit in (min(drawn), max(drawn))]
            assert [float(limit) for limit in limits] == pytest.approx(expected, abs=6e-4)


def test_attribute_docs_are_the_strings_under_the_attributes():
    assert attribute_docs(Rules)["healthy_reward"] == "Reward of a step that ends healthy."
    assert set(attribute_docs(Rules)) == {field.name for field in dataclasses.fields(Rules)}


def test_a_page_is_printed_or_written_whole(tmp_path, capsys, pages):
    write_page("Hopper")
    assert capsys.readouterr().out == pages["Hopper"]
    write_page("Hopper", tmp_path / "pages" / "hopper.md")
    assert (tmp_path / "pages" / "hopper.md").read_text(encoding="utf-8") == pages["Hopper"]
    assert [path.name for path in (tmp_path / "pages").iterdir()] == ["hopper.md"]


def test_an_unknown_robot_is_said_to_be():
    with pytest.raises(ValueError, match="did you mean 'Hopper'"):
        environment_page("hoper")
