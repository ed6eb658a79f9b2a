"""The training loop: what a run leaves, and that stopping it changes nothing."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.learner import Learner
from agents.run_folder import ADAPTATION_CURVE, LEARNED, TARGET_CURVE, RunSettings, claimed, read_finished, write_json
from agents.train import main, train
from dynagen_bench.datasets import WindowSampler, load_dataset
from dynagen_bench.evaluation import Evaluation, evaluate, reset_seeds
from tests.agents.samples import K, hopper_spec, random_dataset, tiny_config

TINY_FLAGS = "--layers 2 --heads 2 --embedding 16 --context 5 --batch-size 8 --warmup-steps 5 --learning-rate 1e-3"


def settings(tmp_path, **changes) -> RunSettings:
    given = {"robot": "Hopper", "runs": tmp_path, "evaluate_every": 10, "checkpoint_every": 4, "log_every": 2}
    return RunSettings(**(given | changes))


def parameters(folder, file="last.safetensors"):
    return load_checkpoint(folder / file).parameters


def same(one, other) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def curves(folder):
    with (folder / "curves.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_leaves_curves_checkpoints_and_the_official_evaluation(name, tmp_path):
    folder = train(name, tiny_config(name), settings(tmp_path), random_dataset())
    assert folder == tmp_path / f"{name}-Hopper-seed0"
    rows = curves(folder)
    assert [int(row["step"]) for row in rows] == list(range(2, 21, 2))
    assert [row["step"] for row in rows if row["test_return"]] == ["10", "20"]
    assert float(rows[0]["learning_rate"]) == pytest.approx(0.4e-3)
    assert {"loss", "action_loss", "gradient_norm", "seconds"} <= rows[0].keys()
    assert any("tfevents" in file.name for file in (folder / "tensorboard").iterdir())

    record = json.loads((folder / "evaluation.json").read_text())
    assert (record["agent"], record["seed"], record["gradient_steps"]) == (name, 0, 20)
    evaluation = Evaluation.from_json(record["evaluation"])
    assert np.array_equal(evaluation.seeds, reset_seeds("Hopper", "test", range(5)))
    again = evaluate(load_checkpoint(folder / "last.safetensors").build_agent().policy(), "Hopper")
    assert np.array_equal(again.returns, evaluation.returns)

    best = json.loads((folder / "evaluation-best.json").read_text())
    means = {row["step"]: float(row["test_return"]) for row in rows if row["test_return"]}
    assert str(best["gradient_steps"]) == max(means, key=means.__getitem__)
    assert load_checkpoint(folder / "best.safetensors").step == best["gradient_steps"]
    config = json.loads((folder / "config.json").read_text())
    assert config["config"]["batch_size"] == tiny_config(name).batch_size
    assert config["config"].get("target_return", 1000.0) == 1000.0  # the robot's, filled in
    assert not [file for file in os.listdir(folder) if file.endswith(".unfinished")]


def test_a_run_stopped_at_any_step_ends_as_one_that_was_not(name, tmp_path, monkeypatch):
    whole = train(name, tiny_config(name), settings(tmp_path / "whole"), random_dataset())
    update, stops = Learner.update, [3, 9, 15]

    def stopped(self, sampler):
        if stops and self.step == stops[0]:
            stops.pop(0)
            raise KeyboardInterrupt
        return update(self, sampler)

    monkeypatch.setattr(Learner, "update", stopped)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            train(name, tiny_config(name), settings(tmp_path / "cut"), random_dataset())
    cut = train(name, tiny_config(name), settings(tmp_path / "cut"), random_dataset())
    assert same(parameters(whole), parameters(cut))
    assert same(parameters(whole, "best.safetensors"), parameters(cut, "best.safetensors"))
    assert [{**row, "seconds": ""} for row in curves(whole)] == [{**row, "seconds": ""} for row in curves(cut)]


def test_more_steps_continue_a_finished_run_and_fewer_are_refused(tmp_path):
    whole = train("dt", tiny_config("dt", steps=12), settings(tmp_path / "whole"), random_dataset())
    for steps in (6, 12, 12):
        folder = train("dt", tiny_config("dt", steps=steps), settings(tmp_path / "more"), random_dataset())
        assert json.loads((folder / "evaluation.json").read_text())["gradient_steps"] == steps
    assert same(parameters(whole), parameters(folder))
    before = contents(folder)
    with pytest.raises(ValueError, match="is at step 12 already: give --steps 12 or more"):
        train("dt", tiny_config("dt", steps=6), settings(tmp_path / "more"), random_dataset())
    assert contents(folder) == before


def test_a_run_goes_on_with_no_other_data_of_the_same_size(tmp_path):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())
    other = random_dataset()
    moved = dataclasses.replace(other, observations=5 * other.observations + 3)
    before = contents(folder)
    with pytest.raises(ValueError, match="is of another run, its data had observations of another mean or deviation"):
        train("dt", tiny_config("dt", steps=4), settings(tmp_path), moved)
    assert contents(folder) == before


def test_a_kill_while_the_best_result_is_written_leaves_none_of_two_steps(tmp_path, monkeypatch):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())
    file = folder / "evaluation-best.json"
    record = json.loads(file.read_text())
    record["evaluation"]["returns"] = np.full((5, 10), -1000.0).tolist()  # whatever comes is better
    file.write_text(json.dumps(record))

    def stopped(path, content):
        if path == file:
            raise KeyboardInterrupt
        write_json(path, content)

    with monkeypatch.context() as patch:
        patch.setattr("agents.recording.write_json", stopped)
        with pytest.raises(KeyboardInterrupt):
            train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    assert not file.exists()
    train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    assert load_checkpoint(folder / "best.safetensors").step == json.loads(file.read_text())["gradient_steps"] == 4


def test_a_target_is_a_number_of_any_kind(tmp_path):
    train("dt", tiny_config("dt", steps=1, target_return=1000), settings(tmp_path), random_dataset())


def test_what_was_measured_at_an_earlier_step_goes_when_the_run_goes_on(tmp_path):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())
    for name in (LEARNED, ADAPTATION_CURVE, TARGET_CURVE):
        (folder / name).write_text("of step 2")
    train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())  # complete: it stays as it is
    assert (folder / LEARNED).is_file()
    train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    assert not [name for name in (LEARNED, ADAPTATION_CURVE, TARGET_CURVE) if (folder / name).exists()]


def test_a_kill_between_result_and_curves_loses_no_point(tmp_path):
    folder = train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    whole = curves(folder)
    assert whole[-1]["test_return"]
    rows = (folder / "curves.csv").read_text().splitlines()
    names, last = rows[0].split(","), rows[-1].split(",")
    for name in ("test_return", "test_score"):
        if name in names:
            last[names.index(name)] = ""
    (folder / "curves.csv").write_text("\n".join([*rows[:-1], ",".join(last)]) + "\n")
    train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    assert curves(folder) == whole


def test_a_run_whose_learning_rate_falls_towards_its_end_has_no_other_end(tmp_path):
    falling = tiny_config("dt", steps=6, decay_steps=3)
    folder = train("dt", falling, settings(tmp_path), random_dataset())
    before = contents(folder)
    with pytest.raises(ValueError, match="is of another run, steps is 6 there and 12 here: give another --name"):
        train("dt", dataclasses.replace(falling, steps=12), settings(tmp_path), random_dataset())
    assert contents(folder) == before


def test_a_run_that_is_older_than_a_field_has_its_default(tmp_path):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())
    about = json.loads((folder / "config.json").read_text())
    del about["config"]["decay_steps"], about["settings"]["patience"]
    write_json(folder / "config.json", about)
    train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    assert json.loads((folder / "evaluation.json").read_text())["gradient_steps"] == 4
    write_json(folder / "config.json", about)
    with pytest.raises(ValueError, match="another run, decay_steps is 0 there and 2 here"):
        train("dt", tiny_config("dt", steps=4, decay_steps=2), settings(tmp_path), random_dataset())


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_command_that_finds_the_run_complete_leaves_it_as_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.train.git_commit", lambda: "a" * 40)
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset(), command="first")
    before = contents(folder)
    monkeypatch.setattr("agents.train.git_commit", lambda: "b" * 40)
    train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset(), command="second")
    assert contents(folder) == before
    (folder / "evaluation.json").unlink()  # made again, and not by another training
    train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset(), command="third")
    assert {path.name for path, old in before.items() if contents(folder)[path] != old} <= {"evaluation.json"}
    train("dt", tiny_config("dt", steps=3), settings(tmp_path), random_dataset(), command="more")
    config = json.loads((folder / "config.json").read_text())
    assert (config["commit"], config["command"], config["config"]["steps"]) == ("b" * 40, "more", 3)


@pytest.mark.parametrize("first", ["a" * 40 + "-dirty", None])
def test_steps_of_code_that_nobody_has_are_not_told_to_be_of_a_later_commit(tmp_path, monkeypatch, first):
    for steps, commit in ((2, first), (4, "b" * 40)):
        monkeypatch.setattr("agents.train.git_commit", lambda commit=commit: commit)
        folder = train("dt", tiny_config("dt", steps=steps), settings(tmp_path), random_dataset())
    assert json.loads((folder / "config.json").read_text())["commit"] == first


def test_a_run_tells_how_many_threads_it_had(tmp_path):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path, threads=0), random_dataset())
    assert json.loads((folder / "config.json").read_text())["settings"]["threads"] == torch.get_num_threads() == 1


@pytest.mark.parametrize(("options", "difference"), [({"seed": 7}, "seed is 0 there and 7"), ({}, "learning_rate is")])
def test_a_checkpoint_of_another_run_is_not_gone_on_with(tmp_path, options, difference):
    folder = train("dt", tiny_config("dt", steps=2), settings(tmp_path, name="run"), random_dataset())
    (folder / "config.json").unlink()
    config = tiny_config("dt", steps=4) if options else tiny_config("dt", steps=4, learning_rate=0.5)
    with pytest.raises(ValueError, match=rf"last\.safetensors is of another run, {difference}"):
        train("dt", config, settings(tmp_path, name="run", **options), random_dataset())


def test_a_run_older_than_a_field_of_its_agent_goes_on_with_the_default(tmp_path):
    folder = train("dadt", tiny_config("dadt", steps=2), settings(tmp_path), random_dataset())
    about = json.loads((folder / "config.json").read_text())
    del about["config"]["next_state_weight"]
    (folder / "config.json").write_text(json.dumps(about))
    train("dadt", tiny_config("dadt", steps=3), settings(tmp_path), random_dataset())
    config, record = read_finished(folder, ["dadt"])
    assert (config["config"]["next_state_weight"], record["gradient_steps"]) == (0.05, 3)


def test_a_run_stopped_on_the_way_is_finished_where_it_stands_if_that_is_asked_for(tmp_path, monkeypatch):
    update = Learner.update

    def stopped(self, sampler):
        if self.step == 5:
            raise KeyboardInterrupt
        return update(self, sampler)

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", stopped)
        with pytest.raises(KeyboardInterrupt):
            train("dt", tiny_config("dt", steps=8), settings(tmp_path), random_dataset())
    folder = train("dt", tiny_config("dt", steps=4), settings(tmp_path), random_dataset())
    config, record = read_finished(folder, ["dt"])
    assert (config["config"]["steps"], record["gradient_steps"], record["stopped_early"]) == (4, 4, False)


def test_the_official_result_is_of_a_checkpoint_that_is_there(tmp_path, monkeypatch):
    config = tiny_config("dt", steps=4)
    whole = train("dt", config, settings(tmp_path / "whole", checkpoint_every=2), random_dataset())
    cut = settings(tmp_path / "cut", checkpoint_every=2)

    def stopped(at, then):
        def write(path, content):
            if at(path, content):
                raise KeyboardInterrupt
            then(path, content)

        return write

    for function, at, steps in (
        ("agents.train.save_checkpoint", lambda path, checkpoint: checkpoint.step == 4, 2),
        ("agents.recording.write_json", lambda path, record: path.name == "evaluation.json", 4),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(function, stopped(at, save_checkpoint if "checkpoint" in function else write_json))
            with pytest.raises(KeyboardInterrupt):
                train("dt", config, cut, random_dataset())
        assert load_checkpoint(cut.folder("dt") / "last.safetensors").step == steps
        assert not (cut.folder("dt") / "evaluation.json").exists()
    folder = train("dt", config, cut, random_dataset())
    assert same(parameters(whole), parameters(folder))
    results = [json.loads((place / "evaluation.json").read_text())["evaluation"] for place in (whole, folder)]
    assert results[0] == results[1]
    assert [{**row, "seconds": ""} for row in curves(whole)] == [{**row, "seconds": ""} for row in curves(folder)]


def test_low_quality_data_are_the_worst_episodes_of_all(tiny_data, tmp_path):
    main(["dt", "--robot", "Hopper", "--steps", "2", "--quality", "0.3", *TINY_FLAGS.split(), "--runs", str(tmp_path)])
    folder = tmp_path / "dt-Hopper-seed0-quality0.3"
    dataset = load_dataset("Hopper", quality=0.3)
    data = json.loads((folder / "config.json").read_text())["data"]
    assert data == {"episodes": 72, "data_steps": dataset.num_steps}  # of 20 · 12
    found = load_checkpoint(folder / "last.safetensors").spec.normalization
    assert np.array_equal(found.mean, dataset.normalization().mean)


@pytest.mark.slow
def test_a_killed_process_continues(tiny_data, tmp_path):
    arguments = ["dadt", "--robot", "Hopper", "--checkpoint-every", "20", "--log-every", "10", *TINY_FLAGS.split()]
    arguments += ["--evaluate-every", "0", "--threads", "1", "--runs"]
    load_dataset("Hopper")  # so that the process need not make the arrays
    endless = [*arguments, str(tmp_path / "killed"), "--steps", "1000000"]  # it has not ended, however late the kill
    process = subprocess.Popen([sys.executable, "-m", "agents.train", *endless])
    last, deadline = tmp_path / "killed" / "dadt-Hopper-seed0" / "last.safetensors", time.monotonic() + 120
    while not last.is_file() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    steps = ["--steps", f"{load_checkpoint(last).step + 30}"]
    for where in ("killed", "whole"):
        main([*arguments, str(tmp_path / where), *steps])
    assert same(parameters(last.parent), parameters(tmp_path / "whole" / "dadt-Hopper-seed0"))


def test_test_data_and_other_robots_data_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"the data are Hopper 'test': train on load_dataset\('Hopper', 'train'\)"):
        train("dt", tiny_config("dt"), settings(tmp_path), random_dataset(split="test"))
    with pytest.raises(ValueError, match="the data are Hopper 'train': train on"):
        train("dt", tiny_config("dt"), settings(tmp_path, robot="Ant"), random_dataset())
    assert not os.listdir(tmp_path)


def test_a_folder_of_another_run_is_refused(tmp_path):
    train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())
    for config, data in ((tiny_config("dt", dropout=0.2), random_dataset()), (tiny_config("dt"), random_dataset((9,)))):
        with pytest.raises(
            ValueError, match=r"is of another run, (dropout is 0\.1|data_steps is 24) there and .* here"
        ):
            train("dt", config, settings(tmp_path), data)
    with pytest.raises(ValueError, match="another run, agent is 'dt' there and 'dadt' here"):
        train("dadt", tiny_config("dadt"), settings(tmp_path, name="dt-Hopper-seed0"), random_dataset())
    (tmp_path / "dt-Hopper-seed0" / "config.json").write_text("{}")
    with pytest.raises(ValueError, match=r"config\.json tells no agent, config and settings: delete the run folder"):
        train("dt", tiny_config("dt", steps=2), settings(tmp_path), random_dataset())


def test_two_processes_do_not_train_in_one_folder(tmp_path):
    description = {"agent": "dt", "config": {}, "settings": {}, "data": {}}
    with (
        claimed(tmp_path, description),
        pytest.raises(ValueError, match="another process works in"),
        claimed(tmp_path, description),
    ):
        pass


def test_a_loss_that_is_no_number_stops_before_it_does_harm(tmp_path):
    dataset = random_dataset()
    broken = dataset.observations.copy()
    broken[5] = np.nan
    sampler = WindowSampler(dataclasses.replace(dataset, observations=broken), K, dataset.normalization())
    learner = Learner("dadt", tiny_config("dadt", batch_size=64), hopper_spec(), seed=0)
    with pytest.raises(FloatingPointError, match=r"loss is nan at step 0: .*check the data"):
        learner.update(sampler)
    assert same(
        learner.checkpoint().parameters, Learner("dadt", learner.config, hopper_spec(), 0).checkpoint().parameters
    )


def with_a_number(dataset, field, row, number):
    """A dataset with another number in the first column of a row."""
    values = getattr(dataset, field).copy()
    values.reshape(len(values), -1)[row, 0] = number
    return dataclasses.replace(dataset, **{field: values})


@pytest.mark.parametrize("field", ["observations", "actions", "returns_to_go"])
def test_data_that_are_not_finite_are_refused_before_the_first_step(tmp_path, field):
    for number in (np.nan, np.inf):
        with pytest.raises(ValueError, match=f"{field} of the Hopper data are not finite in row 7: build"):
            train("dt", tiny_config("dt"), settings(tmp_path), with_a_number(random_dataset(), field, 7, number))


def test_a_loss_that_overflows_stops_at_its_step_and_keeps_the_last_checkpoint(tmp_path):
    dataset = random_dataset(lengths=(150,) * 4)
    bad = with_a_number(dataset, "actions", 300, 1e30)  # finite, but its square is not; few windows hold it
    sane = settings(tmp_path, checkpoint_every=2, evaluate_every=0)
    config = tiny_config("dt", steps=200, batch_size=4)
    with pytest.raises(
        FloatingPointError, match=r"^loss is (inf|nan) at step \d+: lower --learning-rate, or check"
    ) as caught:
        train("dt", config, sane, bad)
    step = int(str(caught.value).split()[5].rstrip(":"))
    assert load_checkpoint(sane.folder("dt") / "last.safetensors").step == step - step % 2 > 0
    assert same(
        parameters(sane.folder("dt")),
        parameters(
            train(
                "dt",
                dataclasses.replace(config, steps=step - step % 2),
                dataclasses.replace(sane, name="sane"),
                dataset,
            )
        ),
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": "hoper"}, "unknown robot 'hoper'.*did you mean 'Hopper'"),
        ({"seed": -1}, "seed is -1: give a whole number from 0 on"),
        ({"seed": 2**63}, r"seed is 9223372036854775808: give a whole number below 2\*\*63"),
        ({"seed": 1.5}, "seed is 1.5: give a whole number from 0 on"),
        ({"every": True}, "every is True: give a whole number from 1 on"),
        ({"threads": -1}, "threads is -1: give a whole number from 0 on"),
        ({"checkpoint_every": 5}, "checkpoint_every 5 is no multiple of log_every 2"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        settings(tmp_path, **changes)


def test_the_largest_seed_trains(tmp_path):
    folder = train("dt", tiny_config("dt", steps=1), settings(tmp_path, seed=2**63 - 1), random_dataset())
    assert load_checkpoint(folder / "last.safetensors").seed == 2**63 - 1


@pytest.mark.usefixtures("tiny_data")
def test_a_warm_up_that_does_not_end_is_warned_of(tmp_path, capsys):
    flags = TINY_FLAGS.split()
    main(["dt", "--robot", "Hopper", "--steps", "2", *flags, "--warmup-steps", "8", "--runs", str(tmp_path)])
    assert "warning: warmup_steps is 8, steps 2: the learning rate comes to " in capsys.readouterr().err
    main(["dt", "--robot", "Hopper", "--steps", "2", *flags, "--warmup-steps", "2", "--runs", str(tmp_path / "other")])
    assert "warning" not in capsys.readouterr().err


def test_the_command_line_ends_bad_input_in_one_line(tmp_path, capsys):
    for arguments in (["dt", "--robot", "Hopper", "--dropout", "2"], ["dt", "--robot", "Hopper"]):
        with pytest.raises(SystemExit) as stop:
            main([*arguments, "--runs", str(tmp_path)])
        code = stop.value.code
        assert code == 2 or (isinstance(code, str) and code.startswith("error: ") and "\n" not in code)
