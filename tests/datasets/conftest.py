"""Remotes on loopback: a small Hugging Face hub, and Google's storage by its emulator."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from gcp_storage_emulator.server import create_server
from google.cloud import storage
from huggingface_hub import constants

from dynagen_bench.datasets import commands
from tests.datasets.hub_server import HubServer


@dataclasses.dataclass
class Loopback:
    """A remote on this machine: its address, and what processes need to find it.

    Attributes:
        address: as Minari writes it.
        environment: variables of a process that uses it.
        key: what `minari upload --key-path` wants for it.
        server: the hub, or the client of the bucket's service.
    """

    address: str
    environment: dict[str, str]
    key: str
    server: HubServer | storage.Client

    def run(self, *arguments: str, root: Path, answer: str = "") -> subprocess.CompletedProcess:
        """Run Python with these arguments on a Minari root and a cache of its own."""
        environment = {**os.environ, **self.environment, "MINARI_DATASETS_PATH": str(root), "COLUMNS": "200"}
        if "HF_HOME" in environment:
            environment["HF_HOME"] = str(root.with_name(f"{root.name}-hf"))
        return subprocess.run(
            [sys.executable, *arguments], env=environment, input=answer, capture_output=True, text=True, timeout=120
        )

    def files(self) -> dict[str, bytes]:
        """Path → content of all that is there."""
        if isinstance(self.server, HubServer):
            return {f"dynagen/{path}": data for path, data in self.server.repositories["someone/dynagen"].items()}
        bucket = self.server.bucket("someones-bucket")
        return {blob.name: blob.download_as_bytes() for blob in bucket.list_blobs()}

    def put(self, path: str, content: bytes) -> None:
        """Change a file that is there."""
        if isinstance(self.server, HubServer):
            self.server.repositories["someone/dynagen"][path.removeprefix("dynagen/")] = content
            self.server.commits["someone/dynagen"] += 1
        else:
            self.server.bucket("someones-bucket").blob(path).upload_from_string(content)


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """The hub as this process's remote; huggingface_hub reads its variables at its import alone."""
    with HubServer() as server:
        environment = server.environment(tmp_path)

        monkeypatch.setattr(constants, "ENDPOINT", server.url)
        monkeypatch.setattr(
            constants, "HUGGINGFACE_CO_URL_TEMPLATE", f"{server.url}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
        )
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hf" / "hub"))
        for variable, value in environment.items():
            monkeypatch.setenv(variable, value)
        yield Loopback(environment["MINARI_REMOTE"], environment, "a token", server)


@pytest.fixture(scope="session")
def service_account(tmp_path_factory) -> Path:
    """A service account's file with a key of its own, whose tokens are given out by `{url}`, to be filled in."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    text = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()
    path = tmp_path_factory.mktemp("account") / "account.json"
    account = {"type": "service_account", "project_id": "p", "private_key_id": "1", "private_key": text}
    path.write_text(json.dumps({**account, "client_email": "me@p.example", "client_id": "1"}))
    return path


@pytest.fixture
def bucket(tmp_path, monkeypatch, service_account):
    """A bucket as this process's remote."""
    server = create_server("127.0.0.1", 0, in_memory=True, default_bucket="someones-bucket")
    server.start()
    port = server._api._httpd.server_address[1]
    environment = {"STORAGE_EMULATOR_HOST": f"http://127.0.0.1:{port}", "MINARI_REMOTE": "gcp://someones-bucket"}
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value)
    with HubServer() as tokens:
        account = {**json.loads(service_account.read_text()), "token_uri": f"{tokens.url}/token"}
        key = tmp_path / "account.json"
        key.write_text(json.dumps(account))
        client = storage.Client.create_anonymous_client()
        yield Loopback(environment["MINARI_REMOTE"], environment, str(key), client)
    server.stop()


@pytest.fixture(params=["hub", "bucket"])
def remote(request) -> Loopback:
    """One of the two, and then the other."""
    return request.getfixturevalue(request.param)


@pytest.fixture
def patient(monkeypatch):
    """Nobody waits between attempts."""
    monkeypatch.setattr(time, "sleep", lambda seconds: None)


@pytest.fixture
def my_root(tmp_path, tiny_dataset_root) -> Path:
    """A copy of three tiny datasets, which may be written to, as Minari's root; not this process's own."""
    root = tmp_path / "mine"
    for path in ("train1-v0", "train10-v0", "test3-v0"):
        shutil.copytree(tiny_dataset_root / "dynagen" / "Hopper-RandDyn" / path, root / "dynagen/Hopper-RandDyn" / path)
    for folder in ("dynagen", "dynagen/Hopper-RandDyn"):
        shutil.copy(tiny_dataset_root / folder / "namespace_metadata.json", root / folder)
    return root


@pytest.fixture
def publish(my_root, tiny_records, monkeypatch):
    """`dynagen data publish Hopper LABELS...` from `my_root`."""

    def run(*labels: str, **changes) -> None:
        with monkeypatch.context() as patch:
            patch.setenv("MINARI_DATASETS_PATH", str(my_root))
            commands.publish(["Hopper"], labels or ("train1", "test3"), **{"records": tiny_records, **changes})

    return run


@pytest.fixture
def download(tiny_records, tiny_dataset_root):
    """`dynagen data download Hopper LABELS...` to this test's own root."""

    def run(*labels: str, **changes) -> None:
        commands.download(["Hopper"], labels or ("train1", "test3"), **{"records": tiny_records, **changes})

    return run
