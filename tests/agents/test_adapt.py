"""Fine-tuning: what it starts from, what it leaves, and that stopping it changes nothing."""

import csv
import dataclasses
import json
import os

import numpy as np
import pytest
import torch

from agents import AGENTS
from agents.adapt import adapt, choose_steps, main, read_result
from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.fine_tuning import AdaptationSettings, FineTuning
from agents.learner import Learner
from agents.train import train
from dynagen_bench import ids
from dynagen_bench.datasets import load_adaptation
from dynagen_bench.evaluation import Evaluation, evaluate
from dynagen_bench.evaluation.traces import load_traces
from tests.agents.samples import hopper_spec, new_agent, random_dataset, tiny_config
from tests.agents.test_train import settings

FAST = AdaptationSettings(steps=3, learning_rate=0.01, batch_size=4, episodes=2)
POINTS = dataclasses.replace(FAST, steps=None)
TEST0 = ids.make_id("Hopper", "test", 0)


@pytest.fixture
def run(tmp_path):
    """A finished run of DADT."""
    return train("dadt", tiny_config("dadt", steps=2), settings(tmp_path / "runs", evaluate_every=0), random_dataset())


def evaluation_of(file):
    return Evaluation.from_json(json.loads(file.read_text())["evaluation"])


def fine_tuned(checkpoint, name=TEST0, tuning=FAST, data=None):
    """The parameters after fine-tuning."""
    given = FineTuning(checkpoint, tuning, name, data or random_dataset(split="test"))
    given.advance_to(tuning.steps, lambda: None)
    return given.parameters


def stop_at_update(monkeypatch, number):
    """Make the learners' update of this number an interruption; gives a list that grows by each update's seed."""
    update, taken = Learner.update, []

    def stopped(self, sampler):
        taken.append(self.seed)
        if len(taken) == number:
            raise KeyboardInterrupt
        return update(self, sampler)

    monkeypatch.setattr(Learner, "update", stopped)
    return taken


def different(one, other):
    return {key for key, value in one.items() if not torch.equal(value, other[key])}


def test_fine_tuning_is_training_from_the_checkpoint_with_its_own_values(name):
    start = Learner(name, tiny_config(name).for_robot("Hopper"), hopper_spec(), seed=1).checkpoint()
    kept = {key: value.clone() for key, value in start.parameters.items()}
    tuned = fine_tuned(start)
    assert different(tuned, kept)
    assert not different(start.parameters, kept)  # the checkpoint is for the next dynamics
    assert not different(fine_tuned(start), tuned)
    assert not different(fine_tuned(start, tuning=dataclasses.replace(FAST, steps=0)), kept)
    for other in (
        fine_tuned(dataclasses.replace(start, seed=2)),
        fine_tuned(start, ids.make_id("Hopper", "test", 1)),
        fine_tuned(start, ids.make_id("Hopper", "train", 0)),
        fine_tuned(start, tuning=dataclasses.replace(FAST, seed=1)),
        fine_tuned(start, tuning=dataclasses.replace(FAST, weight_decay=1.0)),
    ):
        assert different(other, tuned)
    # neither the run's learning rate nor its schedule counts, which would make these steps nothing
    slow = dataclasses.replace(start.config, learning_rate=0.0, warmup_steps=10**6, decay_steps=1, weight_decay=0.5)
    assert not different(fine_tuned(dataclasses.replace(start, config=slow)), tuned)


def test_an_agent_that_learns_in_phases_is_fine_tuned_as_it_learned_to_act():
    config = tiny_config("dt_plus", trunk_steps=2).for_robot("Hopper")
    start = Learner("dt_plus", config, hopper_spec(), seed=1).checkpoint()
    two, six = (fine_tuned(start, tuning=dataclasses.replace(FAST, steps=steps)) for steps in (2, 6))
    assert {key for key in two if key.startswith("dt.")} == {
        key for key in different(two, six) if key.startswith("dt.")
    }


