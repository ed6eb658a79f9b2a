"""Kept runs with round numbers, and a board whose scores one can compute in the head."""

import json

import pytest

from agents import AGENTS
from dynagen_bench.datasets import scores
from tests.evaluation.samples import evaluation, write_references


@pytest.fixture(autouse=True)
def references(tmp_path, monkeypatch):
    """Reference scores on which a score is half the mean return (see `samples.write_references`)."""
    file = tmp_path / "references" / "reference_scores.json"
    file.parent.mkdir()
    write_references(file)
    monkeypatch.setattr(scores, "REFERENCE_FILE", file)


@pytest.fixture
def trained(tmp_path):
    """Makes a run folder as training leaves it: `trained(agent, seed, errors=..., score=..., ...)`."""

    def make(agent, seed=0, *, robot="Hopper", score=None, errors=None, commit="a" * 40, settings=None, **config):
        folder = tmp_path / "trained" / f"{agent}-{robot}-seed{seed}-{len(list(tmp_path.glob('trained/*')))}"
        folder.mkdir(parents=True)
        about = {
            "agent": agent,
            "config": {"steps": 200, "learning_rate": 1e-3, "warmup_steps": 500, "batch_size": 64, **config},
            "settings": {"robot": robot, "seed": seed, "runs": "/home/somebody/runs", "threads": 1, **(settings or {})},
            "data": {},
            "commit": commit,
            "command": f"python -m agents.train {agent} --runs /home/somebody/runs --threads 1 --seed {seed}",
        }
        (folder / "config.json").write_text(json.dumps(about))
        last = "" if score is None else f"{score}"
        (folder / "curves.csv").write_text(f"step,loss,seconds,test_score\n100,1.0,30,\n200,0.5,60,{last}\n")
        if agent in AGENTS:
            result = {"gradient_steps": 200, "evaluation": evaluation(robot, 2 * (score or 0.0)).to_json()}
            (folder / "evaluation.json").write_text(json.dumps(result))
        if errors is not None:
            prediction = {"robot": robot, "split": "test", "errors": errors, "unchanged": [0.09] * 5}
            record = {"agent": agent, "every": 1, "episodes": 200, "gradient_steps": 200, "prediction": prediction}
            (folder / "prediction.json").write_text(json.dumps(record))
        (folder / "last.safetensors").write_bytes(b"weights")
        return folder

    return make
