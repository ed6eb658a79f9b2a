"""What a dataset of the benchmark holds: its episodes, what it says of itself, and the hash it is known by.

What is here: reading a Minari dataset back, and the content hash. Called by the build, by the flat arrays and by
`dynagen data`. It must not know how data are made, nor the manifest.

A dataset lies in Minari's own root (`MINARI_DATASETS_PATH`). Its metadata has, beside Minari's fields, one of ours:

    "dynagen": {"recipe": what the data are a function of, "sha256": what came out, "episodes", "steps", "returns"}

Each episode has `seed` (Minari's own field), `snapshot`, `policy_sha256` and `dynamics`.
"""

import dataclasses
import hashlib
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from minari.dataset.minari_storage import MinariStorage
from minari.storage.datasets_root_dir import get_dataset_path

from dynagen_bench.collection.episodes import Episode


def build_command(robot: str, every: int) -> str:
    """What makes the datasets of a robot, of one in `every` snapshots, on a machine."""
    return f"dynagen data build {robot}" + ("" if every == 1 else f" --every {every}")


@dataclasses.dataclass(frozen=True)
class DatasetRecord:
    """What a dataset says of itself.

    Attributes:
        recipe: what the data are a function of: dynamics, policies, seeds and MuJoCo.
        sha256: `content_hash` of its episodes.
        episodes: number of episodes.
        steps: number of actions.
        returns: `min`, `max` and `mean` of the episodes' returns.

    Raises:
        ValueError: the recipe or the returns are no mapping or lack something, the returns or the hash are of another
            kind, or there are no episodes or steps.
    """

    recipe: Mapping[str, Any]
    sha256: str
    episodes: int
    steps: int
    returns: Mapping[str, float]

    def __post_init__(self) -> None:
        for field, wanted in (
            ("recipe", ("dynamics", "every", "mujoco", "policies")),
            ("returns", ("min", "mean", "max")),
        ):
            given = getattr(self, field)
            if not isinstance(given, Mapping):
                raise ValueError(f"its {field} are no mapping but {given!r}")
            if missing := [key for key in wanted if key not in given]:
                raise ValueError(f"its {field} lack {', '.join(missing)}")
        if not all(isinstance(number, int) and number > 0 for number in (self.episodes, self.steps)):
            raise ValueError(f"it counts {self.episodes!r} episodes and {self.steps!r} steps")
        numbers = self.returns.values()
        # the largest float: no infinity, no NaN, no int beyond all floats
        if not all(isinstance(number, int | float) and abs(number) <= sys.float_info.max for number in numbers):
            raise ValueError(f"its returns are no finite numbers but {dict(self.returns)}")
        if not isinstance(self.sha256, str):
            raise ValueError(f"its sha256 is {self.sha256!r}")

    @property
    def mujoco(self) -> str:
        """The version of MuJoCo that the episodes ran on."""
        return str(self.recipe["mujoco"])

    def is_of(self, episodes: Sequence[Episode]) -> bool:
        """Whether these are the episodes that it tells of: their content, numbers and returns."""
        found = (content_hash(episodes), len(episodes), sum(map(len, episodes)))
        returns = [episode.total_reward for episode in episodes]
        return found == (self.sha256, self.episodes, self.steps) and dict(self.returns) == returns_summary(returns)


def dataset_folder(dataset_id: str) -> Path:
    """Where Minari keeps a dataset on this machine, whether it is there or not."""
    return Path(get_dataset_path(dataset_id))


def add_to_hash(digest: "hashlib._Hash", episode: Episode) -> None:
    """Add an episode to a SHA-256: where it is from, then each array's shape and little-endian bytes."""
    digest.update(f"{episode.seed} {episode.snapshot} {episode.policy_hash} {episode.terminated}".encode())
    for array, dtype in ((episode.observations, "<f8"), (episode.actions, "<f4"), (episode.rewards, "<f8")):
        digest.update(str(array.shape).encode() + np.ascontiguousarray(array, dtype=dtype).tobytes())


def content_hash(episodes: Iterable[Episode]) -> str:
    """SHA-256 of episodes in their order, hexadecimal; of the numbers, and not of a file, which has times in it."""
    digest = hashlib.sha256()
    for episode in episodes:
        add_to_hash(digest, episode)
    return digest.hexdigest()


def returns_summary(returns: Sequence[float]) -> dict[str, float]:
    """`min`, `max` and `mean` of episodes' returns, as a record has them."""
    return {"min": min(returns), "max": max(returns), "mean": float(np.mean(returns))}


def read_record(folder: Path) -> DatasetRecord:
    """What the dataset in a folder says of itself.

    Raises:
        FileNotFoundError: there is no dataset.
        ValueError: it is none of ours.
    """
    if not (folder / "data").is_dir():
        raise FileNotFoundError(f"no dataset at {folder}")
    try:
        metadata = MinariStorage.read_raw_metadata(folder / "data")
        return DatasetRecord(**metadata["dynagen"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{folder} holds no dataset of this benchmark ({error!r}): remove it and build again"
        ) from error


def read_episodes(folder: Path) -> Iterator[Episode]:
    """Yield the episodes of the dataset in a folder, in order, as they were collected."""
    storage = MinariStorage.read(folder / "data")
    numbers = range(storage.total_episodes)
    metadata = storage.get_episode_metadata(numbers)
    for episode, about in zip(storage.get_episodes(numbers), metadata, strict=True):
        yield Episode(
            seed=int(about["seed"]),
            snapshot=int(about["snapshot"]),
            policy_hash=str(about["policy_sha256"]),
            observations=episode["observations"],
            actions=episode["actions"],
            rewards=episode["rewards"],
            terminated=bool(episode["terminations"][-1]),
        )
