"""Means, deviations, marks and order of the tables, by hand."""

import math
import re
import sys

import pytest

from dynagen_bench import ids
from leaderboard.entries import Entry
from leaderboard.published import PUBLISHED
from leaderboard.standings import data_scores, dynamics_scores, run_scores, standings, task_scores
from leaderboard.statistics import Estimate, Rank
from leaderboard.terminal import show_tables
from tests.evaluation.samples import submission, write_references


def entry(slug, runs, **fields):
    return Entry(slug, submission(runs, **fields), "replayed")


def rows(entries):
    (table,) = standings(entries)
    return {row.entry.slug: row for row in table.rows}


def test_scores_are_computed_from_the_returns():
    # the scale of the samples is 0 to 200: a score is half the mean return
    assert run_scores(submission({"Ant": [60.0], "Hopper": [80.0, 100.0]})) == {"Hopper": [40.0, 50.0], "Ant": [30.0]}


def test_mean_and_sample_deviation_by_hand():
    cell = rows([entry("a", {"Hopper": [80.0, 100.0, 120.0]})])["a"].cells["Hopper"]
    # scores 40, 50, 60: deviations −10, 0, 10, their squares' sum 200 over 3 − 1
    assert cell[:4] == (50.0, 10.0, 3, True)
    assert rows([entry("a", {"Hopper": [80.0]})])["a"].cells["Hopper"][:4] == (40.0, None, 1, True)


def test_bold_is_as_in_the_paper():
    # Table 2: DT and DADT are bold on Walker and Hopper, DT alone on HalfCheetah, DADT alone on SlimHumanoid
    table = next(table for table in PUBLISHED if table.number == 2)
    bold = {row.agent: [cell is not None and cell.bold for cell in row.cells] for row in table.rows}
    assert bold["Transformer-BC"][:4] == [False] * 4
    assert bold["DT"][:4] == [True, True, True, False]
    assert bold["DADT"] == [True, True, False, True, True]


def test_the_terminal_ranks_who_has_somebody_to_be_ranked_with(capsys):
    one, single, other = (
        entry(slug, {"Hopper": runs}) for slug, runs in (("a", [9.0, 8.0]), ("b", [9.0]), ("c", [7.0, 5.0]))
    )
    for entries, ranked in (([one], False), ([one, single], False), ([one, single, other], True)):
        show_tables(entries)
        shown = capsys.readouterr().out
        assert ("Interquartile means and ranks" in shown) == ranked
    lines = [line.split() for line in shown.splitlines()]
    assert lines[-2][0] == "Hopper"
    assert [line[-1] for line in lines[-2:]] == ["1", "2"]  # the better one first, whoever has a single run not at all


def test_the_ranks_of_every_robot_fit_a_narrow_terminal(references, monkeypatch, capsys):
    write_references(references)
    names = {"trajectory_transformer": [100.0, 120.0], "random": [-220.0, -200.0]}
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")  # 80 columns, no colours
    show_tables([entry(name, dict.fromkeys(ids.ROBOTS, runs), agent=name) for name, runs in names.items()])
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    for robot in (*ids.ROBOTS, "All robots"):
        first, second = (
            r"trajectory_transformer +55\.00 +\[50\.00, 60\.00\] +1",
            r"random +-105\.00 +\[-110\.00, -100\.00\] +2",
        )
        assert re.search(rf"^{robot} +{first}\n +{second}$", shown, re.M)


def test_interquartile_means_and_ranks_by_hand(references):
    write_references(references)
    every = {robot: [100.0, 120.0] for robot in ids.ROBOTS}
    found = rows(
        [
            entry("whole", every),  # scores 50 and 60 on every robot
            entry("same", every | {"Ant": [110.0, 130.0, 0.0]}),  # its third run on Ant counts there alone
            entry("single", every | {"Ant": [200.0]}),
            entry("below", {"Ant": [20.0, 40.0]}),
        ]
    )
    assert found["whole"].cells["Ant"].iqm == Estimate(55.0, (50.0, 60.0))
    assert found["whole"].cells["Ant"].rank == Rank(1, 2)
    assert found["same"].cells["Ant"].rank == Rank(1, 3)
    assert found["below"].cells["Ant"].rank == Rank(2, 3)
    assert found["single"].cells["Ant"].iqm == Estimate(100.0, None)
    assert found["single"].cells["Ant"].rank is None
    assert found["whole"].overall.iqm.value == 55.0
    assert (found["same"].overall.mean, found["same"].overall.runs) == ((4 * 55 + 40) / 5, 2)
    # twenty times 50, five times 55, twenty times 60 and five times 65, without twelve at either end
    assert found["same"].overall.iqm.value == pytest.approx((8 * 50 + 5 * 55 + 13 * 60) / 26)
    assert found["whole"].overall.rank == found["same"].overall.rank == Rank(1, 2)
    assert found["single"].overall.rank is None
    assert found["below"].overall is None


