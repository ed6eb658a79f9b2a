"""Every way to cheat that we could think of, on an honest submission; each ends in one line that names where.

The cheat puts right hashes everywhere: what is caught here is caught by the replay or by the reader, not by a hash.
"""

import json
import re

import numpy as np
import pytest

from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.evaluation import RandomPolicy, evaluate, reset_seeds
from dynagen_bench.evaluation.rollout import reset_generators
from dynagen_bench.evaluation.submission import FILE_NAME
from dynagen_bench.evaluation.traces import Recorder, stored_states
from leaderboard.__main__ import main
from tests.leaderboard.cheats import TRACE, refused


def longest(cheat):
    return int(cheat.lengths.argmax())


def one_action(cheat):
    cheat.actions[3][7, 1] = np.nextafter(cheat.actions[3][7, 1], np.float32(2))


def last_action(cheat):
    cheat.actions[3][-1, 1] = -cheat.actions[3][-1, 1]


def one_state(cheat):
    cheat.states[12][1, 5] = np.nextafter(cheat.states[12][1, 5], np.inf)


def last_state(cheat):
    cheat.states[12][-1, 0] += 5.0


def first_state(cheat):
    cheat.states[49][0, 0] += 1e-9


def swapped_episodes(cheat):
    for name in ("actions", "states"):
        episodes = getattr(cheat, name)
        episodes[20], episodes[21] = episodes[21], episodes[20]
    for name in ("lengths", "returns"):
        row = cheat.evaluation[name][2]
        row[0], row[1] = row[1], row[0]


def duplicated_episode(cheat):
    cheat.take(31, 35)


def duplicated_with_its_own_start(cheat):
    start = cheat.states[31][0].copy()
    cheat.take(31, 35)
    cheat.states[31][0] = start


def other_dynamics_episode(cheat):
    cheat.take(5, 45)


def spliced_episodes(cheat):
    one, other = 4, longest(cheat)
    cheat.actions[one] = np.concatenate((cheat.actions[one][:10], cheat.actions[other][10:]))
    cheat.states[one] = np.concatenate((cheat.states[one][:1], cheat.states[other][1:]))
    cheat.evaluation["lengths"][0][4] = len(cheat.actions[one])


