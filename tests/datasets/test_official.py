"""The committed policies, manifest and reference scores belong together: this machine rebuilds the official data."""

import dataclasses

import pytest

from dynagen_bench import ids
from dynagen_bench.collection import runs
from dynagen_bench.collection.minari_files import build_dataset
from dynagen_bench.collection.policies import POLICY_FOLDER, load_policies, policy_file
from dynagen_bench.collection.settings import SETTINGS, SACSettings
from dynagen_bench.datasets import reference_scores
from dynagen_bench.datasets.manifest import check_official, read_manifest
from dynagen_bench.datasets.scores import score_range


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_dynamics_has_its_twenty_policies_of_the_one_setting(robot):
    settings = SETTINGS[robot]
    steps = range(settings.snapshot_every, settings.total_steps + 1, settings.snapshot_every)
    hashes = set()
    for name in ids.dynamics_ids(robot):
        snapshots, metadata = load_policies(policy_file(name))
        assert list(snapshots) == list(steps)
        assert metadata["dynamics"] == name.env_id
        assert SACSettings(**metadata["settings"]) == settings
        assert len(policy_file(name).with_suffix(".csv").read_text().splitlines()) == 1 + len(steps)
        hashes |= {policy.content_hash() for policy in snapshots.values()}
    assert len(hashes) == 25 * 20


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_dynagen_collect_finds_its_own_runs_done(robot, monkeypatch):
    monkeypatch.setattr(runs, "run_jobs", None)  # nothing is left to run
    runs.collect(list(ids.dynamics_ids(robot)), SETTINGS[robot], POLICY_FOLDER)
    with pytest.raises(ValueError, match=r"train0\.safetensors was trained with gamma=0\.9.*: give another --folder"):
        runs.collect(list(ids.dynamics_ids(robot)), dataclasses.replace(SETTINGS[robot], gamma=0.5), POLICY_FOLDER)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_manifest_and_scores_are_complete(robot):
    manifest, scores = read_manifest(), reference_scores(robot)
    for every in (1, 4):
        contents = [manifest[name.part_id(every)] for name in ids.dynamics_ids(robot)]
        assert len({entry.sha256 for entry in contents}) == 25  # no two bodies have the same data
        assert {entry.episodes for entry in contents} == {50 * 20 // every}
    assert set(scores) == {name.label for name in ids.dynamics_ids(robot)}
    assert all(score.min < score.mean < score.max for score in scores.values())
    tests = [scores[f"test{i}"] for i in range(5)]
    assert score_range(robot) == (min(test.min for test in tests), max(test.max for test in tests))


@pytest.mark.parametrize(("robot", "label"), [("Walker", "test3"), ("Hopper", "train0"), ("HalfCheetah", "test1")])
def test_this_machine_rebuilds_the_official_data(robot, label):
    name = ids.parse_label(robot, label)
    record = build_dataset(name, every=4)
    check_official(name.part_id(4), record, read_manifest()[name.part_id(4)])
