"""Minari's remotes: what lies at an address, and single datasets to and from it.

What is here: `connect`, and `Remote` over Minari's own storage classes, with one-line errors, retries and no output of
theirs. Called by `downloads` and `publishing`. It must not know the manifest, nor Minari's root on this machine.

Minari checks nothing that it receives; whoever fetches has to.
"""

import base64
import contextlib
import hashlib
import io
import json
import logging
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

from minari.namespace import NAMESPACE_METADATA_FILENAME
from minari.storage.remotes import get_cloud_storage

from dynagen_bench.collection.contents import DatasetRecord

REMOTE_VARIABLE: Final = "MINARI_REMOTE"
"""Minari's own environment variable for the remote."""

RETRY_WAITS: Final = (1.0, 4.0)
"""Seconds before the second and the third attempt; the libraries below retry single requests by themselves."""

_ADDRESS = re.compile(r"(?P<kind>hf|gcp)://[\w.-]+")


def connect(address: str | None = None) -> "Remote":
    """The remote at an address; nothing is sent yet.

    Credentials are those of the services' own tools: `HF_TOKEN` or `hf auth login`, and for a bucket a service
    account's file in `GOOGLE_APPLICATION_CREDENTIALS`. Without any, the remote is asked as anybody may.

    Args:
        address: `hf://NAME` (a user or an organisation of Hugging Face) or `gcp://BUCKET`; None takes `MINARI_REMOTE`.

    Raises:
        ValueError: no address, one of another form, or a service account's file that is none.
        RuntimeError: the library for it is not installed.
    """
    address = address or os.environ.get(REMOTE_VARIABLE)
    if not address:
        raise ValueError(f"no remote given: use --remote hf://NAME or gcp://BUCKET, or set {REMOTE_VARIABLE}")
    match = _ADDRESS.fullmatch(address)
    if match is None:
        raise ValueError(f"cannot read the remote {address!r}: write it as hf://NAME or gcp://BUCKET")
    token = os.environ.get("GOOGLE_APPLICATION_CREDENTIALS") if match["kind"] == "gcp" else None
    try:
        return Remote(address, get_cloud_storage(address, token or None))
    except ImportError as error:
        raise RuntimeError(
            f"{address} needs libraries that are not installed: pip install 'dynagen-bench[remotes]'"
        ) from error
    except (ValueError, OSError) as error:
        raise ValueError(f"cannot use GOOGLE_APPLICATION_CREDENTIALS={token}: {_first_line(error)}") from error


