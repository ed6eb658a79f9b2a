"""docs/results.md: every table, from kept runs and a board; the same bytes again; drawings that are XML."""

import json
import re
import xml.etree.ElementTree as ElementTree

import pytest

import results.__main__ as command
from agents import AGENTS
from agents.summary.intervals import MeanEstimate
from agents.summary.runs import read_runs
from leaderboard.board import submit
from results.figures import error_bars, learning_curves
from results.kept import beside_reference, keep
from results.page import PAGE, pages
from results.tables import noise, training
from tests.evaluation.samples import traced


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """A board with an entry of DADT and one of Decision Transformer: random actions, replayed."""
    folder = tmp_path_factory.mktemp("board")
    for apart, agent in enumerate(("dadt", "dt")):
        traced(folder / agent, seeds=(0, 1), apart=10 * apart, agent=agent)
    return folder


@pytest.fixture
def made(board, trained, tmp_path):
    """The pages of that board and of some kept runs."""
    for agent in ("dadt", "dt"):
        submit(board / agent, tmp_path / "board")
    runs = [trained("dadt", n, errors=[0.02] * 5, score=40.0 + n, next_state_weight=0.05) for n in range(2)]
    keep([*runs, trained("mlp", errors=[0.5] * 5)], "reference", tmp_path / "kept")
    pilot = trained("dadt", settings={"hold_out": 4}, learning_rate=3e-4)
    (pilot / "curves.csv").write_text("step,loss,validation_loss,validation_return\n100,1,0.5,300\n200,1,0.25,320\n")
    (pilot / "adaptation-curve.csv").write_text("steps,mean_return\n0,300\n500,310.25\n")
    keep([pilot], "learning-rate", tmp_path / "kept")
    asked = trained("dt", settings={"hold_out": 4}, target_return=7.0)
    (asked / "target-curve.csv").write_text("target_return,mean_return\n565.0,301\n1130.0,290.5\n")
    keep([asked], "target-return", tmp_path / "kept")
    for robot, value in (("Hopper", 310), ("Ant", 90)):
        early = trained("dadt", robot=robot, settings={"hold_out": 4})
        (early / "curves.csv").write_text(f"step,validation_return,test_score\n100,{value},12\n200,320,13.5\n")
        keep([early], "first-steps", tmp_path / "kept")
    learned = {"agent": "dadt", "robot": "Hopper", "gradient_steps": 200, "dynamics": ["train0", "train1"]}
    learned |= {"trained": [300, 310], "untrained": [20, 30], "random": [10, 11]}
    (tmp_path / "kept/runs/reference/dadt/evaluation-train.json").parent.mkdir()
    (tmp_path / "kept/runs/reference/dadt/evaluation-train.json").write_text(json.dumps(learned))
    low = [trained("dadt", seed, score=20.0 + 2 * seed, settings={"quality": 0.3}) for seed in range(2)]
    keep([*low, trained("merpo", score=5.0, settings={"quality": 0.3})], "low-quality", tmp_path / "kept")
    weights = [trained("dadt", seed, score=30.0 + 4 * seed, next_state_weight=0.1) for seed in range(2)]
    keep(weights, "next-state-weight", tmp_path / "kept")
    acting = {"dadt": 0.01, "focal": 0.001}
    times = {"test_gradient_steps": {"dadt": 0.1, "focal": 0.5}, "test_acting_in_ten_episodes": acting}
    (tmp_path / "kept" / "compute.json").write_text(json.dumps(times))
    return pages(tmp_path / "board", tmp_path / "kept")


