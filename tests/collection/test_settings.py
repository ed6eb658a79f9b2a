"""Settings of SAC: one per robot, and changes to them as text."""

import pytest

from dynagen_bench import ids
from dynagen_bench.collection.settings import SETTINGS, SACSettings, changed_settings


def test_every_robot_has_one_setting_and_the_same_snapshots():
    assert tuple(SETTINGS) == ids.ROBOTS
    assert {(s.total_steps, s.snapshot_every, s.hidden) for s in SETTINGS.values()} == {(1_000_000, 50_000, 64)}


def test_changes_are_read_as_the_fields_types():
    changed = changed_settings("Hopper", ["learning_rate=1e-3", "gradient_steps=64", "critic_layer_norm=true"])
    assert changed == SACSettings(learning_rate=1e-3, gradient_steps=64, critic_layer_norm=True)
    assert changed_settings("Ant", []) == SETTINGS["Ant"]
    few = changed_settings("Hopper", ["total_steps=1000", "snapshot_every=500", "learning_starts=0", "gamma=1"])
    assert (few.total_steps, few.snapshot_every, few.learning_starts, few.gamma) == (1000, 500, 0, 1.0)


@pytest.mark.parametrize(
    ("robot", "change", "message"),
    [
        ("Hopper", "momentum=1", "unknown setting 'momentum': choose from total_steps, "),
        ("Hopper", "gradient_steps=many", "gradient_steps is 'many': give a value like 32"),
        ("Hopper", "gradient_steps", "gradient_steps is '': give a value like 32"),
        ("Dog", "gradient_steps=1", "Dog"),
        ("Hopper", "batch_size=0", "batch_size is 0: give a number above 0"),
        ("Hopper", "hidden=-1", "hidden is -1: give a number above 0"),
        ("Hopper", "learning_rate=nan", "learning_rate is nan: give a number above 0"),
        ("Hopper", "learning_starts=-1", "learning_starts is -1: give a number from 0 on"),
        ("Hopper", "gamma=1.5", r"gamma is 1\.5: give a number above 0, at most 1"),
        ("Hopper", "snapshot_every=0", "snapshot_every is 0: give a number above 0"),
        ("Hopper", "snapshot_every=63", "environments is 64, snapshot_every 63 and total_steps 1000000: give none"),
        ("Hopper", "total_steps=1000", "snapshot_every 50000 and total_steps 1000: give none that is larger"),
    ],
)
def test_a_mistake_ends_in_one_line(robot, change, message):
    with pytest.raises(ValueError, match=message) as caught:
        changed_settings(robot, [change])
    assert "\n" not in str(caught.value)
