"""Traces: the bits of the episodes, each where it belongs, and nothing else is taken for one."""

import json

import gymnasium
import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.envs import BatchPhysics
from dynagen_bench.evaluation import RandomPolicy, action_space, evaluate
from dynagen_bench.evaluation.traces import (
    DIGEST_STEPS,
    INTERVAL,
    MAX_HEADER,
    Traces,
    file_size,
    load_traces,
    parse_traces,
    physics_digest,
    save_traces,
    sizes,
    stored_states,
)
from tests.evaluation.samples import with_other_arithmetic


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_trace_has_the_actions_and_states_of_a_plain_gymnasium_loop(robot):
    found = evaluate(RandomPolicy(robot), robot, indices=[2], episodes=2)
    actions, states = np.split(found.traces.actions, [found.lengths[0, 0]]), []
    for episode, seed in enumerate(found.seeds[0]):
        environment = gymnasium.make(f"{robot}-RandDyn-test2")
        environment.reset(seed=int(seed))
        data = environment.unwrapped.data
        states.append(np.concatenate((data.qpos, data.qvel)))
        for step, action in enumerate(actions[episode]):
            environment.step(action)
            if (step + 1) % INTERVAL == 0 or step + 1 == found.lengths[0, episode]:
                states.append(np.concatenate((data.qpos, data.qvel)))
    np.testing.assert_array_equal(found.traces.states, states)
    assert found.traces.actions.dtype == np.float32
    assert sizes(robot) == (action_space(robot).shape[0], states[0].size)


def test_what_the_policy_chose_is_kept_unclipped_and_only_if_wanted():
    class Far:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return np.full((len(observation), 3), 7.5), state

    assert (evaluate(Far(), "Hopper", episodes=1).traces.actions == 7.5).all()
    assert evaluate(Far(), "Hopper", episodes=1, traces=False).traces is None


def made(lengths, robot="Hopper", seed=0):
    """Traces of the right form, of numbers that no physics gave."""
    rng, (width, size) = np.random.default_rng(seed), sizes(robot)
    counts = np.array(lengths, dtype=np.int64)
    actions = rng.standard_normal((counts.sum(), width)).astype(np.float32)
    return Traces(counts, actions, rng.standard_normal((stored_states(counts).sum(), size)))


@given(st.lists(st.integers(1, 200), min_size=1, max_size=5), st.sampled_from(ids.ROBOTS))
@settings(max_examples=30, deadline=None)
def test_what_is_written_is_read_again_within_the_size_that_is_read(lengths, robot):
    before = made(lengths, robot)
    after = parse_traces(before.content, robot, before.lengths)
    assert after.actions.tobytes() == before.actions.tobytes()
    assert after.states.tobytes() == before.states.tobytes()
    assert after.sha256 == before.sha256
    assert len(before.content) <= file_size(robot, before.lengths)
    assert [int(n) for n in stored_states(before.lengths)] == [len(range(0, n, INTERVAL)) + 1 for n in lengths]


@pytest.mark.parametrize("arrange", [np.asfortranarray, lambda array: np.repeat(array, 2, axis=0)[::2]])
def test_the_file_does_not_depend_on_how_the_arrays_lie_in_memory(arrange):
    before = made([12, 200])
    assert Traces(before.lengths, arrange(before.actions), arrange(before.states)).content == before.content


def test_all_robots_with_five_runs_of_full_episodes_take_less_than_16_megabytes():
    sizes_of_robots = [file_size(robot, np.full(50, 200)) for robot in ids.ROBOTS]
    assert 5 * sum(sizes_of_robots) == 13_233_800  # exact but for the headers, for which 1 kB each is allowed


def test_a_file_is_written_whole_and_read_by_its_owner(tmp_path):
    before = made([12, 200])
    save_traces(tmp_path / "new" / "traces.safetensors", before)
    assert load_traces(tmp_path / "new" / "traces.safetensors", "Hopper", before.lengths).sha256 == before.sha256
    with pytest.raises(FileNotFoundError, match="evaluate again, with traces"):
        load_traces(tmp_path / "other", "Hopper", before.lengths)
    with pytest.raises(ValueError, match=r"traces\.safetensors: actions: F32 of shape \[212, 3\]"):
        load_traces(tmp_path / "new" / "traces.safetensors", "Hopper", before.lengths - 1)


