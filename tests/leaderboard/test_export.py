"""The board as CSV and as LaTeX: what is in a spreadsheet or a paper is what the board says."""

import csv
import io

import numpy as np
import pytest

from dynagen_bench.evaluation.submission import write_submission
from leaderboard.__main__ import main
from leaderboard.board import submit
from leaderboard.entries import Entry
from leaderboard.export import COLUMNS, latex, scores_csv
from leaderboard.standings import run_scores
from tests.evaluation.samples import submission


def test_the_mean_of_a_runs_lines_is_its_score():
    one = submission({"Hopper": [80.0, 120.0], "Ant": [10.0]}, agent='A, "B"')
    lines = list(csv.DictReader(io.StringIO(scores_csv([Entry("a-zero-shot-last", one)]))))
    assert tuple(lines[0]) == COLUMNS
    assert len(lines) == 3 * 5
    for robot, scores in run_scores(one).items():
        for seed, score in enumerate(scores):
            own = [line for line in lines if (line["robot"], line["seed"]) == (robot, str(seed))]
            assert [line["dynamics"] for line in own] == [f"test{i}" for i in range(5)]
            assert np.mean([float(line["score"]) for line in own]) == pytest.approx(score)
    assert {line["agent"] for line in lines} == {'A, "B"'}
    assert {float(line["mean_return"]) for line in lines if line["robot"] == "Ant"} == {10.0}
    assert {line["gradient_steps"] for line in lines} == {"1000"}


def test_runs_keep_their_seed_whatever_their_order():
    one = submission({"Hopper": [80.0, 120.0]})
    turned = one.model_copy(update={"runs": one.runs[::-1]})
    assert scores_csv([Entry("a", one)]) == scores_csv([Entry("a", turned)])


def test_a_table_for_a_paper():
    entries = [
        Entry("a", submission({"Hopper": [80.0, 120.0]}, agent="a_b & 100%"), "replayed"),
        Entry("b", submission({"Hopper": [20.0], "Ant": [20.0] * 5}, agent=r"\input{x}")),
        Entry("c", submission({"Hopper": [180.0]}, agent="Ideal", privileged="test-dynamics"), "replayed"),
    ]
    lines = latex(entries).splitlines()
    assert lines[0].startswith("% Zero-shot, last checkpoint (official)")
    assert lines[1:] == [
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"Agent & Hopper & Ant \\",
        r"\midrule",
        r"a\_b \& 100\% & \textbf{50.00} $\pm$ 14.14 (2) & -- \\",
        r"\textbackslash{}input\{x\} (self-reported) & 10.00 (1) & 10.00 $\pm$ 0.00 \\",
        r"\midrule",
        r"Ideal & 90.00 (1) & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_commands(tmp_path, board, capsys):
    write_submission(tmp_path / "mine", submission({"Hopper": [80.0, 120.0]}))
    submit(tmp_path / "mine", board)
    assert main(["export", "csv", "--board", str(board)]) == 0
    assert capsys.readouterr().out.count("dadt-zero-shot-last,DADT,") == 10
    assert main(["export", "latex", "--board", str(board)]) == 0
    assert r"DADT (self-reported) & 50.00 $\pm$ 14.14 (2) \\" in capsys.readouterr().out
