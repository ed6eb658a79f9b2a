"""Ids: built and parsed to the same thing, and refused in one line that says what is allowed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench import ids


def test_ids_differ_and_labels_parse_back():
    names = [name for robot in ids.ROBOTS for name in ids.dynamics_ids(robot)]
    assert len(names) == 25 * len(ids.ROBOTS)
    assert len({name.env_id for name in names} | {name.dataset_id for name in names}) == 2 * len(names)
    for name in names:
        assert ids.parse_label(name.robot, name.label) == name


@pytest.mark.parametrize("kind", [np.int64, np.uint8, np.array])
def test_numpys_whole_numbers_are_indices_and_become_plain(kind):
    assert ids.make_id("Hopper", "test", kind(3)) == ids.make_id("Hopper", "test", 3)
    assert type(ids.check_index("train", kind(19))) is int


@pytest.mark.parametrize("given", [None, True, np.True_, 3.0, np.float64(3), "3", [3], np.array([3])])
def test_what_is_no_whole_number_is_no_index(given):
    assert ids.whole_number(given) is None
    with pytest.raises(ValueError, match="choose a whole number from 0 to 4"):
        ids.check_index("test", given)


@pytest.mark.parametrize("given", [None, True, 2.0, "2", 1, 6, np.array([3])])
def test_a_count_is_a_whole_number_of_a_range(given):
    with pytest.raises(ValueError, match=r"^shots is .*: give a whole number from 2 to 5$"):
        ids.check_count("shots", given, least=2, most=5)
    assert type(ids.check_count("shots", np.int16(5), least=2, most=5)) is int
    assert ids.check_count("shots", 10**9) == 10**9
    with pytest.raises(ValueError, match=r"^shots is 0: give a whole number from 1 on$"):
        ids.check_count("shots", 0)


def test_ids_are_the_frozen_ones():
    name = ids.make_id("Hopper", "test", 3)
    assert name.env_id == "Hopper-RandDyn-test3"
    assert name.dataset_id == "dynagen/Hopper-RandDyn/test3-v0"
    assert ids.v0_env_id("SlimHumanoid") == "SlimHumanoid-RandDyn-v0"
    assert ids.make_id("Ant", "nominal", 0).label == "nominal"
    assert (name.key, ids.make_id("Walker", "train", 19).key) == ((1, 1, 3), (0, 0, 19))  # seeds are made of them


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ids.make_id("hoper", "test", 0), "choose one of Walker, Hopper.*did you mean 'Hopper'"),
        (lambda: ids.make_id("Hopper", "valid", 0), "choose one of train, test, nominal"),
        (lambda: ids.check_split(["train"]), r"unknown split \['train'\]: choose one of train, test, nominal"),
        (lambda: ids.make_id("Hopper", "test", 5), "whole number from 0 to 4"),
        (lambda: ids.make_id("Hopper", "train", True), "whole number from 0 to 19"),
        (lambda: ids.parse_label("Hopper", "test03"), "train0 to train19, test0 to test4, or nominal"),
    ],
)
def test_bad_ids_say_what_is_allowed(call, message):
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


@given(st.text(max_size=40))
def test_parsing_any_text_gives_an_id_or_a_value_error(text):
    try:
        name = ids.parse_label("Ant", text)
    except ValueError:
        return
    assert text == name.label


@pytest.mark.parametrize("given", [3, 2.5, True])
def test_indices_are_a_list(given):
    with pytest.raises(ValueError, match=rf"^indices is {given!r}: give a list of whole numbers, as \[0, 3\]$"):
        ids.choose_ids("Hopper", "train", given)
