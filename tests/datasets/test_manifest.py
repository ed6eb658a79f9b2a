"""The manifest file."""

import threading

import pytest

from dynagen_bench.collection.contents import DatasetRecord
from dynagen_bench.datasets.manifest import ManifestEntry, add_to_manifest, manifest_file, read_manifest, standing

RETURNS = {"min": 0.0, "mean": 1.0, "max": 2.0}
RECIPE = {"dynamics": "Hopper-RandDyn-test0", "every": 1, "mujoco": "4.0.0", "policies": {}}
ENTRY = ManifestEntry("a" * 64, 1000, 123_456, "4.0.0")


def test_entries_are_added_sorted_and_the_others_stay(tmp_path):
    assert read_manifest(tmp_path) == {}
    add_to_manifest({"b": ENTRY}, tmp_path)
    add_to_manifest({"a": ENTRY, "c": ENTRY}, tmp_path)
    changed = ManifestEntry("b" * 64, 1000, 123_456, "4.0.0")
    add_to_manifest({"c": changed}, tmp_path)
    assert read_manifest(tmp_path) == {"a": ENTRY, "b": ENTRY, "c": changed}
    assert list(read_manifest(tmp_path)) == ["a", "b", "c"]
    assert [path.name for path in tmp_path.glob("[!.]*")] == ["manifest.json"]


def test_a_dataset_is_official_by_its_content_alone():
    record = DatasetRecord(RECIPE, ENTRY.sha256, ENTRY.episodes, ENTRY.steps, RETURNS)
    assert standing(record, ENTRY) == "official"
    assert standing(record, ManifestEntry("b" * 64, ENTRY.episodes, ENTRY.steps, "4.0.0")) == "differs"
    assert standing(record, None) == "unlisted"


def test_entries_that_several_add_at_once_are_all_kept(tmp_path):
    def add(who):
        for number in range(10):
            add_to_manifest({f"{who}-{number}": ENTRY}, tmp_path)

    threads = [threading.Thread(target=add, args=(who,)) for who in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(read_manifest(tmp_path)) == 60


@pytest.mark.parametrize("text", ["{", "[]", '{"a": {"sha256": "x"}}', '{"a": 3}'])
def test_a_file_that_is_no_manifest(tmp_path, text):
    manifest_file(tmp_path).write_text(text)
    with pytest.raises(ValueError, match=r"manifest\.json is no manifest .*: restore it from the repository"):
        read_manifest(tmp_path)
