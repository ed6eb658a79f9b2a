"""Charts are well-formed, show every panel, and put numbers where they belong."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from dynagen_bench.datasets.charts import HEIGHT, WIDTH, Axes, learning_curves, return_histograms

SVG = "{http://www.w3.org/2000/svg}"
CURVES = {
    "train0": ([50_000.0, 100_000.0], [100.0, 200.0]),
    "train1": ([50_000.0, 100_000.0], [0.0, 300.0]),
    "test0": ([50_000.0, 100_000.0], [50.0, 400.0]),
}


def panels(chart: str) -> dict[str, ElementTree.Element]:
    """The panels of a chart by their names."""
    found = {}
    for group in ElementTree.fromstring(chart).iter(f"{SVG}g"):
        name = next(text for text in group.iter(f"{SVG}text") if text.get("class") == "name")
        found[name.text] = group
    return found


def drawn(panel: ElementTree.Element, style: str) -> list[tuple[float, float]]:
    """Points of a path of a style in a panel."""
    (path,) = [p.get("d") for p in panel.iter(f"{SVG}path") if p.get("class") == style]
    points, x, y = [], 0.0, 0.0
    for letter, numbers in re.findall(r"([MLHV])([-\d. ]+)", path):
        values = [float(number) for number in numbers.split()]
        x = values[0] if letter in "MLH" else x
        y = values[-1] if letter in "MLV" else y
        points.append((x, y))
    return points


def test_points_are_measured_from_the_upper_left_corner():
    axes = Axes((0, 10), (-1, 1), {}, {})
    assert axes.points([0, 5, 10], [-1, 0, 1]) == [(0, HEIGHT), (WIDTH / 2, HEIGHT / 2), (WIDTH, 0)]


def test_a_learning_curve_stands_in_its_own_panel_in_its_splits_colour():
    chart = panels(learning_curves("Hopper", CURVES))
    assert list(chart) == ["train0", "train1", "test0"]
    # the axes go from 0 to 100K steps and from 0 to 400
    assert drawn(chart["train0"], "line train") == [(WIDTH / 2, 0.75 * HEIGHT), (WIDTH, 0.5 * HEIGHT)]
    assert drawn(chart["test0"], "line test") == [(WIDTH / 2, 0.875 * HEIGHT), (WIDTH, 0.0)]
    assert [text.text for text in chart["test0"].iter(f"{SVG}text") if text.get("class") == "test end"] == ["400"]


def test_histograms_have_a_panel_a_snapshot_and_the_shares_of_the_episodes():
    train = np.array([0.0, 0.0, 0.0, 400.0]), np.array([50_000] * 4)
    test = np.array([400.0, 400.0]), np.array([50_000, 1_000_000])
    chart = panels(return_histograms("Hopper", {"train": train, "test": test}))
    assert list(chart) == ["50K steps", "1M steps"]
    up = drawn(chart["50K steps"], "area train")
    down = drawn(chart["50K steps"], "area test")
    zero = up[0][1]
    # three quarters of train in the first bin, a quarter in the last, and all of test there, below the zero line
    assert zero - min(y for _, y in up) == pytest.approx(3 * (zero - up[-2][1]), abs=0.2)
    assert max(y for _, y in down) - zero == pytest.approx(4 / 3 * (zero - min(y for _, y in up)), abs=0.2)
    assert {x for x, y in down if y > zero} == {round(WIDTH * 39 / 40, 1), WIDTH}
    assert not [path for path in chart["1M steps"].iter(f"{SVG}path") if path.get("class") == "area train"]


def test_charts_have_a_title_and_both_colour_schemes():
    for chart in (
        learning_curves("Hopper", CURVES),
        return_histograms("Hopper", {"train": (np.array([1.0, 2.0]), np.array([50_000, 50_000]))}),
    ):
        root = ElementTree.fromstring(chart)
        assert "Hopper" in root.find(f"{SVG}title").text
        assert "prefers-color-scheme: dark" in root.find(f"{SVG}style").text
        used = {word for item in root.iter() for word in item.get("class", "").split()}
        assert all(f".{word}" in root.find(f"{SVG}style").text for word in used)
