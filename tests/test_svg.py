"""Frames show any text as text, and ticks are round numbers around a range."""

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dynagen_bench.svg import drawing, ticks

SVG = "{http://www.w3.org/2000/svg}"


@given(st.floats(-1e4, 1e4), st.floats(0.0, 1e4))
@example(-5e-324, 5.0)
@example(0.0, 0.0)
@example(0.0, 5e-324)
@example(676.0, 0.0)
def test_ticks_are_few_and_hold_the_range(low, width):
    marks = ticks(low, low + width)
    rounding = 1e-6 * max(abs(low), abs(low + width), 1.0)  # of 1 too: a range of subnormal numbers is at 0
    assert 2 <= len(marks) <= 6
    assert marks[0] <= low + rounding
    assert marks[-1] >= low + width - rounding
    assert marks[-1] > marks[0]
    if width > 1e-3:
        np.testing.assert_allclose(np.diff(marks), marks[1] - marks[0], rtol=1e-3)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 676, [0, 200, 400, 600, 800]),
        (-37, 12, [-40, -20, 0, 20]),
        (7, 24, [5, 10, 15, 20, 25]),
        (134.6, 134.6, [134.5, 134.75]),
    ],
)
def test_ticks_are_round_numbers(low, high, expected):
    assert ticks(low, high) == expected


@given(st.text(st.characters(min_codepoint=32, exclude_categories=("Cs", "Cn"))), st.booleans())
@example("<script>&\"'", True)
def test_any_title_is_text(words, shared):
    text = drawing(
        (200, 100), words, words, ".page {}", ["<g/>"], heading=(5, 30), shared="<path/>" if shared else None
    )
    root = ElementTree.fromstring(text)
    assert root.get("viewBox") == "0 0 200 100"
    heading, about = root.findall(f"{SVG}text")
    assert [(element.text or "", element.get("y")) for element in (heading, about)] == [(words, "30"), (words, "50")]
    assert ((root.find(f"{SVG}title").text or ""), (root.find(f"{SVG}desc").text or "")) == (words, words)
    assert (root.find(f"{SVG}defs") is not None) == shared
