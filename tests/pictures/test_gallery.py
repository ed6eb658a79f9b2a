"""The page holds every body, asks for nothing but itself, and is whole on a desk and on a phone."""

import re
from pathlib import Path

import pytest

from dynagen_bench import ids
from dynagen_bench.dynamics import load_dynamics
from dynagen_bench.pictures import write_gallery
from tests.browser import opened

ROBOTS = ("Hopper", "Ant")
LABELS = ("nominal", "test0", "test3")


@pytest.fixture(scope="module")
def page(gl, tiny_dataset_root, tiny_policies, tmp_path_factory) -> Path:
    """A page of two robots: one with policies and data, one with neither; few and small frames."""
    folder = tmp_path_factory.mktemp("gallery")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tiny_dataset_root))
        patch.setenv("DYNAGEN_CACHE", str(folder / "cache"))
        write_gallery(folder / "gallery.html", ROBOTS, labels=LABELS, steps=(0, 40), size=48, folder=tiny_policies)
    return folder / "gallery.html"


def section(page: Path, robot: str) -> str:
    """The part of one robot."""
    return page.read_text(encoding="utf-8").split(f'<section id="{robot}"')[1].split("</section>")[0]


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_element_of_every_body_is_there(page, robot):
    text = section(page, robot)
    for name in ids.dynamics_ids(robot):
        drawn = load_dynamics(name.robot, name.split, name.index).to_json()
        for field, factors in drawn.items():
            for element, factor in factors.items():
                assert f'title="{name.label}, {field} of {element}: ×{factor:.2f}, ' in text


@pytest.mark.parametrize("robot", ROBOTS)
def test_frames_say_whose_and_when(page, robot):
    text = section(page, robot)
    found = re.findall(rf'<img src="data:image/webp;base64,([^"]+)"[^>]* alt="{robot} (\w+) after ([\d.]+) s">', text)
    seconds = {"Hopper": "0.32", "Ant": "2.00"}[robot]
    assert [(label, time) for _, label, time in found] == [(name, t) for name in LABELS for t in ("0.00", seconds)]
    assert len({frame for frame, _, _ in found}) == 1 + len(LABELS)  # the same start, three ways on


def test_returns_are_shown_where_there_are_data_and_the_command_where_not(page):
    assert len(re.findall(r"<svg class=\"(train|test)\"", section(page, "Hopper"))) == 25
    assert "dynagen data build" not in section(page, "Hopper")
    assert "<svg" not in section(page, "Ant")
    assert "<code>dynagen data build Ant</code>" in section(page, "Ant")


def test_it_refers_to_nothing_else(page):
    text = page.read_text(encoding="utf-8")
    assert "http:" not in text
    assert "https:" not in text
    assert all(target.startswith(("data:", "#")) for target in re.findall(r'(?:src|href)="([^"]*)"', text))


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_browser_shows_it_without_complaint(page, width, scheme):
    with opened(page, width, scheme) as tab:
        tab.evaluate("for (const image of document.images) image.loading = 'eager'")
        tab.wait_for_function("[...document.images].every(image => image.complete && image.naturalWidth)")
        assert tab.evaluate("document.documentElement.scrollWidth") <= tab.evaluate("innerWidth") == width
        cell = tab.locator("#Hopper .heat td[title]").nth(26)
        cell.click()
        assert tab.locator("#Hopper .readout").inner_text() == cell.get_attribute("title")
        tab.keyboard.press("ArrowDown")
        below = tab.locator("#Hopper .readout").inner_text()
        assert below.startswith("train1, body_mass of leg: ×")


@pytest.mark.parametrize(
    ("robots", "message"), [(("Hoper",), "did you mean 'Hopper'"), ((), "at least one"), (("Ant", "Ant"), "none twice")]
)
def test_a_mistake_writes_nothing(tmp_path, robots, message):
    with pytest.raises(ValueError, match=message):
        write_gallery(tmp_path / "gallery.html", robots)
    assert not (tmp_path / "gallery.html").exists()
