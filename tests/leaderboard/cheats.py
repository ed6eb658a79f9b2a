"""An honest submission taken apart, for the tests that cheat with it."""

import hashlib
import json

import numpy as np
import pytest

from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.envs import HORIZON, BatchPhysics
from dynagen_bench.evaluation.submission import FILE_NAME
from dynagen_bench.evaluation.traces import Recorder, Traces, load_traces, stored_states
from leaderboard.__main__ import main
from leaderboard.board import PAGE

TRACE = "traces/Hopper-seed0.safetensors"


class Cheat:
    """An honest submission of one Hopper run, taken apart so that a test can change it and put it together again.

    Attributes:
        content: what is in `submission.json`.
        lengths: (50,) int64; episode e of test dynamics i is number 10·i + e.
        actions, states: lists of 50 arrays, an episode's.
    """

    def __init__(self, folder) -> None:
        self.folder = folder
        self.content = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
        self.lengths = np.array(self.evaluation["lengths"]).ravel()
        traces = load_traces(folder / TRACE, "Hopper", self.lengths)
        self.actions = np.split(traces.actions.copy(), np.cumsum(self.lengths)[:-1])
        self.states = np.split(traces.states.copy(), np.cumsum(stored_states(self.lengths))[:-1])

    @property
    def evaluation(self):
        return self.content["runs"][0]["evaluation"]

    def take(self, episode, other):
        """Episode becomes a copy of another one, with its length and return."""
        self.actions[episode], self.states[episode] = self.actions[other].copy(), self.states[other].copy()
        for name in ("lengths", "returns"):
            self.evaluation[name][episode // 10][episode % 10] = self.evaluation[name][other // 10][other % 10]

    def stand_still(self, episode):
        """The episode without an action, from its own start to its end."""
        physics = BatchPhysics("Hopper", [load_dynamics("Hopper", "test", episode // 10)])
        physics.states[0] = self.states[episode][0]
        recorder, still, returned = Recorder(physics.states, 3), np.zeros((1, 3), np.float32), 0.0
        for step in range(HORIZON):
            result = physics.step(still)
            recorder.add(step, np.arange(1), still, result.states, result.terminated)
            returned += float(result.rewards[0])
            if result.terminated[0]:
                break
        traces = recorder.traces(np.array([step + 1]))
        self.actions[episode], self.states[episode] = traces.actions, traces.states
        self.evaluation["lengths"][episode // 10][episode % 10] = step + 1
        self.evaluation["returns"][episode // 10][episode % 10] = returned

    def write(self):
        lengths = np.array([len(actions) for actions in self.actions])
        traces = Traces(lengths, np.concatenate(self.actions), np.concatenate(self.states))
        self.write_trace(traces.content)

    def write_trace(self, data):
        (self.folder / TRACE).write_bytes(data)
        self.content["runs"][0]["trace"] = hashlib.sha256(data).hexdigest()
        (self.folder / FILE_NAME).write_text(json.dumps(self.content), encoding="utf-8")


def refused(cheat, capsys, board, where):
    """The faults that `verify` says, one line each; the board takes nothing."""
    assert main(["verify", str(cheat.folder)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith(f"leaderboard: {cheat.folder}/{where}: ")
    for line in lines:
        assert line.startswith(f"leaderboard: {cheat.folder}/")
        assert line.isprintable()
        assert len(line) < 700
    with pytest.raises(SystemExit, match=r"\Aleaderboard: [^\n]+\Z"):
        main(["submit", str(cheat.folder), "--board", str(board)])
    assert not (board / PAGE).exists()
    return lines
