"""The `dynagen` command: what it prints, and how it answers a mistake."""

import json
import shutil

import gymnasium
import pytest

import dynagen_bench
from dynagen_bench import ids
from dynagen_bench.cli import COMMANDS, main
from dynagen_bench.collection.policies import policy_file


def run(capsys, *words: str) -> str:
    """What the command prints."""
    main(words)
    return str(capsys.readouterr().out)


def test_show_prints_factors_with_units(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    shown = run(capsys, "dynamics", "show", "Hopper", "test3")
    row = next(line for line in shown.splitlines() if "body_mass" in line and "torso" in line)
    cells = [cell.strip() for cell in row.strip("│ ").split("│")]
    assert cells[:2] == ["body_mass", "torso"]
    nominal, factor, value = map(float, cells[2:5])
    assert value == pytest.approx(nominal * factor, rel=1e-3)
    assert cells[5] == "kg"
    assert "rootx" not in shown  # its damping is 0 whatever is drawn


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_show_cuts_no_name_and_no_number(robot, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")  # also where nothing is a terminal
    assert "…" not in run(capsys, "dynamics", "show", robot, "test3")


def test_the_version_is_the_packages(capsys):
    assert run(capsys, "--version").split() == ["dynagen-bench", dynagen_bench.__version__]


def test_draw_prints_what_gymnasium_takes(capsys):
    first = run(capsys, "dynamics", "draw", "Walker", "--seed", "7", "--count", "2")
    assert first == run(capsys, "dynamics", "draw", "Walker", "--seed", "7", "--count", "2")
    drawn = [json.loads(line) for line in first.splitlines()]
    assert len(drawn) == 2
    assert drawn[0] != drawn[1]
    gymnasium.make("Walker-RandDyn-v0", dynamics=drawn[0]).reset(seed=0)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("dynamics", "show", "Hoper", "test3"), "did you mean 'Hopper'"),
        (("dynamics", "show", "Hopper", "test9"), "whole number from 0 to 4"),
        (("dynamics", "draw", "Bopper", "--seed", "1"), "choose one of Walker, Hopper"),
        (("collect", "Hopper", "test"), "train0 to train19"),
        (("collect", "Hopper", "--change", "total_steps=1000"), "total_steps 1000: give none that is larger"),
        (("data", "build", "Hoper"), "did you mean 'Hopper'"),
        (("data", "verify", "Hopper", "--every", "7"), "dynagen data build Hopper --every 7"),
        (("data", "verify"), "no robot is given"),
        (("dynamics", "draw", "Hopper", "--seed", "1", "--count", "-1"), "count is -1: give a whole number from 1 on"),
        (("dynamics", "draw", "Hopper", "--seed", "-1"), "seed is -1: give a whole number from 0 on"),
        (("page", "Hopper", "--output", f"{__file__}/page.md"), "give a path elsewhere"),
        (("page", "Hopper", "--output", f"{__file__}/deep/page.md"), f"{__file__} is no folder"),
        (("page", "Hopper", "--output", "/"), "/ is no file and cannot be written as one"),
    ],
)
def test_a_mistake_ends_in_one_line(words, message):
    with pytest.raises(SystemExit, match=r"\Adynagen: [^\n]+\Z") as ended:
        main(words)
    assert message in ended.value.code


@pytest.mark.usefixtures("gl")  # which a strip and a gallery look for, too
@pytest.mark.parametrize(
    ("words", "name", "work"),
    [
        (("baseline", "Hopper"), "entry", "dynagen_bench.cli.baseline_submission"),
        (("gallery", "Hopper"), "page.html", "dynagen_bench.pictures.gallery.load_returns"),
        (("strip", "Hopper"), "bodies.png", "dynagen_bench.pictures.strips.make_strip"),
    ],
)
def test_an_output_that_cannot_be_written_is_told_before_the_work(tmp_path, monkeypatch, words, name, work):
    monkeypatch.setattr(work, None)  # what calls it fails in another way
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit) as ended:
        main([*words, "--output", str(tmp_path / "file" / name)])
    assert f"cannot be written: {tmp_path / 'file'} is no folder that you may write to" in ended.value.code


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(capsys, command):
    with pytest.raises(SystemExit) as ended:
        main([*command.split(), "--help"])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert f"usage: dynagen {command}" in said
    assert len(said) > 200


def test_collect_runs_nothing_where_nothing_is_missing(capsys, tmp_path):
    for name in ids.dynamics_ids("Ant"):
        path = policy_file(name, tmp_path)
        path.parent.mkdir(exist_ok=True)
        shutil.copyfile(policy_file(name), path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    assert "25 runs of Ant are in" in run(capsys, "collect", "Ant", "--folder", str(tmp_path))
    assert "1 runs of Ant" in run(capsys, "collect", "Ant", "train3", "train3", "--folder", str(tmp_path))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == before


def test_collect_takes_no_damaged_file_for_a_run(tmp_path):
    (tmp_path / "Hopper").mkdir()
    (tmp_path / "Hopper" / "train0.safetensors").write_text("x")
    with pytest.raises(SystemExit, match=r"train0\.safetensors is no finished run"):
        main(["collect", "Hopper", "train0", "--folder", str(tmp_path)])
