"""The page on writing one's own agent: 60 lines, no help of ours, and what it says of `agents/` holds."""

import os
import re
import subprocess
import sys

import pytest

import agents
from agents.run_folder import RunSettings, read_curve
from agents.train import train
from dynagen_bench.evaluation.submission import read_submission
from leaderboard.verify import verify
from tests.agents.samples import random_dataset
from tests.test_documents import ROOT, blocks, smaller

PAGE = ROOT / "docs" / "your-agent.md"


@pytest.fixture
def written(tmp_path, tiny_data, monkeypatch):
    """What the page's code has made, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for code in blocks(PAGE, "python"):
        exec(compile(smaller(code), str(PAGE), "exec"), namespace)
    return namespace


def test_a_whole_agent_has_60_lines_and_is_the_first_block_alone():
    whole, plugged = blocks(PAGE, "python")
    assert len(whole.splitlines()) <= 60
    assert "agents" not in whole
    assert len(plugged.splitlines()) < 30


def test_its_submission_is_replayed(written, tmp_path):
    found = read_submission(tmp_path / "my-entry")
    assert (found.agent, found.runs[0].gradient_steps) == ("GRU", 5)
    assert [check.label for check in verify(tmp_path / "my-entry", found)] == ["replayed"]


CONTRACT = """
import sys
import pytest
import agents
from tests.test_documents import ROOT, blocks, smaller
page = {}
for code in blocks(ROOT / "docs" / "your-agent.md", "python"):
    exec(smaller(code), page)
for known in (agents.AGENTS, agents.TRAINABLE):
    known["gru"] = page["GRUConfig"], page["GRUAgent"]
sys.exit(pytest.main([*sys.argv[1:], "-k", "gru", "-q", "-p", "no:cacheprovider"]))
"""


def test_the_contract_tests_hold_for_it(tiny_data, tmp_path):
    """As for whoever follows the page: with the agent in `AGENTS`, the tests of all agents run on it too."""
    files = [
        str(ROOT / "tests" / "agents" / f"test_{part}.py") for part in ("agents", "config", "dadt", "train", "adapt")
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MINARI_DATASETS_PATH": str(tiny_data)}
    command = [sys.executable, "-c", CONTRACT, *files, f"--rootdir={ROOT}", f"--basetemp={tmp_path / 'contract'}"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert len(re.findall(r"^[.]{10,}", done.stdout, re.MULTILINE)) == 1  # so many tests, and all of them pass


def test_it_is_trained_as_one_of_the_agents(written, tmp_path, monkeypatch):
    for known in (agents.AGENTS, agents.TRAINABLE):
        monkeypatch.setitem(known, "gru", (written["GRUConfig"], written["GRUAgent"]))
    settings = RunSettings("Hopper", runs=tmp_path, checkpoint_every=1, log_every=1)
    config = written["GRUConfig"](steps=3, hidden=8, warmup_steps=0)
    folder = train("gru", config, settings, random_dataset())
    assert [step for step, _ in read_curve(folder, "action_loss")] == [1, 2, 3]
    assert agents.load(folder).memory.hidden_size == 8