def test_without_a_step_it_is_the_zero_shot_evaluation_bit_for_bit(run, tiny_data):
    result = adapt(run, dataclasses.replace(FAST, steps=0))
    zero_shot, adapted = evaluation_of(run / "evaluation.json"), read_result(result)
    for field in ("returns", "lengths", "seeds"):
        assert np.array_equal(getattr(zero_shot, field), getattr(adapted, field))
    assert (adapted.indices, adapted.physics) == (zero_shot.indices, zero_shot.physics)
    traces = load_traces(run / "evaluation.safetensors", "Hopper", zero_shot.lengths)
    assert adapted.traces.sha256 == traces.sha256


def test_it_leaves_the_result_of_all_test_dynamics(run, tiny_data, capsys):
    options = "--steps 3 --learning-rate 0.01 --batch-size 4 --episodes 2 --threads 1"
    main([str(run), *options.split()])
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("zero-shot", "adapted", "test0", "test4", "all"))
    record = json.loads((run / "adaptation.json").read_text())
    assert (record["agent"], record["seed"], record["trained_steps"], record["gradient_steps"]) == ("dadt", 0, 2, 5)
    assert AdaptationSettings(**record["adaptation"]) == dataclasses.replace(FAST, weight_decay=1e-2)
    assert record["hours"] > json.loads((run / "evaluation.json").read_text())["hours"]
    assert not (run / "adaptation").exists()

    adapted, zero_shot = evaluation_of(run / "adaptation.json"), evaluation_of(run / "evaluation.json")
    assert np.array_equal(adapted.seeds, zero_shot.seeds)
    assert not np.array_equal(adapted.returns, zero_shot.returns)
    before = os.stat(run / "adaptation.json").st_mtime_ns
    adapt(run, FAST)  # is done
    assert os.stat(run / "adaptation.json").st_mtime_ns == before


def test_stopped_at_any_time_it_goes_on_with_the_dynamics_it_was_at(run, tiny_data, monkeypatch):
    whole = read_result(adapt(run, FAST))
    assert json.loads((run / "adaptation.json").read_text())["threads"] == torch.get_num_threads()
    (run / "adaptation.json").unlink()
    taken = stop_at_update(monkeypatch, 8)  # the second step of the third dynamics
    monkeypatch.setattr("agents.adapt.git_commit", lambda: "a" * 40 + "-dirty")
    with pytest.raises(SystemExit, match=r"^130$"):
        main([str(run), "--steps", "3", "--learning-rate", "0.01", "--batch-size", "4", "--episodes", "2"])
    assert not (run / "adaptation.json").exists()
    assert sorted(file.name for file in (run / "adaptation").glob("*.json")) == ["test0.json", "test1.json"]
    monkeypatch.setattr("agents.adapt.git_commit", lambda: "b" * 40)
    first = json.loads((run / "adaptation" / "test0.json").read_text())
    (run / "adaptation" / "test0.json").write_text(json.dumps(first | {"threads": first["threads"] + 1}))
    again = read_result(adapt(run, FAST))
    record = json.loads((run / "adaptation.json").read_text())
    assert record["commit"] == "a" * 40 + "-dirty"  # two of its dynamics are of code that nobody has
    assert record["threads"] == 0  # one dynamics had another number
    assert len(taken) == 8 + 9
    assert np.array_equal(again.returns, whole.returns)
    assert again.traces.sha256 == whole.traces.sha256


def test_a_loss_that_is_no_number_stops_with_its_step_and_dynamics_and_writes_nothing(run, tiny_data):
    checkpoint = load_checkpoint(run / "last.safetensors")
    broken = {key: value * 1e30 if "next_state_head" in key else value for key, value in checkpoint.parameters.items()}
    save_checkpoint(run / "last.safetensors", dataclasses.replace(checkpoint, parameters=broken))
    with pytest.raises(FloatingPointError, match=r"^adapting to Hopper test0: loss is (inf|nan) at step 0: ") as caught:
        adapt(run, FAST)
    assert "\n" not in str(caught.value)
    assert not list(run.glob("adaptation*"))


@pytest.fixture
def held_out(tmp_path):
    """A finished run of DADT that held out two train dynamics."""
    dataset = dataclasses.replace(random_dataset(), episode_dynamics=np.array([0, 18, 19]))
    plan = settings(tmp_path / "runs", evaluate_every=0, hold_out=2)
    return train("dadt", tiny_config("dadt", steps=2), plan, dataset)


