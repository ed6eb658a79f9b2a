"""One dataset from a remote to Minari's root: whole and checked, or not at all.

What is here: `local_record`, `download_dataset` and `download_namespaces`. Called by `dynagen data download`. It must
not know which datasets are wanted, nor how a remote is spoken to.

A dataset arrives in a hidden folder beside its place, `.test3-v0.download`, where no listing sees it. It is moved when
its episodes have been read and are right. After an interruption the folder stays, and the next download goes on in it.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from minari.namespace import NAMESPACE_METADATA_FILENAME

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, dataset_folder
from dynagen_bench.datasets.checks import check_dataset
from dynagen_bench.datasets.manifest import ManifestEntry, check_official
from dynagen_bench.datasets.remotes import Remote, namespace_of, own_metadata
from dynagen_bench.whole import exclusively, whole_folder, write_whole


def arrival_folder(dataset_id: str) -> Path:
    """Where a dataset is while it is downloaded."""
    folder = dataset_folder(dataset_id)
    return folder.with_name(f".{folder.name}.download")


def local_record(name: ids.DynamicsId, every: int, official: ManifestEntry | None) -> DatasetRecord | None:
    """The record of a dataset here that is whole, and official if it can be; None if it has to be fetched."""
    try:
        return check_dataset(dataset_folder(name.part_id(every)), name, every, official)
    except (OSError, ValueError):
        return None  # not there, damaged or another: whatever it is, the remote has better


def download_dataset(
    remote: Remote,
    name: ids.DynamicsId,
    every: int = 1,
    official: ManifestEntry | None = None,
    started: Callable[[int], None] = lambda size: None,
) -> DatasetRecord:
    """Download one dataset, unless it is here already, and put it in place of what there was.

    Args:
        remote: where it is.
        name: the dynamics.
        every: which part of the data.
        official: its entry in the manifest; None checks the episodes against what the dataset itself records.
        started: called with its size in bytes when a download begins.

    Raises:
        ValueError: the remote has it not, or has it damaged or not official; nothing here has changed.
        RuntimeError: the remote did not answer, or not to the end; what came is kept, and is of use the next time.
    """
    dataset_id = name.part_id(every)
    folder, arrival = dataset_folder(dataset_id), arrival_folder(dataset_id)
    with exclusively(folder):
        record = local_record(name, every, official)  # another process may have downloaded it while we waited
        if record is None:
            _check_offered(remote, dataset_id, official)
            for leftover in arrival.rglob("*.incomplete"):
                leftover.unlink()  # of a killed process: huggingface_hub gives each a new name and reads none again
            started(remote.size(dataset_id))
            remote.fetch(dataset_id, arrival)
            record = _checked_arrival(remote, arrival / dataset_id, name, every, official)
            with whole_folder(folder) as unfinished:
                os.replace(arrival / dataset_id / "data", unfinished / "data")
        shutil.rmtree(arrival, ignore_errors=True)
    return record


def _check_offered(remote: Remote, dataset_id: str, official: ManifestEntry | None) -> None:
    """Look at what the remote says it has, before anything large is sent."""
    namespace = namespace_of(dataset_id)
    offered = remote.datasets(namespace)
    if dataset_id not in offered:
        raise ValueError(f"{dataset_id} is not at {remote.address}, which has {len(offered)} datasets in {namespace}")
    if official is not None:
        try:
            check_official(dataset_id, remote.record(dataset_id), official)
        except ValueError as error:
            raise ValueError(f"{remote.address}: {error}") from error


def _checked_arrival(
    remote: Remote, arrived: Path, name: ids.DynamicsId, every: int, official: ManifestEntry | None
) -> DatasetRecord:
    dataset_id = name.part_id(every)
    missing = [file for file in ("metadata.json", "main_data.hdf5") if not (arrived / "data" / file).is_file()]
    if missing:  # huggingface_hub, for one, says nothing when the hub is lost after the first file
        raise RuntimeError(
            f"{remote.address} sent {dataset_id} without {missing[0]}: give the same command again, and if that does "
            "not help, publish the dataset there again"
        )
    try:
        return check_dataset(arrived, name, every, official)
    except ValueError as error:
        shutil.rmtree(arrival_folder(dataset_id))
        raise ValueError(f"refused what {remote.address} sent, nothing here has changed: {error}") from error


def download_namespaces(remote: Remote, namespaces: list[str]) -> None:
    """Download the metadata of namespaces that have none here, as far as the remote has them.

    Minari's own functions want them. What a remote on Hugging Face adds about its own listing is left out: it is not
    true of this machine, nor of another remote that is published to from here.
    """
    wanted = [name for name in namespaces if not (dataset_folder(name) / NAMESPACE_METADATA_FILENAME).is_file()]
    if not wanted:
        return
    for namespace in [name for name in wanted if name in remote.namespaces()]:
        with tempfile.TemporaryDirectory() as root:
            remote.fetch_namespace(namespace, Path(root))
            text = (Path(root) / namespace / NAMESPACE_METADATA_FILENAME).read_text(encoding="utf-8")
        write_whole(dataset_folder(namespace) / NAMESPACE_METADATA_FILENAME, json.dumps(own_metadata(json.loads(text))))
