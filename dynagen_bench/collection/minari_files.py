"""The data of one dynamics as a Minari dataset, made from stored policies: whole, or not at all.

What is here: `build_dataset`. Called by `dynagen data build`. It must not know the manifest, windows or agents; what a
dataset holds is in `contents`.
"""

import concurrent.futures
import contextlib
import dataclasses
import hashlib
import itertools
import json
import shutil
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, TypeVar

import gymnasium
import numpy as np
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage
from minari.namespace import NAMESPACE_METADATA_FILENAME, create_namespace, get_namespace_metadata

from dynagen_bench import ids
from dynagen_bench.collection.contents import (
    DatasetRecord,
    add_to_hash,
    dataset_folder,
    read_episodes,
    read_record,
    returns_summary,
)
from dynagen_bench.collection.episodes import EPISODES_PER_SNAPSHOT, SEED, Episode, collect_episodes
from dynagen_bench.collection.policies import POLICY_FOLDER, BehaviourPolicy, load_policies, policy_file
from dynagen_bench.dynamics import drawn_factors, load_dynamics
from dynagen_bench.envs import HORIZON
from dynagen_bench.whole import exclusively, whole_folder

AUTHOR: Final = "DynaGen Bench contributors"

EPISODE_BYTES: Final = 25_000
"""More than an episode takes on the disk beside its numbers: HDF5 itself has been seen to take 16,400 to 17,800."""

Progress = Callable[[int, int], None]
"""Called as `progress(episodes done, episodes in all)`."""

_Item = TypeVar("_Item")


def every_nth(snapshots: Mapping[int, BehaviourPolicy], every: int) -> dict[int, BehaviourPolicy]:
    """Each n-th snapshot: of twenty, `every=4` takes those at 200K, 400K, ..., 1M steps.

    Raises:
        ValueError: `every` is not a whole number from 1 to the number of snapshots.
    """
    step = ids.check_count("every", every, most=len(snapshots))
    return dict(list(snapshots.items())[step - 1 :: step])


def build_dataset(
    name: ids.DynamicsId,
    *,
    policies_folder: Path = POLICY_FOLDER,
    episodes_per_snapshot: int = EPISODES_PER_SNAPSHOT,
    every: int = 1,
    expected_sha256: str | None = None,
    reference: tuple[float, float] | None = None,
    progress: Progress = lambda done, total: None,
) -> DatasetRecord:
    """Make the Minari dataset of one dynamics, `name.part_id(every)`, or keep the one there is.

    One is kept if its episodes are those it records, and their hash is the expected one; where none is expected, its
    recipe must be today's. A build killed at any moment leaves what was there before; the next one begins that dataset
    again.

    Args:
        name: the dynamics.
        policies_folder: where the stored policies are, `{robot}/{label}.safetensors`.
        episodes_per_snapshot: the official data have 50.
        every: take every n-th snapshot alone.
        expected_sha256: the official content hash, if one is known.
        reference: min and max return for Minari's `ref_min_score` and `ref_max_score`; None takes the dataset's own.
        progress: called with each episode.

    Raises:
        FileNotFoundError: there are no policies.
        ValueError: the policies are of another dynamics, or `every` or `episodes_per_snapshot` make no sense.
        RuntimeError: an episode was unstable.
        OSError: the disk may have no room for it; nothing is left of it then.
    """
    path = policy_file(name, policies_folder)
    snapshots, policy_metadata = load_policies(path)
    if policy_metadata.get("dynamics") != name.env_id:
        found = policy_metadata.get("dynamics", "no dynamics named")
        raise ValueError(f"{path} holds policies of {found}, not of {name.env_id}: restore it from the repository")
    chosen = every_nth(snapshots, every)
    count = ids.check_count("episodes_per_snapshot", episodes_per_snapshot)
    recipe = _recipe(name, chosen, count, every)
    total = len(chosen) * count
    folder = dataset_folder(name.part_id(every))
    with exclusively(folder), _stopped_between() as check_stopped:
        kept = _intact_record(folder, recipe, expected_sha256)
        _ensure_namespace(name.robot)
        if kept is None:
            episodes = _counted(collect_episodes(name, chosen, count), total, progress)
            with whole_folder(folder) as unfinished:
                kept = _write(unfinished, name, recipe, episodes, reference, check_stopped)
    progress(total, total)
    return kept


def _recipe(
    name: ids.DynamicsId, snapshots: Mapping[int, BehaviourPolicy], episodes_per_snapshot: int, every: int
) -> dict[str, Any]:
    factors = json.dumps(drawn_factors(load_dynamics(name.robot, name.split, name.index)), sort_keys=True)
    return {
        "dynamics": name.env_id,
        "dynamics_sha256": hashlib.sha256(factors.encode()).hexdigest(),
        "every": int(every),
        "policies": {str(snapshot): policy.content_hash() for snapshot, policy in snapshots.items()},
        "episodes_per_snapshot": episodes_per_snapshot,
        "seed": SEED,
        "mujoco": version("mujoco"),
    }


def _counted(items: Iterator[_Item], total: int, progress: Progress) -> Iterator[_Item]:
    for done, item in enumerate(items):
        progress(done, total)
        yield item


def _ahead(items: Iterator[_Item], size: int, check_stopped: Callable[[], None]) -> Generator[list[_Item], None, None]:
    """The items in lists of `size`, each made while the one before it is used: physics runs while files are written.

    Closing it waits for the list that is being made: a process that ends while a thread steps physics crashes.
    """
    with concurrent.futures.ThreadPoolExecutor(max_workers=1) as thread:
        coming = thread.submit(lambda: list(itertools.islice(items, size)))
        while batch := coming.result():
            check_stopped()  # here, where no list is being made that would be waited for
            coming = thread.submit(lambda: list(itertools.islice(items, size)))
            yield batch