def removed_termination(cheat):
    """The episode goes on after its fall, as the physics would."""
    for episode, length in enumerate(cheat.lengths):
        physics = BatchPhysics("Hopper", [load_dynamics("Hopper", "test", episode // 10)])
        physics.states[0] = cheat.states[episode][0]
        recorder, actions = Recorder(physics.states, 3), cheat.actions[episode]
        actions = np.concatenate((actions, np.zeros((HORIZON - length, 3), np.float32)))
        returned = 0.0
        for step in range(HORIZON):
            result = physics.step(actions[step][None])
            recorder.add(step, np.arange(1), actions[step][None], result.states, np.array([False]))
            returned += float(result.rewards[0])
        traces = recorder.traces(np.array([HORIZON]))
        cheat.actions[episode], cheat.states[episode] = traces.actions, traces.states
        cheat.evaluation["lengths"][episode // 10][episode % 10] = HORIZON
        cheat.evaluation["returns"][episode // 10][episode % 10] = returned
        if episode == 2:
            return


def ended_while_good(cheat):
    """An episode stops before its fall costs anything."""
    episode = next(e for e, length in enumerate(cheat.lengths) if length > 10)
    cheat.actions[episode], cheat.states[episode] = cheat.actions[episode][:10], cheat.states[episode][:2]
    cheat.evaluation["lengths"][episode // 10][episode % 10] = 10


def easier_body(cheat):
    """All episodes of another body, from the right starts."""
    physics = BatchPhysics("Hopper", [Dynamics()] * 10)
    seeds = np.array(cheat.evaluation["seeds"][1])
    physics.start(np.arange(10), reset_generators(seeds))
    recorder, lengths = Recorder(physics.states, 3), np.zeros(10, dtype=np.int64)
    returns, running = np.zeros(10), np.arange(10)
    for step in range(HORIZON):
        result = physics.step(np.zeros((len(running), 3)), running)
        recorder.add(step, running, np.zeros((len(running), 3), np.float32), result.states, result.terminated)
        returns[running] += result.rewards
        lengths[running] += 1
        running = running[~result.terminated]
    traces = recorder.traces(lengths)
    cheat.actions[10:20] = np.split(traces.actions, np.cumsum(lengths)[:-1])
    cheat.states[10:20] = np.split(traces.states, np.cumsum(stored_states(lengths))[:-1])
    cheat.evaluation["lengths"][1], cheat.evaluation["returns"][1] = lengths.tolist(), returns.tolist()


def one_return(cheat):
    cheat.evaluation["returns"][4][9] = float(np.nextafter(cheat.evaluation["returns"][4][9], np.inf))


def every_return(cheat):
    cheat.evaluation["returns"] = [[5000.0] * 10] * 5


def claimed_other_machine(cheat):
    """Another machine is given a tolerance; it is not for sale."""
    cheat.evaluation["physics"] = "0" * 16
    cheat.states[12][1, 0] += 0.01


STEPPED = [
    (one_action, TRACE, r"test0 episode 3: actions or states: steps 0 to 9 end elsewhere, off by"),
    (last_action, TRACE, r"test0 episode 3: actions or states: steps \d+ to \d+ end elsewhere"),
    (one_state, TRACE, r"test1 episode 2: actions or states: steps 0 to 9 end elsewhere, off by"),
    (last_state, TRACE, r"test1 episode 2: actions or states: steps \d+ to \d+ end elsewhere, off by 5"),
    (first_state, TRACE, r"test4 episode 9: states: the first is not the reset of seed \d+, it is off by 1e-09"),
    (swapped_episodes, TRACE, r"test2 episode 0: states: the first is not the reset of seed"),
    (duplicated_episode, TRACE, r"test3 episode 1: states: the first is not the reset of seed"),
    (duplicated_with_its_own_start, TRACE, r"test3 episode 1: actions or states: steps 0 to 9 end elsewhere"),
    (other_dynamics_episode, TRACE, r"test0 episode 5: states: the first is not the reset of seed"),
    (spliced_episodes, TRACE, r"test0 episode 4: actions or states: steps 0 to 9 end elsewhere"),
    (
        removed_termination,
        FILE_NAME,
        r"runs\.0\.evaluation\.lengths\.0\.\d: the episode goes on to 200 steps, but its step \d+ led to a terminal",
    ),
    (
        ended_while_good,
        FILE_NAME,
        r"runs\.0\.evaluation\.lengths\.\d\.\d: the episode ends after 10 steps in no terminal state",
    ),
    (easier_body, TRACE, r"test1 episode 0: actions or states: steps 0 to 9 end elsewhere"),
    (one_return, FILE_NAME, r"runs\.0\.evaluation\.returns\.4\.9: [\d.]+ is claimed, the replay returns [\d.]+"),
    (every_return, FILE_NAME, r"runs\.0\.evaluation\.returns\.0\.0: 5000\.0 is claimed, the replay returns"),
    (claimed_other_machine, TRACE, r"test1 episode 2: actions or states: steps 0 to 9 end elsewhere, off by 0\.01"),
]


@pytest.mark.parametrize(("change", "file", "message"), STEPPED, ids=[change.__name__ for change, _, _ in STEPPED])
def test_the_replay_catches(cheat, capsys, board, change, file, message):
    change(cheat)
    cheat.write()
    assert re.search(message, refused(cheat, capsys, board, file)[0])


def fields(**changes):
    """A change of fields of the run's evaluation, or of the run where a name begins with `run_`."""

    def change(cheat):
        for name, value in changes.items():
            inside = cheat.content["runs"][0] if name.startswith("run_") else cheat.evaluation
            inside[name.removeprefix("run_")] = value

    return change


def one_seed(cheat):
    cheat.evaluation["seeds"][0][0] += 1


def one_length(cheat):
    cheat.evaluation["lengths"][0][0] += 1


def another_robot(cheat):
    cheat.content["runs"][0]["robot"] = cheat.evaluation["robot"] = "Walker"


def another_robot_of_the_same_size(cheat):
    """Walker and HalfCheetah have as many actions and states."""
    found = evaluate(RandomPolicy("Walker"), "Walker")
    cheat.content["runs"][0]["robot"] = cheat.evaluation["robot"] = "HalfCheetah"
    cheat.evaluation.update(seeds=reset_seeds("HalfCheetah", "test", range(5)).tolist(), lengths=found.lengths.tolist())
    (cheat.folder / "traces" / "HalfCheetah-seed0.safetensors").write_bytes(found.traces.content)
    cheat.content["runs"][0]["trace"] = found.traces.sha256


HALF_CHEETAH = "traces/HalfCheetah-seed0.safetensors"
READ = [
    (one_seed, FILE_NAME, "runs.0.evaluation.seeds: they are not the official reset seeds"),
    (one_length, TRACE, "actions: F32 of shape ["),
    (fields(indices=[0, 1, 2, 4, 3]), FILE_NAME, "runs.0.evaluation.indices: they are [0, 1, 2, 4, 3]"),
    (fields(split="train"), FILE_NAME, "runs.0.evaluation.split: it is 'train', the board takes 'test'"),
    (another_robot, FILE_NAME, "runs.0.evaluation.seeds: they are not the official reset seeds"),
    (another_robot_of_the_same_size, HALF_CHEETAH, "test0 episode 0: states: the first is not the reset of seed"),
    (fields(run_seed=1), "traces/Hopper-seed1.safetensors is no file", ""),
    (fields(run_robot="../../etc"), FILE_NAME, "runs.0: robot is '../../etc', but the evaluation is of 'Hopper'"),
    (fields(run_trace="/etc/passwd"), FILE_NAME, "runs.0.trace: String should match pattern"),
    (fields(run_trace="../../secret"), FILE_NAME, "runs.0.trace: String should match pattern"),
    (fields(run_label="re-run"), FILE_NAME, "runs.0.label: Extra inputs are not permitted"),
    (fields(score=100.0), FILE_NAME, "runs.0.evaluation.score: Extra inputs are not permitted"),
    (fields(returns=[[float("nan")] * 10] * 5), FILE_NAME, "runs.0.evaluation.returns.0.0: Input should be a finite"),
    (fields(returns=[[float("inf")] * 10] * 5), FILE_NAME, "runs.0.evaluation.returns.0.0: Input should be a finite"),
    (fields(returns=[[1e308] * 10] * 5), FILE_NAME, "runs.0.evaluation.returns.0.0: Input should be less than"),
    (fields(lengths=[[10**9] * 10] * 5), FILE_NAME, "runs.0.evaluation.lengths.0.0: Input should be less than"),
    (fields(physics="x" * 16), FILE_NAME, "runs.0.evaluation.physics: String should match pattern"),
]


@pytest.mark.parametrize(("change", "file", "message"), READ)
def test_the_reader_catches(cheat, capsys, board, change, file, message):
    cheat.write()
    change(cheat)
    (cheat.folder / FILE_NAME).write_text(json.dumps(cheat.content), encoding="utf-8")
    if message:
        assert message in refused(cheat, capsys, board, file)[0]
    else:
        assert main(["verify", str(cheat.folder)]) == 2
        assert file in capsys.readouterr().err


@pytest.mark.parametrize("field", ["format_version", "runs", "agent", "track"])
def test_a_missing_field_or_another_version_is_named(cheat, capsys, board, field):
    for content, message in (
        ({name: value for name, value in cheat.content.items() if name != field}, f"{field}: Field required"),
        (cheat.content | {"format_version": 3}, "format_version: Input should be 1 or 2"),
        (cheat.content | {"label": "re-run"}, "label: Extra inputs are not permitted"),
    ):
        (cheat.folder / FILE_NAME).write_text(json.dumps(content), encoding="utf-8")
        assert message in refused(cheat, capsys, board, FILE_NAME)[0]


@pytest.mark.parametrize("name", ["actions", "states"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_named_by_episode_and_step(cheat, capsys, board, name, value):
    getattr(cheat, name)[17][1, 0] = value
    cheat.write()
    step = 1 if name == "actions" else 10
    message = f"{name}: episode 17, step {step}: a number is not finite"
    assert message in refused(cheat, capsys, board, TRACE)[0]
