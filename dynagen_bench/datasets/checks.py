"""Whether a dataset is what it says it is, and what the manifest says it should be.

What is here: `check_dataset`, which reads everything, and the check of MuJoCo's version. Called by `dynagen data
verify`, before a dataset is published and after it was downloaded. It must not know where a dataset came from.

The content hash covers each episode's seed, snapshot, policy and numbers. The rest of an episode (flags, its metadata)
and the totals, spaces and environment in `metadata.json` follow from these, and are compared with what they must be.
Free space inside an HDF5 file, and texts such as the description, may change: nothing computes with them.
"""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import gymnasium
import h5py
import numpy as np
from minari.dataset.minari_storage import MinariStorage

from dynagen_bench import ids
from dynagen_bench.collection.contents import (
    DatasetRecord,
    content_hash,
    read_episodes,
    read_record,
    returns_summary,
)
from dynagen_bench.collection.episodes import Episode
from dynagen_bench.datasets.manifest import ManifestEntry, check_official


def check_dataset(
    folder: Path, name: ids.DynamicsId, every: int = 1, official: ManifestEntry | None = None
) -> DatasetRecord:
    """Read a whole dataset and compare it with what it records and with the manifest; return its record.

    Args:
        folder: where it is, in Minari's root or not.
        name: the dynamics that it is of.
        every: which part of the data it is.
        official: its entry in the manifest, if there is one.

    Raises:
        FileNotFoundError: there is no dataset.
        ValueError: the first thing that is not right.
    """
    dataset_id = name.part_id(every)
    record = read_record(folder)
    try:
        problem = (
            _metadata_problem(folder, name, every, record)
            or _content_problem(folder, name, record)
            or _reference_problem(folder, every, record)
        )
    except Exception as error:  # a changed byte makes h5py, numpy or Minari fail in any way they can
        reason = next(iter(str(error).splitlines()), "no reason given")
        problem = f"it cannot be read, {type(error).__name__}: {reason}"
    if problem:
        raise ValueError(f"{dataset_id} is damaged ({problem})")
    if official is not None:
        check_official(dataset_id, record, official)
        if record.mujoco != official.mujoco:
            raise ValueError(
                f"{dataset_id} records MuJoCo {record.mujoco}, the manifest {official.mujoco}, for the same episodes"
            )
    return record


def check_mujoco(dataset_id: str, record: DatasetRecord) -> None:
    """Compare the MuJoCo that made a dataset with the one that is installed.

    Raises:
        ValueError: they differ.
    """
    if record.mujoco != version("mujoco"):
        raise ValueError(
            f"{dataset_id} was made with MuJoCo {record.mujoco}, here is {version('mujoco')}: install "
            f"mujoco=={record.mujoco}, or build the data again"
        )


def _metadata_problem(folder: Path, name: ids.DynamicsId, every: int, record: DatasetRecord) -> str | None:
    """What is wrong in `metadata.json`, beside what the episodes tell."""
    storage = MinariStorage.read(folder / "data")
    metadata = storage.metadata
    minaris: dict[str, Any] = {
        "dataset_id": name.part_id(every),
        "total_episodes": record.episodes,
        "total_steps": record.steps,
        "data_format": "hdf5",
    }
    # each held against the place it is read from: a recipe is any mapping, and must not answer for Minari's fields
    for place, expected in ((metadata, minaris), (record.recipe, {"dynamics": name.env_id, "every": every})):
        for field, value in expected.items():
            if place[field] != value:
                return f"its metadata say {field} {place[field]!r}, not {value!r}"
    env = gymnasium.make(name.env_id)
    env.close()
    if (storage.observation_space, storage.action_space) != (env.observation_space, env.action_space):
        return f"its spaces are not those of {name.env_id}"
    assert env.spec is not None, "an environment made by its id has a spec"
    if any(_made_by(metadata[field]) != _made_by(env.spec.to_json()) for field in ("env_spec", "eval_env_spec")):
        return f"its environment is not {name.env_id}"
    return None


MADE_BY: Final = (
    "id",
    "kwargs",
    "entry_point",
    "vector_entry_point",
    "max_episode_steps",
    "additional_wrappers",
    "order_enforce",
    "nondeterministic",
    "reward_threshold",
)
"""Fields of an environment's spec that decide what `recover_environment` makes, and runs: an entry point is any code.
Others may change between releases of Gymnasium."""


def _made_by(env_spec: str) -> dict[str, Any]:
    spec = json.loads(env_spec)
    return {field: spec.get(field) for field in MADE_BY}


def _content_problem(folder: Path, name: ids.DynamicsId, record: DatasetRecord) -> str | None:
    """What is wrong with the episodes."""
    with h5py.File(folder / "data" / "main_data.hdf5", "r") as file:
        wanted = {f"episode_{number}" for number in range(record.episodes)}
        if missing := sorted(wanted - set(file), key=lambda group: int(group.partition("_")[2])):
            return f"{len(missing)} of its {record.episodes} episodes are missing, the first is {missing[0]}"
        if extra := sorted(set(file) - wanted):
            return f"it has {extra[0]} beside its {record.episodes} episodes"
    episodes = list(read_episodes(folder))
    found = content_hash(episodes)
    if found != record.sha256:
        return f"its episodes have sha256 {found[:12]}, not {record.sha256[:12]}, which it records"
    returns = [episode.total_reward for episode in episodes]
    if (dict(record.returns), record.steps) != (returns_summary(returns), sum(map(len, episodes))):
        return "its returns or number of steps are not those that it records"
    return _episode_problem(folder, name, record, episodes)


def _reference_problem(folder: Path, every: int, record: DatasetRecord) -> str | None:
    """What is wrong with what Minari normalises scores by; a part's are those of the whole data, which are not here."""
    metadata, own = MinariStorage.read(folder / "data").metadata, (record.returns["min"], record.returns["max"])
    if every == 1 and (metadata["ref_min_score"], metadata["ref_max_score"]) != own:
        return "its reference scores are not the lowest and the highest of its returns"
    return None


def _episode_problem(folder: Path, name: ids.DynamicsId, record: DatasetRecord, episodes: list[Episode]) -> str | None:
    """What is wrong in those parts of an episode that the content hash leaves out, as they follow from the rest."""
    policies = record.recipe["policies"]
    with h5py.File(folder / "data" / "main_data.hdf5", "r") as file:
        for number, episode in enumerate(episodes):
            group = file[f"episode_{number}"]
            flags = np.zeros((2, len(episode)), dtype=np.bool_)
            flags[:, -1] = episode.terminated, episode.truncated
            expected: dict[str, Any] = {"id": number, "total_steps": len(episode), "dynamics": name.env_id}
            found = {field: group.attrs[field] for field in expected}
            stored = np.stack([group["terminations"][:], group["truncations"][:]])
            # as bytes: a boolean that was damaged is 2 or 255 in the file, and still true
            flags_differ = stored.tobytes() != flags.tobytes()
            if flags_differ or found != expected or policies.get(str(episode.snapshot)) != episode.policy_hash:
                return f"flags or metadata of episode_{number} do not fit its steps"
    return None
