"""`python -m agents.predict`, and training of what predicts: from commands to files and a table."""

import csv
import dataclasses
import json
import shutil

import pytest

from agents.checkpoint import save_checkpoint
from agents.learner import Learner
from agents.predict import main, summary
from agents.run_folder import RunSettings, locked, write_json
from agents.train import describe
from agents.train import main as train_main
from tests.agents.samples import K, hopper_spec, random_dataset, tiny_config

SMALL = "--steps 4 --context 5 --batch-size 8 --evaluate-every 2 --checkpoint-every 2 --log-every 1 --threads 1"


def trained(agent, folder, *flags, seed=0):
    """A predictor's run of a few steps on tiny data; its folder."""
    given = [agent, "--robot", "Hopper", "--seed", str(seed), *SMALL.split(), *flags]
    train_main([*given, "--runs", str(folder)])
    return folder / f"{agent}-Hopper-seed{seed}"


def unevaluated(agent, folder, seed=0):
    """The run folder of an agent that nothing has been done with: acting takes its time, and is not needed here."""
    config, settings, dataset = tiny_config(agent), RunSettings("Hopper", seed, runs=folder), random_dataset()
    spec = dataclasses.replace(hopper_spec(), normalization=dataset.normalization())
    run = settings.folder(agent)
    save_checkpoint(run / "last.safetensors", Learner(agent, config, spec, seed).checkpoint())
    write_json(run / "config.json", describe(agent, config, settings, dataset))
    return run


def record_of(folder):
    return json.loads((folder / "prediction.json").read_text())


def edit_settings(folder, **changes):
    """Change the settings in config.json."""
    config = json.loads((folder / "config.json").read_text())
    config["settings"] |= changes
    write_json(folder / "config.json", config)


