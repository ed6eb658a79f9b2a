"""Datasets from Minari's root to a tree of files, or to a remote.

What is here: `add_to_tree`, `send_namespaces` and `send_dataset`. Called by `dynagen data publish`, which has checked
the datasets. It must not know the manifest, nor how a remote is spoken to.

A tree is laid out as Minari's root and every remote of Minari's are, and can be copied to any of them:

    dynagen/namespace_metadata.json                  lists all datasets in the tree: Hugging Face finds them by it
    dynagen/Hopper-RandDyn/namespace_metadata.json
    dynagen/Hopper-RandDyn/test3-v0/data/            metadata.json, main_data.hdf5
"""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from minari.namespace import NAMESPACE_METADATA_FILENAME

from dynagen_bench import ids
from dynagen_bench.collection.contents import DatasetRecord, dataset_folder, read_record
from dynagen_bench.datasets.remotes import Remote, namespace_of, own_metadata
from dynagen_bench.whole import exclusively, whole_folder, write_whole


def add_to_tree(
    tree: Path,
    found: Mapping[str, DatasetRecord],
    official: Container[str],
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Put datasets of this machine into a tree, beside those that it has, and their namespaces.

    The files are hard links where the file system can, and take no space.

    Args:
        tree: its folder.
        found: ids of the datasets, and their records.
        official: ids of those that may take the place of other data in the tree.
        progress: called with each dataset.

    Raises:
        ValueError: the tree has other data under an id that is not official; what comes before it is there.
    """
    with exclusively(tree):  # its lock lies beside the tree, not in it
        for dataset_id, record in found.items():
            if dataset_id not in official:
                _check_no_other(tree / dataset_id, record)
            with whole_folder(tree / dataset_id) as unfinished:
                shutil.copytree(dataset_folder(dataset_id), unfinished, copy_function=_link, dirs_exist_ok=True)
            progress()
        for namespace in sorted({namespace_of(dataset_id) for dataset_id in found}):
            _write_namespace(tree, namespace, _local_metadata(namespace))
        there = tree.glob(f"{ids.NAMESPACE}/*/[!.]*/data")
        datasets = sorted(path.parent.relative_to(tree).as_posix() for path in there)
        listing = {"datasets": datasets, "namespaces": sorted({namespace_of(dataset_id) for dataset_id in datasets})}
        _write_namespace(tree, ids.NAMESPACE, {**_local_metadata(ids.NAMESPACE), **listing})


def _check_no_other(folder: Path, record: DatasetRecord) -> None:
    """Raise ValueError if there is a dataset of other content in a folder; one that cannot be read is none."""
    try:
        found = read_record(folder).sha256
    except (FileNotFoundError, ValueError):
        return
    if found != record.sha256:
        raise ValueError(f"{folder} is another dataset, sha256 {found[:12]}: only official data replace one")


def send_namespaces(remote: Remote, namespaces: Sequence[str]) -> None:
    """Upload the metadata of `dynagen`, if it is not there yet, and of namespaces in it.

    Those of `dynagen` are never sent again: on Hugging Face they have become the list of all its datasets. The others
    are: a stopped upload may have listed one before it was there.
    """
    with tempfile.TemporaryDirectory() as root:
        for namespace in (ids.NAMESPACE, *namespaces):
            _write_namespace(Path(root), namespace, _local_metadata(namespace))
        there = ids.NAMESPACE in remote.namespaces()
        with _minari_root(root):
            for namespace in namespaces if there else (ids.NAMESPACE, *namespaces):
                remote.send_namespace(namespace)


def send_dataset(remote: Remote, dataset_id: str, record: DatasetRecord, *, replace: bool) -> bool:
    """Upload one dataset, unless the remote has the same; return whether it was sent.

    Args:
        remote: where to.
        dataset_id: the dataset, in Minari's root; its namespace is there already.
        record: its record.
        replace: put it in place of other data that the remote has under this id.

    Raises:
        ValueError: the remote has other data, and they are not to be replaced.
        RuntimeError: the upload failed.
    """
    namespace = namespace_of(dataset_id)
    if dataset_id in remote.datasets(namespace):
        found = remote.record(dataset_id).sha256
        if found == record.sha256 and remote.holds_files_of(dataset_id, dataset_folder(dataset_id)):
            return False
        if found != record.sha256 and not replace:
            raise ValueError(
                f"{remote.address} has another {dataset_id}, sha256 {found[:12]}: only official data replace one"
            )
    remote.send(dataset_id)
    return True


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copy2(source, target)


def _local_metadata(namespace: str) -> dict[str, Any]:
    path = dataset_folder(namespace) / NAMESPACE_METADATA_FILENAME
    try:
        return own_metadata(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}): `dynagen data build` mends it") from error


def _write_namespace(root: Path, namespace: str, metadata: Mapping[str, Any]) -> None:
    write_whole(root / namespace / NAMESPACE_METADATA_FILENAME, json.dumps(metadata, indent=1) + "\n")


@contextlib.contextmanager
def _minari_root(root: str) -> Iterator[None]:
    """Minari uploads namespaces from its root alone; here the root is a folder that holds nothing else."""
    before = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = root
    try:
        yield
    finally:
        if before is None:
            del os.environ["MINARI_DATASETS_PATH"]
        else:
            os.environ["MINARI_DATASETS_PATH"] = before