def test_the_curve_is_of_held_out_train_dynamics_and_sees_no_test_data(held_out, tmp_path, tiny_data, monkeypatch):
    run = held_out
    only_train = tmp_path / "only-train"
    place = only_train / "dynagen" / "Hopper-RandDyn"
    place.mkdir(parents=True)
    for folder in (tiny_data / "dynagen" / "Hopper-RandDyn").glob("train*"):
        (place / folder.name).symlink_to(folder)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(only_train))
    with choose_steps(run, POINTS, points=(0, 2)).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["steps"] for row in rows] == ["0", "2"]
    agent = load_checkpoint(run / "last.safetensors").build_agent()
    for row in rows:
        assert float(row["mean_return"]) == pytest.approx(np.mean([float(row["train18"]), float(row["train19"])]))
    for index in (18, 19):
        returns = evaluate(agent.policy(), "Hopper", "train", indices=[index]).returns
        assert float(rows[0][f"train{index}"]) == pytest.approx(returns.mean(), rel=1e-6)
    assert rows[0]["mean_return"] != rows[1]["mean_return"]
    with pytest.raises(FileNotFoundError, match="no data of Hopper-RandDyn-test0"):
        adapt(run, FAST)


def test_a_curve_that_was_stopped_goes_on_with_the_dynamics_it_was_at(held_out, tiny_data, monkeypatch):
    whole = choose_steps(held_out, POINTS, points=(0, 2)).read_bytes()
    (held_out / "adaptation-curve.csv").unlink()
    taken = stop_at_update(monkeypatch, 4)  # the second step of the second dynamics
    with pytest.raises(KeyboardInterrupt):
        choose_steps(held_out, POINTS, points=(0, 2))
    assert [file.name for file in (held_out / "adaptation-curve").iterdir()] == ["train18.json"]
    assert choose_steps(held_out, POINTS, points=(0, 2)).read_bytes() == whole
    assert len(taken) == 4 + 2
    choose_steps(held_out, dataclasses.replace(POINTS, seed=1), points=(0, 2))
    assert len(taken) == 4 + 2 + 4  # nothing is left of the other curve
    assert not (held_out / "adaptation-curve").exists()


def edited(run, change):
    """Change config.json."""
    config = json.loads((run / "config.json").read_text())
    change(config)
    (run / "config.json").write_text(json.dumps(config))


def at_step(run, step):
    """Change the last checkpoint."""
    path = run / "last.safetensors"
    save_checkpoint(path, dataclasses.replace(load_checkpoint(path), step=step))


@pytest.mark.parametrize(
    ("spoil", "options", "message"),
    [
        (lambda run: (run / "config.json").unlink(), [], "is no finished run, it has no config.json"),
        (lambda run: (run / "config.json").write_text("{}"), [], "config.json tells no agent, config and settings"),
        (lambda run: (run / "last.safetensors").unlink(), [], "is no finished run, it has no last.safetensors: train"),
        (lambda run: (run / "evaluation.json").unlink(), [], "is no finished run, it has no evaluation.json: train"),
        (lambda run: edited(run, lambda c: c["config"].update(steps=9)), [], "was evaluated at step 2 of 9: train"),
        (lambda run: at_step(run, 1), [], "last.safetensors is at step 1, its evaluation of step 2: give the command"),
        (lambda run: edited(run, lambda c: c.update(agent="mlp")), [], "is of 'mlp', which does not act: give a run"),
        (lambda run: edited(run, lambda c: c.update(agent="dt")), [], "is of agent 'dadt', not 'dt'"),
        (
            lambda run: edited(run, lambda c: c["settings"].update(robot="Ant")),
            [],
            "is of robot 'Hopper', not 'Ant'",
        ),
        (
            lambda run: None,
            ["--curve", "--steps", "7"],
            "steps is 7, and the curve has a point after each of (0, 100, ",
        ),
        (lambda run: None, ["--curve"], "held out no train dynamics: train one with --hold-out"),
        (lambda run: None, [], "no data of Hopper-RandDyn-test0"),
        (lambda run: None, ["--threads", "-1"], "threads is -1: give a whole number from 0 on"),
        (lambda run: None, ["--batch-size", "0"], "batch_size is 0: give a whole number from 1"),
    ],
)
def test_what_cannot_be_adapted_is_said_in_one_line(run, spoil, options, message):
    spoil(run)
    with pytest.raises(SystemExit) as stop:
        main([str(run), *options])
    code = stop.value.code
    assert isinstance(code, str)
    assert code.startswith("error: ")
    assert message in code
    assert "\n" not in code
    assert not list(run.glob("adaptation*"))


