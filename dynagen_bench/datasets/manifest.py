"""The manifest: content hashes of the official datasets, and whether one here is official.

What is here: reading, checking and writing `manifest.json`. Called by `dynagen data`, also by its checks, downloads and
data cards. It must not know how data are made.
"""

import dataclasses
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal

from dynagen_bench.collection.contents import DatasetRecord
from dynagen_bench.whole import stored_json, update_json

RECORDS: Final = Path(__file__).parent
"""The folder of `manifest.json` and `reference_scores.json`, committed in the package."""


@dataclasses.dataclass(frozen=True)
class ManifestEntry:
    """The official content of one dataset.

    Attributes:
        sha256: content hash (`collection.contents.content_hash`).
        episodes: number of episodes.
        steps: number of actions.
        mujoco: version of MuJoCo that the episodes ran on.
    """

    sha256: str
    episodes: int
    steps: int
    mujoco: str

    @classmethod
    def of(cls, record: DatasetRecord) -> "ManifestEntry":
        """The entry of a dataset that is there."""
        return cls(record.sha256, record.episodes, record.steps, record.mujoco)


def manifest_file(records: Path = RECORDS) -> Path:
    """Where the manifest is kept."""
    return records / "manifest.json"


def read_manifest(records: Path = RECORDS) -> dict[str, ManifestEntry]:
    """Dataset id → entry; empty where there is no manifest yet.

    Raises:
        ValueError: the file is no manifest.
    """
    try:
        return {dataset_id: ManifestEntry(**entry) for dataset_id, entry in stored_json(manifest_file(records)).items()}
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{manifest_file(records)} is no manifest ({error}): restore it from the repository"
        ) from error


def add_to_manifest(entries: Mapping[str, ManifestEntry], records: Path = RECORDS) -> None:
    """Write entries (dataset id → entry) into the manifest, and leave the others as they are."""
    update_json(manifest_file(records), {key: dataclasses.asdict(entry) for key, entry in entries.items()})


def standing(record: DatasetRecord, entry: ManifestEntry | None) -> Literal["official", "differs", "unlisted"]:
    """How a dataset stands to its entry in the manifest, or to None where it has none."""
    if entry is None:
        return "unlisted"
    return "official" if record.sha256 == entry.sha256 else "differs"


def check_official(dataset_id: str, record: DatasetRecord, entry: ManifestEntry) -> None:
    """Compare a dataset with its entry in the manifest.

    Raises:
        ValueError: they differ; the message says how, and what a likely cause is.
    """
    if standing(record, entry) == "official":
        return
    reason = "the policies, the code or the processor's arithmetic differ from the official ones"
    if record.mujoco != entry.mujoco:
        reason = f"install mujoco=={entry.mujoco} and build again (it was built with {record.mujoco})"
    elif version("mujoco") != entry.mujoco:
        reason = f"install mujoco=={entry.mujoco} (here is {version('mujoco')})"
    raise ValueError(
        f"{dataset_id} is not the official data: it has {record.episodes} episodes, {record.steps} steps, sha256 "
        f"{record.sha256[:12]}, the manifest {entry.episodes}, {entry.steps}, {entry.sha256[:12]}; {reason}"
    )