def test_the_page_has_every_part(made):
    page = made[PAGE]
    assert "| DADT | – | " in page
    assert "(2 runs)" in page
    assert "| *DADT, the paper* | 61.12 ± 4.99 | 74.69 ± 4.22 |" in page
    assert "| DADT | – | 0.02 ± 0 (2 runs) | – | – | – |" in page
    assert "| MLP | – | 0.5 (1 run) | – | – | – |" in page
    assert "| no change: the present state | – | 0.09 | – | – | – |" in page
    assert "| *DT+, the paper* | 0.2314 ± 0.0050 |" in page
    assert "| dadt | Hopper | 320 | 310 | 0.25 |" in page  # at the end, over the curve, loss at the end
    assert "| focal | 0.500 | 5.00 |" in page
    assert "| dadt | 2.000 | 1.00 |" in page  # 200 steps of 0.01 s
    assert "| dadt | 0.100 | 28 | 694 | 28 |" in page  # a million steps of 0.1 s are 27.8 hours
    assert "| 300.0 | 310.2 |" in page
    assert "highest return of an episode in our data: Hopper 1,000 (1,000)." in page.replace("\n", " ")
    assert "| asked for | 565 | 1,130 |" in page
    assert "| 301.0 | 290.5 |" in page
    assert "| dadt | 300.0 | 320.0 |" in page  # return by gradient steps
    assert "| dadt | 0.5000 | 0.2500 |" in page
    first_steps = page.split("## The first thousand steps")[1]
    assert "| Ant, dadt | 90.0 | 320.0 |" in first_steps
    assert "| Hopper, dadt | 310.0 | 320.0 |" in first_steps
    assert "| Hopper, dadt | 12.0 | 13.5 |" in first_steps
    assert "| DADT | Hopper | 1 | 200 | 2 | 305 | 25 | 10.5 |" in page
    assert "0.001 after 500 steps of warm-up" in page


def test_scores_within_a_run_stand_beside_those_between_runs(trained):
    for seed, scores in enumerate(([0, 50, 52, 54, 56], [0, 30, 30, 30, 30])):
        folder = trained("dadt", seed)
        lines = (f"{100 * number},{score}\n" for number, score in enumerate(scores))
        (folder / "curves.csv").write_text("step,test_score\n" + "".join(lines))
    # 50, 52, 54, 56 have the sample standard deviation √(20/3) = 2.58, the constant run has 0; 56 and 30 have 18.4
    assert "| DADT | – | 1.3 / 18.4 | – | – | – |" in noise(read_runs(folder.parent))
    (folder / "curves.csv").write_text("step,test_score\n0,1\n100,2\n200,3\n")
    assert noise(read_runs(folder.parent)) == ""  # at the steps that both have there are too few


def test_a_schedule_of_the_learning_rate_is_told(trained):
    folder = trained("dt", decay_steps=100)
    assert "| 0.001 after 500 steps of warm-up, falling to 0 in the last 100 |" in training(read_runs(folder.parent))


def test_low_quality_data_and_weights_stand_beside_what_they_are_compared_with(made):
    lines = made[PAGE].splitlines()
    place = lines.index("| DADT | – | 21.00 ± 1.41 (2 runs) | – | – | – |")  # 20 and 22
    on_all_data = lines[place + 1]
    assert on_all_data.startswith("| on all data | – | ")
    score = float(on_all_data.split("|")[3].split("±")[0])
    assert f"| DADT | – | {score:.2f} ± " in made[PAGE]  # as on the board
    assert "| MerPO | – | 5 (1 run) | – | – | – |" in lines  # no entry of the board to stand beside
    assert "| 0.1 | – | 32.00 ± 2.83 (2 runs) | – | – | – | 45.97 ± 20.93 |" in lines
    reference = "| 0.05 | – | 40.500 ± 0.707 (2 runs) | – | – | – | 46.17 ± 20.74 |"  # these runs are kept once
    assert reference in lines
    assert "| 1.0 | – | – | – | – | – | 44.10 ± 19.55 |" in lines


def test_all_that_was_run_is_listed(made):
    told = made[PAGE].split("## What was run")[1]
    for part in ("On low-quality data:", "By the weight of the next state's error:"):
        assert "| dadt | Hopper | 0, 1 | 200 | 64 | 0.001 " in told.split(part)[1]


def test_only_reference_runs_that_differ_in_nothing_else_stand_beside_a_weight(trained):
    folder = trained("dadt", next_state_weight=0.1)
    for weight, changes in ((0.05, {}), (0.5, {}), (0.05, {"learning_rate": 3e-4})):
        trained("dadt", 1, next_state_weight=weight, **changes)
    first, *others = read_runs(folder.parent)
    found = beside_reference([first], others, "next_state_weight")
    assert found == [first, *others[:2]]


@pytest.mark.parametrize(
    ("seeds", "changes", "message"),
    [
        ((0, 1), {"decay_steps": 50}, "differ in decay_steps: keep one of them in a group of its own"),
        ((1, 1), {}, "of the group 'reference' have the same seed: keep one of them"),
    ],
)
def test_what_is_no_other_seed_of_a_run_is_not_taken_for_one(trained, tmp_path, seeds, changes, message):
    (tmp_path / "board").mkdir()
    keep([trained("dadt", seeds[0]), trained("dadt", seeds[1], **changes)], "reference", tmp_path / "kept")
    with pytest.raises(ValueError, match=message):
        pages(tmp_path / "board", tmp_path / "kept")


