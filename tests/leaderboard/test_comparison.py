"""Comparing two entries, or a submission with an entry: by hand, and at the command line."""

import re
import sys

import numpy as np
import pytest

from dynagen_bench.evaluation.submission import FILE_NAME, write_submission
from leaderboard.__main__ import main
from leaderboard.board import entry_of, submit
from leaderboard.comparison import FEWEST, Comparison, compared
from leaderboard.statistics import Estimate
from tests.evaluation.samples import submission

HIGH, LOW = np.array([[100.0], [110.0], [120.0]]), np.array([[60.0], [70.0], [80.0]])


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [((0.5, 1.0), "undecided"), ((0.0, 0.5), "undecided"), ((0.51, 1.0), "holds"), ((0.0, 0.49), "does not hold")],
)
def test_an_interval_that_reaches_one_half_decides_nothing(interval, verdict):
    estimate = Estimate(sum(interval) / 2, interval)
    assert Comparison("DADT > DT", estimate, ("Hopper",), (3, 3), (estimate,)).verdict == verdict


def test_robots_are_compared_that_both_have():
    found = compared("a > b", {"Hopper": HIGH, "Ant": HIGH}, {"Ant": LOW, "Walker": LOW})
    assert found.robots == ("Ant",)
    assert found.runs == (3, 3)
    assert found.estimate == found.each[0] == Estimate(1.0, (1.0, 1.0))
    assert found.verdict == "holds"
    assert compared("b > a", {"Ant": LOW}, {"Ant": HIGH}).verdict == "does not hold"
    for scores, others in ((None, {"Ant": LOW}), ({"Ant": LOW}, None), ({"Ant": LOW}, {"Hopper": HIGH})):
        assert compared("a > b", scores, others).verdict == "not run"


def test_two_runs_decide_nothing_however_far_apart():
    assert FEWEST == 3
    assert compared("a > b", {"Ant": HIGH[:2]}, {"Ant": LOW}).verdict == "undecided"
    assert compared("a > b", {"Ant": HIGH}, {"Ant": LOW[:2]}).verdict == "undecided"


@pytest.fixture
def two(tmp_path, board):
    """A board with an entry of three runs; and a folder with a submission of three better ones on two robots."""
    write_submission(tmp_path / "theirs", submission({"Hopper": [60.0, 70.0, 80.0]}, agent="Theirs"))
    submit(tmp_path / "theirs", board)
    runs = {"Hopper": [100.0, 110.0, 120.0], "Ant": [50.0, 51.0, 52.0]}
    write_submission(tmp_path / "my [new] entry", submission(runs, agent="Mine"))
    return tmp_path / "my [new] entry", "theirs-zero-shot-last"


def test_a_submission_is_compared_with_an_entry(two, board, capsys):
    folder, slug = two
    assert main(["compare", str(folder), slug, "--board", str(board)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"first:  {folder}\nsecond: {slug}\n")
    lines = [re.split(r" {2,}", line.strip()) for line in shown.splitlines()]
    place = lines.index(["Hopper", "55.00 ± 5.00", "35.00 ± 5.00", "1.00 [1.00, 1.00]", "first"])
    assert lines[place + 1] == ["(3 runs)", "(3 runs)"]
    assert "Ant" not in shown
    assert f"Nobody has replayed {folder} and {slug}" in shown
    assert main(["compare", slug, str(folder), "--board", str(board)]) == 0
    (hopper,) = (line for line in capsys.readouterr().out.splitlines() if "Hopper" in line)
    assert re.search(r" 0\.00 \[0\.00, 0\.00\] +second$", hopper)


def test_a_narrow_terminal_breaks_no_name_and_no_number(two, board, tmp_path, monkeypatch, capsys):
    folder = tmp_path / ("a-long-name-of-a-folder-" * 4)
    write_submission(folder, submission({"Hopper": [100.0, 300.0, 320.0]}, agent="Mine"))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")  # 80 columns, no colours
    assert main(["compare", str(folder), two[1], "--board", str(board)]) == 0
    names, shown = capsys.readouterr().out.split("\n\n", 1)
    assert names == f"first:  {folder}\nsecond: {two[1]}"
    table, _ = shown.split("\nNobody has replayed")
    assert max(map(len, table.splitlines())) <= 80
    assert re.search(r"^Hopper +120\.00 ± 60\.83 +35\.00 ± 5\.00 +1\.00 \[1\.00, 1\.00\] +first$", table, re.M)


def test_what_is_compared_has_been_replayed(honest, cheat, board):
    entry = entry_of(str(honest), board)
    assert (entry.label, entry.replayed) == ("replayed", True)
    cheat.evaluation["returns"][0][0] += 1.0
    cheat.write()
    with pytest.raises(ValueError, match=r"returns\.0\.0: "):
        entry_of(str(cheat.folder), board)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ("theirs-zero-shot-last", "theirs-zero-shot-last", "both are theirs-zero-shot-last: give two"),
        (
            "theirs-zeroshot-last",
            "folder",
            "has no entry 'theirs-zeroshot-last': did you mean 'theirs-zero-shot-last'?",
        ),
        ("qqqq", "folder", "has no entry 'qqqq': it has theirs-zero-shot-last"),
        ("theirs-zero-shot-last", "empty", f"empty/{FILE_NAME} is no file: give the folder that holds"),
        ("theirs-zero-shot-last", "other", "and other on Ant: on no robot both"),
    ],
)
def test_a_wrong_comparison_ends_in_one_line(two, board, tmp_path, monkeypatch, first, second, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    write_submission(tmp_path / "other", submission({"Ant": [1.0, 2.0, 3.0]}))
    second = str(two[0]) if second == "folder" else second
    with pytest.raises(SystemExit, match=r"\Aleaderboard: [^\n]+\Z") as stop:
        main(["compare", first, second, "--board", str(board)])
    assert message in stop.value.code


def test_few_runs_are_told_of(two, board, tmp_path, capsys):
    write_submission(tmp_path / "few", submission({"Hopper": [300.0]}))
    assert main(["compare", str(tmp_path / "few"), two[1], "--board", str(board)]) == 0
    shown = capsys.readouterr().out
    assert "Nothing is decided by fewer than 3 runs of each" in shown
    (hopper,) = (line for line in shown.splitlines() if "Hopper" in line)
    assert hopper.split()[-2:] == ["1.00", "undecided"]