def test_more_episodes_than_there_are_is_refused(run, tiny_data):
    with pytest.raises(ValueError, match="episodes is 13: give a whole number from 1 to 12"):
        adapt(run, dataclasses.replace(FAST, episodes=13))


def test_the_papers_values_are_the_defaults():
    found = AdaptationSettings().for_agent(new_agent("dadt"), tiny_config("dadt"))
    assert (found.learning_rate, found.weight_decay, found.batch_size, found.episodes) == (1e-5, 1e-2, 32, 10)


def test_an_agent_that_is_told_dynamics_by_data_is_given_them_and_takes_no_step(tmp_path, tiny_data):
    config = AGENTS["focal"][0](
        tasks=2, context=4, batch_size=8, hidden=16, encoder_hidden=16, latent=4, steps=2, learning_rate=0.1
    )
    data = dataclasses.replace(random_dataset(), episode_dynamics=np.array([0, 1, 1]))
    folder = train("focal", config, settings(tmp_path / "runs", evaluate_every=0), data)
    with pytest.raises(
        ValueError, match=r"^steps is 3, and the agent is told the dynamics by data .* leave out --steps$"
    ):
        adapt(folder, FAST)
    with pytest.raises(
        ValueError, match=r"^learning_rate is 0\.01, and .* no gradient step .* leave out --learning-rate$"
    ):
        adapt(folder, POINTS)
    result = adapt(folder, AdaptationSettings(episodes=2))
    record, adapted = json.loads(result.read_text()), read_result(result)
    assert record["gradient_steps"] == record["trained_steps"] == 2
    agent = load_checkpoint(folder / "last.safetensors").build_agent()
    given = agent.policy_given(load_adaptation("Hopper", 3, episodes=2))
    alone = evaluate(given, "Hopper", indices=[3])
    assert np.array_equal(adapted.returns[3], alone.returns[0])
    assert not np.array_equal(adapted.returns, evaluation_of(folder / "evaluation.json").returns)
    with pytest.raises(
        ValueError, match="is of 'focal', which is told the dynamics by data and takes no gradient step"
    ):
        choose_steps(folder, POINTS, points=(0, 2))


def test_an_agent_with_parts_for_each_dynamics_gets_some_for_the_new_one_at_its_own_rate(tmp_path, tiny_data):
    config = AGENTS["merpo"][0](
        tasks=2, batch_size=8, starts=4, rollout=2, hidden=8, model_hidden=8, members=2, steps=4, learning_rate=0.01
    )
    data = dataclasses.replace(random_dataset(), episode_dynamics=np.array([0, 1, 1]))
    folder = train("merpo", config, settings(tmp_path / "runs", evaluate_every=0), data)
    checkpoint = load_checkpoint(folder / "last.safetensors")
    tuning = FineTuning(checkpoint, AdaptationSettings(steps=3), TEST0, random_dataset(split="test"))
    common = checkpoint.build_agent().for_task()
    assert not different(tuning.parameters, dict(common.named_parameters()))
    tuning.advance_to(3, lambda: None)
    assert different(tuning.parameters, dict(common.named_parameters()))
    record = json.loads(adapt(folder, AdaptationSettings(steps=2, episodes=2)).read_text())
    assert record["adaptation"] == {
        "steps": 2, "learning_rate": 0.01, "weight_decay": 0.0, "batch_size": 8, "episodes": 2, "seed": 0,
    }  # fmt: skip
