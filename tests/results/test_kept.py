"""What is kept of a run, and what is not."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from agents.run_folder import ADAPTATION_CURVE, TARGET_CURVE
from results.kept import compute_times, held_out_curves, keep, keep_compute, kept_errors, kept_runs
from results.tables import by_steps


def test_a_kept_run_has_its_curves_and_no_weights_nor_paths(trained, tmp_path):
    (place,) = keep([trained("dadt", errors=[0.1] * 5)], "reference", tmp_path / "kept")
    assert {path.name for path in place.iterdir()} == {
        "config.json",
        "curves.csv",
        "evaluation.json",
        "prediction.json",
    }
    assert "somebody" not in (place / "config.json").read_text()
    (run,) = kept_runs("reference", tmp_path / "kept")
    assert run.about["command"] == "python -m agents.train dadt --seed 0"
    assert (run.seed, run.step, run.curves["loss"]) == (0, 200, {100: 1.0, 200: 0.5})


@pytest.mark.parametrize("where", ["--runs '/home/somebody/my runs'", "'--runs=/home/somebody/my runs'"])
def test_a_kept_command_tells_no_folder_however_it_is_written(trained, tmp_path, where):
    run = trained("dadt")
    config = json.loads((run / "config.json").read_text())
    config["command"] = f"python -m agents.train dadt {where} --threads=2 --seed 0"
    (run / "config.json").write_text(json.dumps(config))
    (place,) = keep([run], "reference", tmp_path / "kept")
    assert json.loads((place / "config.json").read_text())["command"] == "python -m agents.train dadt --seed 0"


def test_errors_are_grouped_by_agent_and_robot(trained, tmp_path):
    runs = [trained("dadt", seed, errors=[0.1 * (seed + 1)] * 5) for seed in range(2)]
    keep([*runs, trained("mlp", errors=[0.3] * 5)], "reference", tmp_path)
    found = {(one.agent, one.robot): one.values for one in kept_errors(folder=tmp_path)}
    assert np.allclose(found["dadt", "Hopper"], [[0.1] * 5, [0.2] * 5])
    assert found["mlp", "Hopper"].shape == (1, 5)


def test_errors_measured_in_other_data_are_refused(trained, tmp_path):
    places = keep([trained("dadt", seed, errors=[0.1] * 5) for seed in range(2)], "reference", tmp_path)
    record = json.loads((places[0] / "prediction.json").read_text())
    (places[0] / "prediction.json").write_text(json.dumps(record | {"episodes": 10}))
    with pytest.raises(ValueError, match="the errors of dadt on Hopper were measured in different ways"):
        kept_errors(folder=tmp_path)


def test_errors_of_two_agents_are_of_the_same_data(trained, tmp_path):
    places = keep([trained(agent, errors=[0.1] * 5) for agent in ("dadt", "mlp")], "reference", tmp_path)
    record = json.loads((places[1] / "prediction.json").read_text())
    (places[1] / "prediction.json").write_text(json.dumps(record | {"every": 4}))
    with pytest.raises(ValueError, match=r"of dadt and mlp on Hopper .* every and episodes \[1, 200\] and \[4, 200\]"):
        kept_errors(folder=tmp_path)


def test_errors_of_an_earlier_step_are_not_kept(trained, tmp_path):
    run = trained("dadt", errors=[0.1] * 5)
    record = json.loads((run / "prediction.json").read_text())
    (run / "prediction.json").write_text(json.dumps(record | {"gradient_steps": 100}))
    with pytest.raises(ValueError, match=r"is of step 100, the run is at step 200: run agents\.predict again"):
        keep([run], "reference", tmp_path / "kept")
    (run / "prediction.json").unlink()
    (run / "evaluation-train.json").write_text(json.dumps({"gradient_steps": 100}))
    with pytest.raises(ValueError, match=r"is of step 100, the run is at step 200: run agents\.evaluate again"):
        keep([run], "reference", tmp_path / "kept")


def test_two_runs_of_one_name_are_not_kept_in_one_folder(trained, tmp_path):
    run = trained("dadt")
    other = tmp_path / "elsewhere" / run.name
    shutil.copytree(run, other)
    with pytest.raises(ValueError, match=f"two of the runs are called {run.name}"):
        keep([run, other], "reference", tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("commit", ["a" * 40 + "-dirty", None])
def test_only_runs_of_committed_code_are_kept(trained, tmp_path, commit):
    with pytest.raises(ValueError, match="commit the code and train it again"):
        keep([trained("dadt"), trained("dadt", 1, commit=commit)], "reference", tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


def test_only_finished_runs_are_kept(trained, tmp_path):
    run = trained("dadt", steps=300)
    for official in ("evaluation.json", "nothing"):  # killed before the evaluation of its last step, it has none
        with pytest.raises(ValueError, match=r"has a result of step (200|0) of 300: train it to the end first"):
            keep([run], "reference", tmp_path / "kept")
        (run / official).unlink(missing_ok=True)
    with pytest.raises(ValueError, match=r"has a result of step 0 of 200: train it to the end first"):
        keep([trained("mlp")], "reference", tmp_path / "kept")  # whose result is its errors
    # a run may stop between two points of its curve: its errors are then of the step at which it did
    (run / "evaluation.json").write_text(json.dumps({"stopped_early": True, "gradient_steps": 250}))
    (run / "prediction.json").write_text(json.dumps({"gradient_steps": 250}))
    assert keep([run], "reference", tmp_path / "kept")


def test_no_run_no_keeping(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"has no config\.json and curves\.csv"):
        keep([tmp_path], "reference", tmp_path / "kept")


def test_what_a_run_has_lost_is_not_left_from_the_one_it_replaces(trained, tmp_path):
    run = trained("dadt", errors=[0.1] * 5)
    keep([run], "reference", tmp_path / "kept")
    (run / "prediction.json").unlink()
    (place,) = keep([run], "reference", tmp_path / "kept")
    assert {path.name for path in place.iterdir()} == {"config.json", "curves.csv", "evaluation.json"}


@pytest.mark.parametrize("change", [{"steps": 1}, {"batch_size": 7}])
def test_another_run_takes_the_place_only_when_asked(trained, tmp_path, change):
    run = trained("dadt")
    (place,) = keep([run], "reference", tmp_path / "kept")
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(config | {"config": config["config"] | change}))
    record = json.loads((run / "evaluation.json").read_text())
    steps = change.get("steps", config["config"]["steps"])
    (run / "evaluation.json").write_text(json.dumps(record | {"gradient_steps": steps}))
    before = {path.name: path.read_bytes() for path in place.iterdir()}
    with pytest.raises(FileExistsError, match=r"is another run, made by .*: give --replace, or another --group"):
        keep([trained("mlp", errors=[0.1] * 5), run], "reference", tmp_path / "kept")
    assert {path.name: path.read_bytes() for path in place.iterdir()} == before
    assert list(place.parent.glob("[!.]*")) == [place]  # nor is the other run kept
    keep([run], "reference", tmp_path / "kept", replace=True)
    assert {path.name: path.read_bytes() for path in place.iterdir()} != before


def test_an_interruption_leaves_what_was_kept_before(trained, tmp_path, monkeypatch):
    (place,) = keep([trained("dadt", seed=0)], "reference", tmp_path / "kept")
    before = {path.name: path.read_bytes() for path in place.iterdir()}
    other = trained("dadt", seed=1).rename(tmp_path / place.name)

    def stopped(source, target):
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copyfile", stopped)
    with pytest.raises(KeyboardInterrupt):
        keep([other], "reference", tmp_path / "kept", replace=True)
    assert {path.name: path.read_bytes() for path in place.iterdir()} == before


def test_a_run_has_its_name_also_where_it_is_the_working_directory(trained, tmp_path, monkeypatch):
    run = trained("dadt")
    monkeypatch.chdir(run)
    (place,) = keep([Path()], "reference", tmp_path / "kept")
    assert place == tmp_path / "kept" / "runs" / "reference" / run.name


def test_mistakes_end_in_one_line_and_keep_nothing(trained, tmp_path):
    run = trained("dadt")
    with pytest.raises(ValueError, match="no run is given"):
        keep([], "reference", tmp_path / "kept")
    with pytest.raises(ValueError, match=r"the group is '\.\./out': give words in small letters"):
        keep([run], "../out", tmp_path / "kept")
    (run / "config.json").write_text("{}")
    with pytest.raises(ValueError, match=r"config\.json tells no agent, config and settings"):
        keep([run], "reference", tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(("curve", "of", "at"), [(ADAPTATION_CURVE, "steps", "0"), (TARGET_CURVE, "asked", "0.0")])
def test_curves_in_held_out_dynamics_by_run(curve, of, at, trained, tmp_path):
    run = trained("dadt", settings={"hold_out": 4})
    (run / curve).write_text(f"{of},mean_return,train16,train17\n{at},300.5,300,301\n100,310,300,320\n")
    keep([run], "chosen", tmp_path / "kept")
    assert held_out_curves("chosen", curve, tmp_path / "kept") == {run.name: {0: 300.5, 100: 310.0}}


def test_targets_that_lie_close_are_two_points(trained, tmp_path):
    run = trained("dt", settings={"hold_out": 4})
    (run / TARGET_CURVE).write_text("target_return,mean_return\n1.5,10\n1.75,20\n1000000.0,30\n")
    keep([run], "chosen", tmp_path / "kept")
    curves = held_out_curves("chosen", TARGET_CURVE, tmp_path / "kept")
    assert curves == {run.name: {1.5: 10.0, 1.75: 20.0, 1e6: 30.0}}
    assert by_steps(curves, of="asked for").splitlines()[0] == "| asked for | 1.5 | 1.75 | 1,000,000 |"


def test_times_of_the_compute_benchmark(tmp_path):
    seconds = {"test_gradient_steps": {"dadt": 0.1, "dt": 0.05}, "test_acting_in_ten_episodes": {"dadt": 0.01}}
    runs = [
        {
            "name": name,
            "fullname": f"tests/benchmarks/test_compute.py::{name}",
            "extra_info": {"seconds": seconds[name]},
        }
        for name in seconds
    ]
    runs.append({"name": "test_other", "fullname": "tests/benchmarks/test_other.py::test_other", "extra_info": {}})
    file = tmp_path / "run.json"
    file.write_text(json.dumps({"benchmarks": runs}))
    keep_compute(file, tmp_path)
    assert compute_times(tmp_path) == seconds
    for other in (json.dumps({"benchmarks": runs[1:]}), "{}", '{"benchmarks": [{}]}', "no JSON"):
        file.write_text(other)
        with pytest.raises(ValueError, match=r"no whole run of tests/benchmarks/test_compute\.py"):
            keep_compute(file, tmp_path)
    assert compute_times(tmp_path / "elsewhere") == {}
