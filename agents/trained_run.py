"""A run that training has ended, as what is done with its last checkpoint needs it.

What is here: `TrainedRun`, `check_finished` and `held_out_names`. Called by `adapt`, `evaluate`, `targets`,
`fine_tuning` and `pretrained`. It must not know what is done.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

from agents import AGENTS
from agents.checkpoint import Checkpoint, load_checkpoint, package_versions
from agents.run_folder import locked, read_finished
from agents.validation import held_out_indices
from dynagen_bench import ids
from dynagen_bench.datasets import OfflineDataset, load_adaptation


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """A run that training has ended: what its folder says.

    Attributes:
        folder: of the run.
        config, record: config.json and evaluation.json.
        checkpoint: the last one.
    """

    folder: Path
    config: dict[str, Any]
    record: dict[str, Any]
    checkpoint: Checkpoint

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a run of an agent.

        Raises:
            FileNotFoundError: the folder is no finished run.
            ValueError: the run is of a predictor, was not trained to its end, or its checkpoint is of another run or
                step.
        """
        config, record = read_finished(folder, AGENTS)
        agent, robot = config["agent"], config["settings"]["robot"]
        checkpoint = load_checkpoint(folder / "last.safetensors", agent=agent, robot=robot)
        if checkpoint.step != record["gradient_steps"]:
            raise ValueError(
                f"{folder}/last.safetensors is at step {checkpoint.step}, its evaluation of step "
                f"{record['gradient_steps']}: give the command that trains it again"
            )
        return cls(folder, config, record, checkpoint)

    @classmethod
    @contextlib.contextmanager
    def held(cls, folder: Path) -> Iterator[Self]:
        """Read a run and be the only process in its folder: what is measured of the checkpoint and written is of it.

        Raises as `read`, and ValueError where another process works in the folder.
        """
        read_finished(folder, AGENTS)  # a folder that is no run gets no lock
        with locked(folder):
            yield cls.read(folder)

    @property
    def facts(self) -> dict[str, Any]:
        """What a result of the run is made of: it is the same for the same."""
        return {
            "agent": self.checkpoint.agent,
            "seed": self.checkpoint.seed,
            "trained_steps": self.checkpoint.step,
            "versions": package_versions(),
        }

    def data(self, names: Sequence[ids.DynamicsId], episodes: int) -> list[OfflineDataset]:
        """The adaptation set of each dynamics, from the part of the snapshots that the run was trained on."""
        every = self.config["settings"]["every"]
        return [load_adaptation(x.robot, x.index, split=x.split, episodes=episodes, every=every) for x in names]


def check_finished(runs: Sequence[Path]) -> None:
    """Look at the folders of several runs of agents, so that a wrong one is told before the others are worked on.

    Raises:
        FileNotFoundError, ValueError: as `TrainedRun.read`, but for the checkpoints; or there are none.
    """
    if not runs:
        raise ValueError("no runs given: name at least one run folder")
    for folder in runs:
        read_finished(folder, AGENTS)


def held_out_names(run: TrainedRun) -> list[ids.DynamicsId]:
    """The train dynamics that a run held out; raises ValueError if it held out none."""
    count = run.config["settings"]["hold_out"]
    if count == 0:
        raise ValueError(
            f"{run.folder} held out no train dynamics: train one with --hold-out, nothing is chosen by test dynamics"
        )
    return ids.choose_ids(run.checkpoint.spec.robot, "train", held_out_indices(count))