def test_the_digest_of_physics_is_the_same_again_and_differs_between_robots():
    digests = {robot: physics_digest.__wrapped__(robot) for robot in ids.ROBOTS}
    assert digests == {robot: physics_digest(robot) for robot in ids.ROBOTS}
    assert len(set(digests.values())) == len(ids.ROBOTS)


def test_the_digest_tells_c_libraries_apart():
    there = with_other_arithmetic(
        "import json; from dynagen_bench import ids; from dynagen_bench.evaluation.traces import physics_digest;"
        "print(json.dumps({robot: physics_digest(robot) for robot in ids.ROBOTS}))"
    )
    assert there.keys() == set(ids.ROBOTS)
    assert [robot for robot in ids.ROBOTS if there[robot] == physics_digest(robot)] == []


@pytest.mark.parametrize("field", ["states", "rewards"])
def test_the_digest_tells_arithmetic_apart_that_differs_in_one_last_bit(field, monkeypatch):
    class Otherwise(BatchPhysics):
        steps = 0

        def step(self, actions, simulations=None):
            result = super().step(actions, simulations)
            self.steps += 1
            if self.steps == DIGEST_STEPS:  # the last one: nothing can grow from it
                numbers = getattr(result, field)
                numbers.flat[-1] = np.nextafter(numbers.flat[-1], np.inf)
            return result

    here = physics_digest("Hopper")
    monkeypatch.setattr("dynagen_bench.evaluation.traces.BatchPhysics", Otherwise)
    assert physics_digest.__wrapped__("Hopper") != here


def content(**changes):
    """A file with other arrays."""
    traces = made([12, 5])
    return safetensors.numpy.save({"actions": traces.actions, "states": traces.states} | changes)


def with_header(header, data=b""):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def one_bad(array, value):
    changed = array.copy()
    changed[13] = value  # of the second episode: its step 1, or the state after the end of a list that is too long
    return changed


@pytest.mark.parametrize(
    ("given_content", "message"),
    [
        (b"", "does not begin with a safetensors header"),
        (b"PK\x03\x04" + bytes(100), "does not begin with a safetensors header"),  # a zip, as .npz
        (b"\x1f\x8b\x08" + bytes(100), "not a trace file"),  # gzip
        (b"\x80\x04\x95" + bytes(100), "does not begin with a safetensors header"),  # a pickle
        (b"\x93NUMPY\x01\x00" + bytes(100), "does not begin with a safetensors header"),
        ((2**63).to_bytes(8, "little"), "does not begin with a safetensors header"),
        ((MAX_HEADER + 1).to_bytes(8, "little") + b" " * 2000, "header of at most 1024 bytes"),
        (with_header(b"[" * 1000), "not a trace file: "),
        (with_header(b"\xff"), "not a trace file: "),
        (with_header({"actions": {"dtype": "F32", "shape": [10**9], "data_offsets": [0, 4 * 10**9]}}), "not a trace"),
        (with_header({"actions": {"dtype": "F32", "shape": [2**62, 4], "data_offsets": [0, 0]}}), "not a trace"),
        (with_header({"__reduce__": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}}), "it holds 1 arrays"),
        (content(rewards=np.zeros(3)), "it holds 3 arrays"),
        (content(actions=np.zeros((17, 3))), r"actions: F64 of shape \[17, 3\], .* have F32 of shape \[17, 3\]"),
        (content(actions=np.zeros((17, 6), np.float32)), r"actions: F32 of shape \[17, 6\]"),
        (content(states=np.zeros((5, 12), np.float32)), "states: F32"),
        (content(states=np.zeros((6, 12))), r"states: F64 of shape \[6, 12\], .* have F64 of shape \[5, 12\]"),
        (content(actions=one_bad(made([12, 5]).actions, np.nan)), "actions: episode 1, step 1: a number is not finite"),
        (content(actions=one_bad(made([12, 5]).actions, -np.inf)), "actions: episode 1, step 1: a number"),
        (content(states=np.full((5, 12), 1e13)), "states: episode 0, step 0: a number is not finite or beyond ±1e.12"),
        (content(states=np.vstack([np.zeros((4, 12)), np.full((1, 12), np.nan)])), "states: episode 1, step 10: "),
        (content() + b"more", "not a trace file"),
        (content()[:-1], "not a trace file"),
    ],
)
def test_any_other_bytes_end_in_one_line(given_content, message):
    with pytest.raises(ValueError, match=message) as caught:
        parse_traces(given_content, "Hopper", np.array([12, 5]))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