@contextlib.contextmanager
def _stopped_between() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back; what is yielded raises KeyboardInterrupt if there has been one, as the end of the block does.

    Raised at any moment it may be in h5py, which drops it, or end the wait for the thread that steps physics.
    """
    asked: list[int] = []

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()  # no other thread is interrupted, or may ask
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield check
        return
    signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    check()


def _intact_record(folder: Path, recipe: Mapping[str, Any], expected_sha256: str | None) -> DatasetRecord | None:
    """The record of a finished dataset that need not be made again, or None."""
    try:
        record = read_record(folder)
        right = record.recipe == recipe if expected_sha256 is None else record.sha256 == expected_sha256
        if not right:
            return None
        return record if record.is_of(list(read_episodes(folder))) else None
    except Exception:  # a changed byte makes h5py, numpy or Minari fail in any way they can
        return None  # not there, or damaged: whatever is wrong with it, it is made again


def _ensure_namespace(robot: str) -> None:
    namespace = f"{ids.NAMESPACE}/{robot}-RandDyn"
    with exclusively(dataset_folder(namespace)):
        try:
            get_namespace_metadata(namespace)
        except ValueError:  # none, or one that was killed while it was written
            (dataset_folder(namespace) / NAMESPACE_METADATA_FILENAME).unlink(missing_ok=True)
            create_namespace(namespace, f"{robot}: logged data of 20 train and 5 test dynamics.")


def _write(
    folder: Path,
    name: ids.DynamicsId,
    recipe: Mapping[str, Any],
    episodes: Iterator[Episode],
    reference: tuple[float, float] | None,
    check_stopped: Callable[[], None],
) -> DatasetRecord:
    env = gymnasium.make(name.env_id)
    assert env.spec is not None, "an environment made by its id has a spec"
    _check_room(folder, env, len(recipe["policies"]) * int(recipe["episodes_per_snapshot"]))
    (folder / "data").mkdir()
    storage = MinariStorage.new(
        folder / "data",
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
        data_format="hdf5",
    )
    storage.update_metadata(_metadata(name, recipe, env.spec.to_json()))
    env.close()

    digest, lengths, returns = hashlib.sha256(), list[int](), list[float]()
    size = int(recipe["episodes_per_snapshot"])
    with contextlib.closing(_ahead(episodes, size, check_stopped)) as batches:
        for batch in batches:
            storage.update_episodes([_buffer(episode) for episode in batch])
            about = [{"snapshot": e.snapshot, "policy_sha256": e.policy_hash, "dynamics": name.env_id} for e in batch]
            storage.update_episode_metadata(about, range(len(lengths), len(lengths) + len(batch)))
            for episode in batch:
                add_to_hash(digest, episode)
                lengths.append(len(episode))
                returns.append(episode.total_reward)

    low, high = reference or (min(returns), max(returns))
    record = DatasetRecord(recipe, digest.hexdigest(), len(lengths), sum(lengths), returns_summary(returns))
    storage.update_metadata({"dynagen": dataclasses.asdict(record), "ref_min_score": low, "ref_max_score": high})
    return record


def _check_room(folder: Path, env: gymnasium.Env[Any, Any], episodes: int) -> None:
    """Refuse what the disk may not hold when all episodes are long: on a full one h5py ends the process.

    Raises:
        OSError: there is not enough.
    """
    row = env.observation_space.sample().nbytes + env.action_space.sample().nbytes + 10  # and a reward and two flags
    size = episodes * (HORIZON * row + EPISODE_BYTES)
    if shutil.disk_usage(folder).free < size:
        raise OSError(
            f"no room for {size / 1e6:.1f} MB in {dataset_folder(ids.NAMESPACE)}: make some there, or let "
            "MINARI_DATASETS_PATH name a folder that has more"
        )


def _metadata(name: ids.DynamicsId, recipe: Mapping[str, Any], env_spec: str) -> dict[str, Any]:
    """Minari's own fields of a dataset."""
    every = int(recipe["every"])
    part = "" if every == 1 else f" This is a part, one snapshot in {every}, for quick runs and not for scores."
    major, minor, *_ = version("gymnasium").split(".")
    return {
        "dataset_id": name.part_id(every),
        "eval_env_spec": env_spec,
        "algorithm_name": "SAC",
        "author": {AUTHOR},
        "minari_version": version("minari"),
        "requirements": [
            f"dynagen-bench=={version('dynagen-bench')}",
            f"mujoco=={version('mujoco')}",
            f"gymnasium~={major}.{minor}.0",
        ],
        "description": (
            f"{name.robot} with the dynamics {name.label} of DynaGen Bench: {recipe['episodes_per_snapshot']} "
            f"stochastic episodes of each of {len(recipe['policies'])} snapshots of one SAC run, horizon {HORIZON}."
            f"{part} Every episode's metadata has its reset seed, its snapshot (environment steps) and the SHA-256 of "
            "its policy; seed and actions replay it bit for bit."
        ),
    }


def _buffer(episode: Episode) -> EpisodeBuffer:
    terminations = np.zeros(len(episode), dtype=np.bool_)
    truncations = terminations.copy()
    terminations[-1], truncations[-1] = episode.terminated, episode.truncated
    return EpisodeBuffer(
        seed=episode.seed,
        observations=episode.observations,
        actions=episode.actions,
        rewards=episode.rewards,
        terminations=terminations,
        truncations=truncations,
    )
