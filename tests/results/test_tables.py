"""Hand-computed cells: time and energy of runs and of the paper's budget."""

from agents.summary.runs import read_runs
from results import tables
from results.kept import keep, kept_runs


def cells(markdown, line):
    """The cells of a line of a table, counted from the header."""
    return [cell.strip() for cell in markdown.splitlines()[line].strip("|").split("|")]


def test_the_papers_budget_in_hours_and_kilowatt_hours():
    found = tables.cost({"dadt": 0.36})
    # 1M steps of 0.36 s are 100 hours; 25 such runs 2,500; at 360 W / 96 cores 9.375 kWh
    assert cells(found, 2) == ["dadt", "0.360", "100", "2,500", "100", "9.4"]
    two = tables.cost({"merpo": 0.36, "merpo, last phase": 0.72})  # half of the steps in each phase
    assert [cells(two, 2), len(two.splitlines())] == [["merpo", "0.540", "150", "3,750", "150", "14.1"], 3]


def test_time_and_energy_of_a_run_are_means_over_its_seeds(trained, tmp_path):
    runs = [trained("dadt", seed) for seed in range(2)]
    for run, seconds in zip(runs, (3600, 7200), strict=True):
        (run / "curves.csv").write_text(f"step,loss,seconds\n100,1.0,30\n200,0.5,{seconds}\n")
    keep(runs, "reference", tmp_path / "kept")
    found = dict(
        zip(*(cells(tables.training(kept_runs("reference", tmp_path / "kept")), i) for i in (0, 2)), strict=True)
    )
    assert found["seeds"] == "0, 1"
    assert found["wall clock"] == "90.0 min"
    assert found["energy"] == "5.62 Wh"  # 1.5 hours at 3.75 W


def test_a_part_of_the_data_is_told(trained, tmp_path):
    keep([trained("dadt", settings={"quality": 0.3, "hold_out": 4})], "reference", tmp_path / "kept")
    assert cells(tables.training(kept_runs("reference", tmp_path / "kept")), 2)[6] == "quality 0\\.3, hold-out 4"


def test_what_follows_the_steps_is_not_told_as_changed(trained, tmp_path):
    # half of 200 steps are MerPO's first phase if nothing is said; half of its usual 20,000 are then a change
    for seed, first, told in ((0, 100, "–"), (1, 10_000, "model-steps 10000")):
        folder = tmp_path / f"kept{seed}"
        keep([trained("merpo", seed, model_steps=first)], "reference", folder)
        assert told in cells(tables.training(kept_runs("reference", folder)), 2)[6]


def test_each_run_ends_at_its_own_step(trained):
    runs = [trained("dadt", seed, settings={"hold_out": 4}) for seed in range(2)]
    for run, points in zip(runs, ((100, 200), (100, 200, 400)), strict=True):  # patience has ended the first
        lines = [f"{100 * (n + 1)},1,0.5,{value}" for n, value in enumerate(points)]
        (run / "curves.csv").write_text("\n".join(["step,loss,validation_loss,validation_return", *lines]) + "\n")
    found = cells(tables.held_out(read_runs(runs[0].parent)), 2)
    assert found[2].startswith("300 ")  # 200 and 400
