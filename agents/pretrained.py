"""Stored weights: one run an agent and robot, in the repository, ready to act.

What is here: `load_agent`, called by `agents.load`, and `store_run`, called by `python -m agents.store`. It must not
know any agent by name, nor the training loop.

    agents/pretrained/dadt-Hopper.safetensors    a checkpoint without its optimiser, and in its metadata the run's
                                                 score and mean return in the test dynamics, its data and its commit
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

import safetensors

from agents import AGENTS, check_agent
from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.interface import Agent
from agents.recording import score_if_known
from agents.trained_run import TrainedRun
from dynagen_bench import ids
from dynagen_bench.evaluation import Evaluation

FOLDER: Final = Path(__file__).with_name("pretrained")

METADATA_KEY: Final = "dynagen-pretrained"
"""Of JSON beside the checkpoint's own."""


def stored(folder: Path = FOLDER) -> list[str]:
    """What is stored, as `dadt-Hopper`."""
    return sorted(path.stem for path in folder.glob("*.safetensors"))


def load_agent(name: str | Path, robot: str | None = None, folder: Path = FOLDER) -> Agent:
    """An agent that was trained before; see `agents.load`."""
    path = _checkpoint_of(Path(name)) if robot is None else _stored_file(str(name), robot, folder)
    checkpoint = load_checkpoint(path, agent=None if robot is None else str(name), robot=robot)
    agent = checkpoint.build_agent()
    if not isinstance(agent, Agent):
        raise ValueError(
            f"{path} is of {checkpoint.agent!r}, which predicts and does not act: give a run of {', '.join(AGENTS)}"
        )
    return agent


def _checkpoint_of(place: Path) -> Path:
    if place.is_file():
        return place
    if place.is_dir():
        return place / "last.safetensors"
    hint = f"; stored weights need a robot too, agents.load({str(place)!r}, 'Hopper')" if str(place) in AGENTS else ""
    raise FileNotFoundError(f"no run folder and no checkpoint at {place}: give one that training wrote{hint}")


def _stored_file(name: str, robot: str, folder: Path) -> Path:
    check_agent(name, AGENTS)
    ids.check_robot(robot)
    path = folder / f"{name}-{robot}.safetensors"
    if f"{name}-{robot}" not in stored(folder):
        raise FileNotFoundError(
            f"no stored weights of {name!r} for {robot!r}, stored are {', '.join(stored(folder)) or 'none'}: make them "
            "with python -m agents.train, and python -m agents.store with its run folder"
        )
    return path


def store_run(run: Path, replace: bool = False, folder: Path = FOLDER) -> Path:
    """Store a finished run's last checkpoint as the weights of its agent and robot; returns the file.

    Args:
        run: folder of a run that training has ended.
        replace: take the place of weights that are stored already.
        folder: where weights are stored.

    Raises:
        FileNotFoundError: it is no finished run.
        ValueError: it is of what does not act, its files do not belong together, or other weights are stored.
    """
    trained = TrainedRun.read(run)
    config, record, checkpoint = trained.config, trained.record, trained.checkpoint
    path = folder / f"{checkpoint.agent}-{checkpoint.spec.robot}.safetensors"
    if path.exists() and not replace:
        raise ValueError(f"{path} is there, with score {read_about(path)['score']}: give --replace to store this run")
    evaluation = Evaluation.from_json(record["evaluation"])
    about = {
        "score": score_if_known(evaluation).get("test_score"),
        "mean_return": float(evaluation.returns.mean()),
        "settings": config["settings"],
        "data": config["data"],
        "commit": config["commit"],
        "command": config.get("command"),
    }
    notes = {METADATA_KEY: json.dumps(about, default=str)}
    save_checkpoint(path, dataclasses.replace(checkpoint, optimizer={}), notes)
    return path


def read_about(path: Path) -> dict[str, Any]:
    """What stored weights tell of their run.

    Its `score` (None without reference scores), `mean_return`, `settings`, `data`, `commit` and `command`.

    Raises:
        ValueError: the file is not stored by `store_run`.
    """
    with safetensors.safe_open(path, framework="pt") as file:
        text = (file.metadata() or {}).get(METADATA_KEY)
    if text is None:
        raise ValueError(f"{path} tells nothing of its run: store it by python -m agents.store")
    about: dict[str, Any] = json.loads(text)
    return about