def test_a_random_policy_on_two_robots_stands_below_an_agent_on_one(references):
    write_references(references)
    found = rows(
        [
            entry("a-random", {"Hopper": [-10.0, -20.0], "Ant": [-5.0, 5.0]}),  # scores −5, −10 and −2.5, 2.5
            entry("one-robot", {"Hopper": [80.0, 100.0]}),
            entry("two-robots", {"Hopper": [80.0, 100.0], "Ant": [2.0, 4.0]}),
        ]
    )
    assert list(found) == ["two-robots", "one-robot", "a-random"]


def test_who_knew_the_test_dynamics_is_neither_marked_nor_ranked():
    found = rows(
        [
            entry("expert", {"Ant": [190.0, 200.0]}, format_version=2, privileged="test-dynamics"),
            entry("agent", {"Ant": [20.0, 40.0]}),
        ]
    )
    assert list(found) == ["agent", "expert"]
    assert not found["expert"].cells["Ant"].bold
    assert found["expert"].cells["Ant"].rank is None
    assert found["agent"].cells["Ant"].bold
    assert found["agent"].cells["Ant"].rank == Rank(1, 1)


def test_task_scores_are_on_the_robots_scale_and_in_order_of_seeds():
    scores = task_scores(submission({"Ant": [60.0, 80.0]}))
    assert scores["Ant"].tolist() == [[30.0] * 5, [40.0] * 5]
    shuffled = submission({"Ant": [60.0, 80.0]})
    shuffled = shuffled.model_copy(update={"runs": shuffled.runs[::-1]})
    assert task_scores(shuffled)["Ant"].tolist() == scores["Ant"].tolist()


def test_bold_is_within_one_deviation_of_the_best():
    found = rows(
        [
            entry("best", {"Hopper": [80.0, 100.0, 120.0], "Ant": [10.0]}),  # 50 ± 10
            entry("on-the-line", {"Hopper": [80.0]}),  # 40
            entry("below", {"Hopper": [79.9, 79.9]}),  # 39.95, whatever its own deviation
            entry("own-deviation", {"Hopper": [0.0, 150.0], "Ant": [10.2]}),  # 37.5 ± 53; best on Ant, with one run
        ]
    )
    assert {slug: row.cells["Hopper"].bold for slug, row in found.items()} == {
        "best": True,
        "on-the-line": True,
        "below": False,
        "own-deviation": False,
    }
    assert not found["best"].cells["Ant"].bold
    assert found["own-deviation"].cells["Ant"].bold


def test_higher_sums_then_slugs_come_first(references):
    write_references(references)
    entries = [
        entry("low", {"Hopper": [10.0]}),
        entry("two-robots", {"Hopper": [80.0], "Ant": [20.0]}),
        entry("b-high", {"Hopper": [90.0]}),
        entry("a-high", {"Hopper": [90.0]}),
    ]
    assert list(rows(entries)) == ["two-robots", "a-high", "b-high", "low"]
    assert list(rows(entries[::-1])) == ["two-robots", "a-high", "b-high", "low"]


def test_tracks_and_checkpoints_are_never_in_one_table():
    entries = [
        entry(f"{track}-{checkpoint}", None, track=track, checkpoint=checkpoint)
        for checkpoint in ("best", "last")
        for track in ("adaptation", "zero-shot")
    ]
    tables = standings(entries)
    assert [(table.track, table.checkpoint) for table in tables] == [
        ("zero-shot", "last"),
        ("zero-shot", "best"),
        ("adaptation", "last"),
        ("adaptation", "best"),
    ]
    assert [[row.entry.slug for row in table.rows] for table in tables] == [
        [f"{table.track}-{table.checkpoint}"] for table in tables
    ]
    assert standings([]) == []


def test_partial_is_what_lacks_a_robot_or_a_run(references):
    write_references(references)
    five = [100.0] * 5
    full = dict.fromkeys(ids.ROBOTS, five)
    found = rows(
        [
            entry("full", full),
            entry("more", full | {"Ant": [100.0] * 6}),
            entry("run-missing", full | {"Ant": five[:4]}),
            entry("robot-missing", {robot: five for robot in ids.ROBOTS if robot != "Ant"}),
        ]
    )
    assert [slug for slug, row in found.items() if row.partial] == ["run-missing", "robot-missing"]


def test_each_dynamics_has_its_own_scale():
    # test i: min 10 i, max 100 + 25 i; mean return over the two runs 100
    found = dynamics_scores(submission({"Ant": [80.0, 120.0]}))
    assert found == {"Ant": pytest.approx({f"test{i}": 100 * (100 - 10 * i) / (100 + 15 * i) for i in range(5)})}


def test_the_data_themselves_have_scores_where_they_were_made():
    # the mean of the test dynamics' means is 52, half of it 26
    scores = data_scores()
    assert set(scores) == {"Hopper", "HalfCheetah", "SlimHumanoid", "Ant"}
    assert all(math.isclose(score, 26.0) for score in scores.values())


def test_an_entry_on_a_robot_without_reference_scores_is_an_error():
    with pytest.raises(ValueError, match="no reference scores for Walker"):
        standings([entry("a", {"Walker": [1.0]})])