def said(capsys):
    """What was printed, on one line."""
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("agent", ["mlp", "lstm", "cadm"])
def test_a_predictors_run_leaves_its_errors_in_place_of_an_evaluation(agent, tiny_data, tmp_path, capsys):
    folder = trained(agent, tmp_path)
    record = record_of(folder)
    assert (record["agent"], record["gradient_steps"], record["every"]) == (agent, 4, 1)
    assert record["prediction"]["dynamics"] == [0, 1, 2, 3, 4]
    assert f"mean square error {record['prediction']['mean']:.5f} of the next states" in said(capsys)
    with (folder / "curves.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows if row["test_error"]] == ["2", "4"]
    assert float(rows[-1]["test_error"]) == pytest.approx(record["prediction"]["mean"], rel=1e-6)
    assert "next_state_loss" in rows[0]
    assert not list(folder.glob("evaluation*"))
    (folder / "prediction.json").unlink()
    trained(agent, tmp_path)
    assert record_of(folder)["prediction"] == record["prediction"]


def test_a_table_over_agents_and_seeds(tiny_data, tmp_path, capsys):
    runs = [trained("mlp", tmp_path, seed=seed) for seed in (0, 1)]
    for agent in ("dadt", "dt", "dt_plus"):
        runs.append(unevaluated(agent, tmp_path))
    in_training = [record_of(folder)["prediction"] for folder in runs[:2]]
    capsys.readouterr()
    main([*map(str, runs), "--threads", "1"])
    words = said(capsys)
    assert f"{runs[3]}: dt does not predict the next state, left out" in words
    assert not (runs[3] / "prediction.json").exists()
    assert [record_of(folder)["prediction"] for folder in runs[:2]] == in_training
    assert f"│ mlp │ {summary([found['mean'] for found in in_training])} │" in words
    for folder in (runs[2], runs[4]):
        record = record_of(folder)
        assert f"│ {record['agent']} │ {record['prediction']['mean']:.5f} (1) │" in words
        assert (record["gradient_steps"], record["context"]) == (0, K)


def test_a_part_of_the_test_data(tiny_data, tmp_path, capsys):
    folder = trained("mlp", tmp_path)
    whole = record_of(folder)
    capsys.readouterr()
    main([str(folder), "--episodes", "1", "--threads", "1"])
    assert f"{whole['prediction']['mean']:.5f}" not in said(capsys)
    assert record_of(folder) == whole  # what the run has of its training stays
    main([str(folder), "--threads", "1"])
    assert f"{whole['prediction']['mean']:.5f}" in said(capsys)
    assert record_of(folder)["prediction"] == whole["prediction"]


def test_bad_input_is_one_line(tiny_data, tmp_path, capsys):
    first, other = trained("mlp", tmp_path), trained("mlp", tmp_path / "wide", "--hidden", "100")
    old = trained("lstm", tmp_path)
    edit_settings(old, every=4)
    parts = []
    for setting, value in (("every", 4), ("quality", 0.3), ("hold_out", 2)):
        parts.append(unevaluated("dadt", tmp_path / setting, seed=1))
        edit_settings(parts[-1], **{setting: value})
    whole = unevaluated("dadt", tmp_path)
    (tmp_path / "empty").mkdir()
    for file in ("config.json", "last.safetensors"):
        (tmp_path / "empty" / file).write_text("{}")
    cases = [
        ([], "no runs given: name at least one run folder"),
        ([tmp_path / "none"], "none is no run, it has no config.json: give a folder that training made"),
        ([tmp_path / "empty"], r"config.json tells no agent, config and settings: delete the run folder and train"),
        ([first, other], "hidden of .* is 200, of .* 100: a mean over both means nothing, give them apart"),
        ([first, old], "was trained on every 4 of the snapshots, another run of its robot on every 1: give --test-ev"),
        ([whole, parts[0]], "every of .* is 1, of .* 4: a mean over both means nothing, give them apart"),
        ([whole, parts[0], "--test-every", "4"], "every of .* is 1, of .* 4: a mean over both means nothing"),
        ([whole, parts[1]], r"quality of .* is 1\.0, of .* 0\.3: a mean over both means nothing"),
        ([whole, parts[2]], "hold_out of .* is 0, of .* 2: a mean over both means nothing"),
        ([first, parts[2]], r"hold_out of .* is 0, of .* 2: their states are normalised by other data"),
        ([parts[1], first], r"quality of .* is 0\.3, of .* 1\.0: their states are normalised by other data"),
        ([first, first], "mlp-Hopper-seed0 and .*mlp-Hopper-seed0 are both mlp for Hopper with seed 0: give each run"),
        ([first, "--threads", "-1"], "threads is -1: give a whole number from 0 on"),
        ([first, "--episodes", "0"], "episodes is 0: give a whole number from 1 on"),
        ([first, "--test-every", "4"], "no data of Hopper-RandDyn-test0"),
    ]
    for arguments, message in cases:
        with pytest.raises(SystemExit, match=message) as stop:
            main([str(argument) for argument in arguments])
        assert "\n" not in str(stop.value)


def test_nobody_trains_on_what_is_measured(tiny_data, tmp_path):
    run = trained("mlp", tmp_path)
    before = (run / "prediction.json").stat().st_mtime_ns
    with locked(run), pytest.raises(SystemExit, match="another process works in"):
        main([str(run)])
    assert (run / "prediction.json").stat().st_mtime_ns == before
    main([str(run), "--threads", "1"])
    assert (run / "prediction.json").stat().st_mtime_ns != before


def test_a_checkpoint_of_another_agent_is_no_run(tiny_data, tmp_path):
    run, other = trained("mlp", tmp_path), trained("lstm", tmp_path)
    shutil.copyfile(other / "last.safetensors", run / "last.safetensors")
    with pytest.raises(SystemExit, match="is of agent 'lstm', not 'mlp'"):
        main([str(run)])


def test_a_cell_of_the_table():
    assert summary([]) == ""
    assert summary([0.25]) == "0.25000 (1)"
    assert summary([1.0, 2.0, 3.0]) == "2.00000 ± 1.00000 (3)"
