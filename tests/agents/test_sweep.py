"""Sweeps: what lines stand for, what is refused, and that a killed one goes on to the same results."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from agents import predict, train
from agents.checkpoint import load_checkpoint
from agents.learner import Learner
from agents.summary.runs import read_runs
from agents.sweep import main, read_lines, sweep, train_one
from agents.sweep_plan import is_finished, plan
from dynagen_bench.datasets import load_dataset
from dynagen_bench.jobs import Job

ROOT = Path(__file__).parents[2]
TINY = (
    "--layers 1 --heads 1 --embedding 8 --context 4 --batch-size 4 --warmup-steps 5 --learning-rate 1e-3 "
    "--precision float32 --checkpoint-every 10 --log-every 10 --evaluate-every 0"
)


def names(*lines):
    return [one.name for one in plan(lines)]


def test_folders_tell_what_braces_choose():
    assert names("{dadt,dt} --robot {Hopper,Ant} --seed {0,1}") == [
        f"{agent}-{robot}-seed{seed}" for agent in ("dadt", "dt") for robot in ("Hopper", "Ant") for seed in (0, 1)
    ]
    assert names("dadt --robot Hopper --steps 50 --next-state-weight {0.05,1.0} --every 2 --dropout=0.2") == [
        "dadt-Hopper-seed0-every2-next-state-weight0.05",
        "dadt-Hopper-seed0-every2-next-state-weight1.0",
    ]
    assert names("dadt --robot Hopper {,--dropout=0} --batch_size {8,9}") == [
        f"dadt-Hopper-seed0{dropout}-batch-size{size}" for dropout in ("", "-dropout0") for size in (8, 9)
    ]
    assert names("dt --robot Hopper", "dt --robot Hopper --seed {1..3}") == [f"dt-Hopper-seed{n}" for n in range(4)]


def test_a_run_keeps_its_config_and_its_command():
    (one,) = plan(["dt_plus --robot HalfCheetah --seed 3 --steps 50"])
    assert one.command == "python -m agents.train dt_plus --robot HalfCheetah --seed 3 --steps 50"
    arguments = one.job.arguments
    assert (arguments["agent"], arguments["command"]) == ("dt_plus", one.command)
    assert (arguments["config"]["trunk_steps"], arguments["config"]["target_return"]) == (25, 1500.0)  # resolved
    assert (arguments["settings"]["seed"], arguments["settings"]["threads"]) == (3, 1)
    assert one.job.total == 50
    assert "dt_plus-HalfCheetah-seed3/evaluation.json" in one.job.outputs
    (predictor,) = plan(["mlp --robot Hopper"])
    assert predictor.job.outputs[-1] == "mlp-Hopper-seed0/prediction.json"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "no runs given"),
        (["dt --robot Hoper"], "in 'dt --robot Hoper': unknown robot 'Hoper'.*did you mean 'Hopper'"),
        (["dt --robot Hopper --droput {0,0.1}"], r"'dt --robot Hopper --droput 0' is no command line.*--droput"),
        (["dt --robot Hopper --steps {1,x}"], "'dt --robot Hopper --steps x' is no command line.*invalid literal"),
        (["{nobody} --robot Hopper"], r"'\{nobody\} --robot Hopper': unknown agent '.nobody.': choose one of dadt"),
        (["dt --help"], "'dt --help' is no command line"),
        (["dt --robot 'Hopper"], "No closing quotation"),
        (["dt --robot Hopper --name {a,b}"], "--name is the sweep's to choose"),
        (["dt --robot Hopper --runs elsewhere"], "--runs is the sweep's to choose"),
        (["dt --robot Hopper --threads 2"], "--threads is the sweep's to choose"),
        (["dt --robot Hopper", "dt --robot Hopper --seed {1,0}"], "the same run twice, '.*Hopper' and '.*--seed 0'"),
        (["dt --robot Hopper --dropout {0.1,0.10}"], "the same run twice"),
        (["dt --robot Hopper", "dt --robot Hopper --dropout 0"], "dt-Hopper-seed0 would be the folder of both"),
        (["dt --robot Hopper --seed {0..100000}"], "stands for more than 10,000 runs"),
    ],
)
def test_bad_lines_are_refused_in_one_line_before_anything_starts(lines, message, tmp_path):
    with pytest.raises(ValueError, match=message) as caught:
        sweep(["dt --robot Ant --seed 9", *lines] if lines else [], tmp_path / "runs")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "runs").exists()


def test_the_sweeps_of_the_repository_are_what_they_say():
    files = {path.stem: plan(read_lines(path)) for path in (ROOT / "sweeps").glob("*.txt")}
    weights = files["next_state_weight"]
    assert {(one.agent, one.settings.robot, one.config.steps) for one in weights} == {("dadt", "Hopper", 5_000)}
    assert {one.job.arguments["config"]["next_state_weight"] for one in weights} == {0.01, 0.1, 0.5, 1.0}
    assert len(weights) == 12
    assert len(files["reference"]) == 100
    assert {one.config.steps for one in files["reference"]} == {1_000_000}


def parameters(folder):
    return load_checkpoint(folder / "last.safetensors").parameters


@pytest.mark.slow  # each run is a process that imports torch
@pytest.mark.usefixtures("tiny_data")
def test_a_killed_sweep_goes_on_and_ends_as_one_that_was_not(tmp_path, capsys):
    line = f"{{dadt,dt}} --robot Hopper --seed {{0,1}} --steps 150 {TINY}"
    load_dataset("Hopper")
    runs, planned = tmp_path / "runs", plan([line])
    command = [sys.executable, "-m", "agents.sweep", line, "--runs", str(runs), "--processes", "2"]
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
        results, begun = "*/evaluation.json", ".jobs/*/*/last.safetensors"
        deadline = time.monotonic() + 600  # a hang, and no slow machine
        while not (any(runs.glob(results)) and any(runs.glob(begun))):
            assert process.poll() is None, (tmp_path / "log").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.wait()
    finished = [path.parent for path in runs.glob(results)]
    assert 0 < len(finished) < 4
    done = {file: file.stat().st_mtime_ns for folder in finished for file in folder.iterdir()}

    main([line, "--runs", str(runs), "--processes", "2"])
    assert f"runs in {runs}: 4," in capsys.readouterr().out
    assert all(path.stat().st_mtime_ns == before for path, before in done.items())  # not done again
    for one in planned:
        train_one(tmp_path / "whole", lambda step: None, **one.job.arguments)
        for place in (runs, tmp_path / "whole"):
            assert {file.name for file in (place / one.name).iterdir()} >= {
                Path(output).name for output in one.job.outputs
            }
        cut, whole = parameters(runs / one.name), parameters(tmp_path / "whole" / one.name)
        assert all(torch.equal(cut[key], whole[key]) for key in whole)
        about = json.loads((runs / one.name / "config.json").read_text())
        assert (about["command"], "runs" in about["settings"]) == (one.command, False)
    assert [run.name for run in read_runs(runs)] == sorted(one.name for one in planned)
    assert "dadt-Hopper-seed1" in (runs / "summary.html").read_text()

    before = (runs / "summary.html").read_bytes()
    main([line, "--runs", str(runs)])  # nothing is left to do
    assert (runs / "summary.html").read_bytes() == before


@pytest.mark.usefixtures("tiny_data")
def test_a_run_that_agents_train_is_at_is_not_taken_from_it(tmp_path):
    line = f"transformer_bc --robot Hopper --steps 20 {TINY}"
    train.main([*line.split(), "--runs", str(tmp_path)])
    folder = tmp_path / "transformer_bc-Hopper-seed0"
    (folder / "evaluation.json").unlink()
    before = {path: path.read_bytes() for path in folder.glob("*.*")}
    with pytest.raises(SystemExit, match=r"was begun by agents\.train and is not finished: go on with `python -m"):
        main([line, "--runs", str(tmp_path)])
    assert {path: path.read_bytes() for path in folder.glob("*.*")} == before
    train.main([*line.split(), "--runs", str(tmp_path)])  # as it says
    main([line, "--runs", str(tmp_path)])


@pytest.mark.usefixtures("tiny_data")
def test_a_run_that_agents_train_has_finished_is_not_run_again(tmp_path, capsys):
    line = f"transformer_bc --robot Hopper --steps 20 {TINY}"
    train.main([*line.split(), "--runs", str(tmp_path)])
    config = tmp_path / "transformer_bc-Hopper-seed0" / "config.json"
    about = json.loads(config.read_text())
    assert about["command"].startswith(f"python -m agents.train {line} --runs ")
    del about["settings"]["quality"], about["config"]["dropout"]  # older than these
    config.write_text(json.dumps(about))
    main([line, "--runs", str(tmp_path)])
    assert capsys.readouterr().out.endswith(f"runs in {tmp_path}: 1, their curves in {tmp_path / 'summary.html'}\n")
    assert not (tmp_path / ".jobs").exists()
    with pytest.raises(SystemExit, match=r"is of another run, steps is 20 there and 21 here: give another --runs"):
        main([line.replace("--steps 20", "--steps 21"), "--runs", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"is of another run, embedding is 8 there and 9 here"):
        main([line.replace("--embedding 8", "--embedding 9"), "--runs", str(tmp_path)])


@pytest.mark.usefixtures("tiny_data")
def test_a_predictor_that_was_measured_on_the_way_is_not_finished(tmp_path, monkeypatch):
    line = "mlp --robot Hopper --steps 4 --context 4 --batch-size 4 --checkpoint-every 2 --log-every 1"
    update = Learner.update

    def stopped(self, sampler):
        if self.step == 3:
            raise KeyboardInterrupt
        return update(self, sampler)

    (one,) = plan([line])
    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", stopped)
        with pytest.raises(SystemExit):
            train.main([*line.split(), "--runs", str(tmp_path)])
    predict.main([str(tmp_path / one.name)])
    assert all((tmp_path / output).is_file() for output in one.job.outputs)
    with pytest.raises(ValueError, match="is not finished"):
        is_finished(one, tmp_path)
    train.main([*line.split(), "--runs", str(tmp_path)])
    assert is_finished(one, tmp_path)


@pytest.mark.usefixtures("tiny_data")
def test_a_run_that_fails_is_named_and_the_page_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "agents.sweep_plan.SweepRun.job", property(lambda one: Job(one.name, "os:abort", {}, (one.name,), 1))
    )
    with pytest.raises(SystemExit) as stop:
        main([f"dt --robot Hopper {TINY}", "--runs", str(tmp_path), "--processes", "1"])
    assert "\n" not in str(stop.value)
    assert str(stop.value).startswith("error: 1 of 1 jobs failed, run the same again to repeat them: dt-Hopper-seed0")
    assert "There are no runs yet." in (tmp_path / "summary.html").read_text()


def test_a_page_that_cannot_be_made_hides_no_failed_run(tmp_path, monkeypatch):
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "config.json").write_text("{}")
    (tmp_path / "damaged" / "curves.csv").write_text("step\n")

    def failing(*arguments, **options):
        raise RuntimeError("1 of 1 jobs failed")

    monkeypatch.setattr("agents.sweep.run_jobs", failing)
    monkeypatch.setattr("agents.sweep.load_dataset", lambda *arguments, **options: None)
    with pytest.raises(RuntimeError, match="1 of 1 jobs failed"):
        sweep(["dt --robot Hopper"], tmp_path)


def test_a_file_of_lines_has_comments_and_needs_to_be_there(tmp_path):
    (tmp_path / "lines.txt").write_text("# two\n\ndt --robot Hopper\n  dadt --robot Ant # not one\n")
    assert read_lines(tmp_path / "lines.txt") == ["dt --robot Hopper", "dadt --robot Ant # not one"]
    with pytest.raises(SystemExit, match=r"error: no file .*none\.txt: give one with a command line"):
        main(["--jobs-file", str(tmp_path / "none.txt")])


@pytest.mark.parametrize(("commit", "warned"), [("a" * 40 + "-dirty", True), ("a" * 40, False), (None, False)])
def test_changed_files_are_warned_of_before_anything_runs(commit, warned, monkeypatch, capsys):
    monkeypatch.setattr("agents.sweep.git_commit", lambda: commit)
    with pytest.raises(SystemExit, match="error: "):
        main([])  # no run is named
    assert ("nobody can make these runs again" in capsys.readouterr().err) is warned
