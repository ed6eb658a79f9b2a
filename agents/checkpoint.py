"""Checkpoints: one safetensors file with all that a run needs to go on, or an agent to act.

What is here: `Checkpoint`, its file, and the agent in it. Called by training, and by whoever lets a stored agent act.
It must not know the training loop. Nothing in a file is unpickled.

    tensors     parameters/{name}    optimizer/{name}/{slot}    normalization/mean, std    action_limit
    metadata    one JSON text: format version, agent, config, robot, seed, step, seconds, versions

Random states are not in it: the randomness of a step is a function of (seed, step).
"""

import contextlib
import dataclasses
import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor

from agents import TRAINABLE
from agents.config import TrainingConfig
from agents.interface import RobotSpec, Trainable
from dynagen_bench.datasets.normalization import Normalization
from dynagen_bench.whole import whole_file

FORMAT_VERSION: Final = 1
METADATA_KEY: Final = "dynagen-agent"
PACKAGES: Final = ("dynagen-bench", "gymnasium", "mujoco", "numpy", "torch")


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """A run after `step` gradient steps.

    Attributes:
        agent: its name in `TRAINABLE`.
        config, spec: what the agent was made of.
        seed: of the run.
        step: gradient steps done.
        seconds: wall clock of the run so far, evaluations included.
        parameters: name → tensor.
        optimizer: parameter's name → slot of AdamW → tensor; empty where only the agent is kept.
        versions: package → version that wrote it.
    """

    agent: str
    config: TrainingConfig
    spec: RobotSpec
    seed: int
    step: int
    seconds: float
    parameters: Mapping[str, Tensor]
    optimizer: Mapping[str, Mapping[str, Tensor]]
    versions: Mapping[str, str]

    def build_agent(self) -> Trainable:
        """The agent or predictor with these parameters; raises ValueError where they are not those of the config."""
        agent: Trainable = TRAINABLE[self.agent][1](self.config, self.spec, torch.Generator())
        self.fill(agent)
        return agent

    def fill(self, agent: Trainable) -> None:
        """Give an agent of this config these parameters; raises ValueError where it has others."""
        try:
            agent.load_state_dict(self.parameters)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise ValueError(
                f"the parameters are not those that this code's {self.agent!r} has ({reason}): use the code that wrote "
                "them"
            ) from error


def package_versions() -> dict[str, str]:
    """Installed versions of what a result depends on; a package run from a checkout has none."""
    found = {}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def save_checkpoint(path: Path, checkpoint: Checkpoint, notes: Mapping[str, str] | None = None) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: the file.
        checkpoint: what to write.
        notes: key → text, beside the checkpoint's own in the file's metadata.

    Raises:
        OSError: it could not be written (a full disk); the file that was there stays.
    """
    tensors = {f"parameters/{name}": value for name, value in checkpoint.parameters.items()}
    for name, slots in checkpoint.optimizer.items():
        tensors |= {f"optimizer/{name}/{slot}": value for slot, value in slots.items()}
    normalization = checkpoint.spec.normalization
    tensors["normalization/mean"] = torch.from_numpy(normalization.mean)
    tensors["normalization/std"] = torch.from_numpy(normalization.std)
    tensors["action_limit"] = torch.from_numpy(checkpoint.spec.action_limit)
    metadata = {
        "format_version": FORMAT_VERSION,
        "agent": checkpoint.agent,
        "config": dataclasses.asdict(checkpoint.config),
        "robot": checkpoint.spec.robot,
        "seed": checkpoint.seed,
        "step": checkpoint.step,
        "seconds": checkpoint.seconds,
        "versions": dict(checkpoint.versions),
    }
    tensors = {name: value.detach().contiguous() for name, value in tensors.items()}
    texts = {METADATA_KEY: json.dumps(metadata), **(notes or {})}
    try:
        with whole_file(path) as unfinished:
            safetensors.torch.save_file(tensors, unfinished, metadata=texts)
    except (OSError, safetensors.SafetensorError) as error:
        raise OSError(f"{path} could not be written ({error}): make room; what was there is kept") from error


def load_checkpoint(path: Path, *, agent: str | None = None, robot: str | None = None) -> Checkpoint:
    """Read what `save_checkpoint` wrote.

    Args:
        path: the file.
        agent: the agent that it has to be of, if one is wanted.
        robot: the robot that it has to be of, if one is wanted.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no checkpoint, of another format version, or of another agent or robot than wanted.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}: give the file that training wrote, `last.safetensors`")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = json.loads((file.metadata() or {}).get(METADATA_KEY, "null"))
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118, safe_open is no mapping
    except (safetensors.SafetensorError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is no checkpoint ({error}): delete it, or give another file") from error
    if not isinstance(metadata, dict) or "format_version" not in metadata:
        raise ValueError(f"{path} is no checkpoint of an agent: give a file that training wrote, `last.safetensors`")
    if metadata["format_version"] != FORMAT_VERSION:
        found = metadata["format_version"]
        raise ValueError(f"{path} has format version {found}, this code reads {FORMAT_VERSION}: use the code it is of")
    for word, found, wanted in (("agent", metadata["agent"], agent), ("robot", metadata["robot"], robot)):
        if wanted is not None and found != wanted:
            raise ValueError(f"{path} is of {word} {found!r}, not {wanted!r}: give a checkpoint of {wanted!r}")
    return _from_file(path, metadata, tensors)


def _from_file(path: Path, metadata: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> Checkpoint:
    """The checkpoint of a file's parts; raises ValueError where some are missing or unknown."""
    try:
        optimizer: dict[str, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith("optimizer/"):
                _, name, slot = key.split("/")
                optimizer.setdefault(name, {})[slot] = value
        normalization = Normalization(_array(tensors["normalization/mean"]), _array(tensors["normalization/std"]))
        return Checkpoint(
            agent=metadata["agent"],
            config=TRAINABLE[metadata["agent"]][0](**metadata["config"]),
            spec=RobotSpec(metadata["robot"], _array(tensors["action_limit"]), normalization),
            seed=metadata["seed"],
            step=metadata["step"],
            seconds=metadata["seconds"],
            parameters={
                key.removeprefix("parameters/"): value
                for key, value in tensors.items()
                if key.startswith("parameters/")
            },
            optimizer=optimizer,
            versions=metadata["versions"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is no whole checkpoint ({error!r}): delete it, or give another file") from error


def _array(tensor: Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.asarray(tensor.numpy(), dtype=np.float32)