class Remote:
    """A place that Minari uploads to and downloads from.

    Every method raises RuntimeError, of one line, where the remote does not do what it is asked.

    Attributes:
        address: `hf://NAME` or `gcp://BUCKET`.
    """

    def __init__(self, address: str, storage: Any) -> None:
        """Wrap one of Minari's `CloudStorage`; use `connect`."""
        self.address = address
        self._storage = storage
        self._bucket = getattr(storage, "bucket", None)  # None on Hugging Face
        self._listed: dict[str, set[str]] = {}
        self._read: dict[str, dict[str, Any]] = {}

    def datasets(self, namespace: str) -> set[str]:
        """Ids of the datasets in a namespace, as of the first time it is asked for."""
        if namespace not in self._listed:
            with self._asked(f"list {namespace}"):
                listed = set(self._storage.list_datasets(prefix=f"{namespace}/"))
                self._listed[namespace] = listed if self._bucket or not listed else listed & self._registered(namespace)
        return self._listed[namespace]

    def _registered(self, namespace: str) -> set[str]:
        """The datasets that the file on Hugging Face lists, read anew.

        Minari edits its cached copy of that file before it uploads it, so that after a stopped upload `list_datasets`
        has datasets that nobody else sees.
        """
        repository = namespace.partition("/")[0]
        with tempfile.TemporaryDirectory() as root:
            self._storage.download_namespace_metadata(repository, Path(root))
            text = (Path(root) / repository / NAMESPACE_METADATA_FILENAME).read_text(encoding="utf-8")
        return set(json.loads(text).get("datasets", []))

    def namespaces(self) -> set[str]:
        """Names of all namespaces."""
        with self._asked("list namespaces"):
            return set(self._storage.list_namespaces())

    def record(self, dataset_id: str) -> DatasetRecord:
        """What a dataset there says of itself.

        Raises:
            ValueError: it is none of this benchmark's.
        """
        try:
            return DatasetRecord(**self._metadata(dataset_id)["dynagen"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{dataset_id} at {self.address} is no dataset of this benchmark ({error!r})") from error

    def size(self, dataset_id: str) -> int:
        """Bytes of a dataset, to the tenth of a megabyte that its metadata give; 0 where they do not."""
        return int(1e6 * self._metadata(dataset_id).get("dataset_size", 0))

    def _metadata(self, dataset_id: str) -> dict[str, Any]:
        if dataset_id not in self._read:
            with self._asked(f"read the metadata of {dataset_id}"):
                self._read[dataset_id] = dict(self._storage.get_dataset_metadata(dataset_id))
        return self._read[dataset_id]

    def holds_files_of(self, dataset_id: str, folder: Path) -> bool:
        """Whether the files of a dataset that is listed there are those in a folder.

        A bucket takes file after file, so that a stopped upload leaves metadata without data, or with older ones. On
        Hugging Face a dataset is one commit, and its metadata tell all.
        """
        if not self._bucket:
            return True
        with self._asked(f"look at the files of {dataset_id}"):
            for path in (folder / "data").iterdir():
                with path.open("rb") as file:
                    digest = hashlib.file_digest(file, "md5").digest()
                blob = self._bucket.get_blob(f"{dataset_id}/data/{path.name}")
                if blob is None or blob.md5_hash != base64.b64encode(digest).decode():
                    return False
        return True

    def fetch(self, dataset_id: str, root: Path) -> None:
        """Download a dataset to `root / dataset_id`; files that a former attempt left whole may be kept."""
        root.mkdir(parents=True, exist_ok=True)
        self._patiently(f"download {dataset_id}", lambda: self._storage.download_dataset(dataset_id, root))

    def fetch_namespace(self, namespace: str, root: Path) -> None:
        """Download the metadata of a namespace to `root / namespace`."""
        (root / namespace).mkdir(parents=True, exist_ok=True)
        self._patiently(
            f"download the namespace {namespace}",
            lambda: self._storage.download_namespace_metadata(namespace, root),
        )

    def send(self, dataset_id: str) -> None:
        """Upload a dataset from Minari's root."""
        self._patiently(f"upload {dataset_id}", lambda: self._storage.upload_dataset(dataset_id))

    def send_namespace(self, namespace: str) -> None:
        """Upload the metadata of a namespace from Minari's root."""
        self._patiently(f"upload the namespace {namespace}", lambda: self._storage.upload_namespace(namespace))

    def _patiently(self, what: str, action: Callable[[], None]) -> None:
        """Do it, and again after a moment if the connection failed."""
        for wait in (*RETRY_WAITS, None):
            try:
                with _silence():
                    return action()
            except Exception as error:
                if wait is None or _is_final(error):
                    raise self._failure(what, error) from error
            time.sleep(wait)
        return None

    @contextlib.contextmanager
    def _asked(self, what: str) -> Iterator[None]:
        try:
            with _silence():
                yield
        except Exception as error:  # requests', httpx's, google's and huggingface_hub's have no class in common
            raise self._failure(what, error) from error

    def _failure(self, what: str, error: Exception) -> RuntimeError:
        """Whatever the libraries raised as one line that says what was asked of which remote."""
        return RuntimeError(
            f"cannot {what} at {self.address} ({type(error).__name__}: {_first_line(error)}); if it was the "
            "connection, the same command again continues"
        )


def namespace_of(dataset_id: str) -> str:
    """The namespace of a dataset, `dynagen/Hopper-RandDyn`."""
    return str(PurePosixPath(dataset_id).parent)


def own_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """The metadata of a namespace without those of a remote on Hugging Face: what it lists."""
    return {field: value for field, value in metadata.items() if field not in ("datasets", "namespaces")}


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Nothing is printed: Minari's lines and bars would break our own bars, and so would its libraries' warnings."""
    logger = logging.getLogger("huggingface_hub")  # its handler has kept the error stream that there was before
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        logger.setLevel(before)


def _is_final(error: Exception) -> bool:
    """Whether another attempt is no use: not found, not allowed, or Google's library has tried for two minutes."""
    if type(error).__name__ == "RetryError":
        return True
    status = getattr(getattr(error, "response", None), "status_code", None)
    return isinstance(status, int) and 400 <= status < 500 and status not in (408, 429)


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), "no reason given")
