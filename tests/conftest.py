"""Fixtures of all tests: no test touches the user's folders, and tiny real data for those that need some."""

import os

# Before any import of torch: two processors are shared with everything else that runs, and tiny nets gain nothing.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

from pathlib import Path

import hypothesis
import pytest

from dynagen_bench import ids
from dynagen_bench.datasets.commands import build
from dynagen_bench.pictures.backend import choose_backend
from tests.tiny_data import EPISODES_PER_SNAPSHOT, store_random_policies

if "CI" not in os.environ:  # there hypothesis has a profile of its own, without a deadline too
    hypothesis.settings.register_profile("here", deadline=None)  # a busy machine is no mistake
    hypothesis.settings.load_profile("here")


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    """Minari's root and our cache are folders of this test alone."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    monkeypatch.setenv("DYNAGEN_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="session")
def tiny_policies(tmp_path_factory) -> Path:
    """A folder with four small random policies, at 100 to 400 steps, for each of Hopper's 25 dynamics."""
    folder = tmp_path_factory.mktemp("policies")
    store_random_policies(folder, ids.dynamics_ids("Hopper"))
    return folder


@pytest.fixture(scope="session")
def tiny_records(tmp_path_factory) -> Path:
    """The folder of the manifest and the reference scores of `tiny_dataset_root`; use that first."""
    return tmp_path_factory.mktemp("records")


@pytest.fixture(scope="session")
def tiny_dataset_root(tmp_path_factory, tiny_policies, tiny_records) -> Path:
    """A Minari root with Hopper's 25 datasets, of a few short episodes each. Not to be written to."""
    root = tmp_path_factory.mktemp("minari")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(root))
        build(
            ["Hopper"],
            write_manifest=True,
            policies_folder=tiny_policies,
            episodes_per_snapshot=EPISODES_PER_SNAPSHOT,
            records=tiny_records,
        )
    return root


@pytest.fixture
def tiny_data(tiny_dataset_root, monkeypatch) -> Path:
    """`tiny_dataset_root` as Minari's root for one test, so that `load_dataset("Hopper")` works."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tiny_dataset_root))
    return tiny_dataset_root


@pytest.fixture(scope="session")
def gl():
    """Skips where no GL backend draws; leaves the environment as it was after the session."""
    before = os.environ.get("MUJOCO_GL")
    try:
        yield choose_backend()
    except RuntimeError as missing:
        pytest.skip(str(missing))
    finally:
        if before is None:
            os.environ.pop("MUJOCO_GL", None)
        else:
            os.environ["MUJOCO_GL"] = before