def test_runs_of_several_commits_tell_all_of_them(trained):
    trained("dt", 0)
    folder = trained("dt", 1, commit="b" * 40)
    assert "| `aaaaaaa`, `bbbbbbb` |" in training(read_runs(folder.parent))


def test_the_drawings_are_in_the_page_and_are_xml(made):
    drawings = {name: text for name, text in made.items() if name != PAGE}
    assert set(drawings) == {"results/hopper-curves.svg", "results/hopper-errors.svg"}
    for name, text in drawings.items():
        assert f"]({name})" in made[PAGE]
        ElementTree.fromstring(text)


def test_an_empty_board_and_no_runs_make_a_page(tmp_path):
    (tmp_path / "board").mkdir()
    made = pages(tmp_path / "board", tmp_path / "kept")
    assert list(made) == [PAGE]
    assert made[PAGE].count("**not run**") == 11


def test_check_sees_a_page_that_is_stale(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "DOCS", tmp_path)
    monkeypatch.setattr(command, "pages", lambda: {PAGE: "old", "results/a.svg": "drawing"})
    command.main(["build"])
    command.main(["build", "--check"])
    assert (tmp_path / "results" / "a.svg").read_text() == "drawing"
    monkeypatch.setattr(command, "pages", lambda: {PAGE: "new", "results/a.svg": "drawing"})
    with pytest.raises(SystemExit, match=r"results\.md is stale: run `python -m results build`"):
        command.main(["build", "--check"])
    assert (tmp_path / PAGE).read_text() == "old"
    monkeypatch.setattr(command, "pages", lambda: {PAGE: "old"})
    with pytest.raises(SystemExit, match=r"a\.svg is a drawing of nothing that is kept: run"):
        command.main(["build", "--check"])
    command.main(["build"])
    assert not (tmp_path / "results" / "a.svg").exists()


def test_a_point_of_a_curve_lies_where_it_should():
    # scores 0 and 100 have a margin of 4 % on either side: 100 is 4/108 below the top of the 240 units
    drawing = learning_curves("Hopper", {"dt": [{0: 0.0, 100: 100.0}, {0: 0.0, 100: 0.0}]}).svg
    lines = [part for part in drawing.splitlines() if "polyline" in part]
    assert [line.count('class="run') for line in lines] == [1, 1, 0]
    for line, end in zip(lines, ("8.88", "231.12", "120"), strict=True):
        assert f'points="0,231.12 560,{end}"' in line


def test_a_run_that_was_measured_once_is_a_point():
    drawing = learning_curves("Hopper", {"dt": [{0: 0.0, 100: 100.0}], "merpo": [{50: 50.0}]}).svg
    assert '<circle class="fill4" cx="280" cy="120" r="3"/>' in drawing


def test_an_agent_has_one_colour_on_every_drawing():
    for agents in (["dadt", "transformer_bc"], ["transformer_bc"], list(AGENTS)):
        drawing = learning_curves("Hopper", {agent: [{0: 0.0, 100: 50.0}] for agent in agents}).svg
        assert 'class="line stroke6"' in drawing
        assert drawing.count('class="line') == len({*re.findall(r'class="line (stroke\d+)"', drawing)}) == len(agents)


def test_what_has_to_be_beaten_is_a_line():
    # from 0.1 / 1.5 to 10 · 1.5 there are 2.352 powers of ten, 1 lies in their middle
    drawing = error_bars(
        "Hopper", {"lstm": MeanEstimate(0.1, None, None), "dt": MeanEstimate(10.0, None, None)}, unchanged=1.0
    ).svg
    assert f'd="M0 120H{560}"' in drawing
    assert "no change, 1" in drawing


def test_names_are_escaped():
    robot, errors = (
        'A "<b>" & B',
        {"<b>": MeanEstimate(0.1, None, None), "lstm": MeanEstimate(0.01, 0.001, (0.005, 0.015))},
    )
    for drawing in (error_bars(robot, errors), learning_curves(robot, {"<b>": [{0: 0.0, 100: 50.0}]})):
        assert drawing.title.startswith(f"{robot}: ")
        assert "<b>" not in drawing.svg
        root = ElementTree.fromstring(drawing.svg)
        assert root.attrib["aria-label"] == root.findtext("{http://www.w3.org/2000/svg}title") == drawing.title
