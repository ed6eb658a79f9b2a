"""The board's page: every text as it stands, the same bytes each time, and what it does in a real browser."""

import base64
import dataclasses
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings

from leaderboard.entries import Entry
from leaderboard.site.builder import ALL, site_page
from leaderboard.site.charts import Mark, Scale, curve, heat_level, scale_of
from leaderboard.statistics import THRESHOLDS, Estimate, profile
from tests import browser
from tests.evaluation.samples import submission, write_references
from tests.leaderboard.test_markdown import printable_lines

HOSTILE = (
    "<script>alert(1)</script>",
    "</script><script>alert(2)</script>",
    "<img src=x onerror=alert(3)>",
    "\"><svg onload='alert(4)'>",
    "' onmouseover='alert(5)' x='",
    "{{ 7 * 7 }} {% raw %} {# no #}",
    "</style></title></textarea><!-- <![CDATA[",
    "&lt;b&gt; &amp; javascript:alert(6)",
)


class Outline(HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags, self.handlers, self.links, self.policy, self.text = [], [], [], "", ""

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.links += [value for name, value in attrs if name in {"href", "src"}]
        if ("http-equiv", "Content-Security-Policy") in attrs:
            self.policy = dict(attrs)["content"]

    def handle_data(self, data):
        self.text += data


def outline(page):
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


def entry(slug, runs, **fields):
    return Entry(slug, submission(runs, format_version=2, **fields), "replayed")


def with_curves(made):
    """The same entry, its runs with learning curves."""
    content = made.submission.model_dump(mode="json")
    for run in content["runs"]:
        run["curve"] = [{"gradient_steps": 500, "mean_return": 50.0}, {"gradient_steps": 1000, "mean_return": 100.0}]
    return dataclasses.replace(made, submission=type(made.submission).model_validate(content))


@pytest.fixture
def entries(references):
    """Two that have every robot, one of them with another track's twin, and a partial one with a hostile name."""
    robots = ("Walker", "Hopper", "HalfCheetah", "SlimHumanoid", "Ant")
    write_references(references)
    good = entry("good", {r: [100.0, 120.0] for r in robots}, agent="Good", commands=["train --robot Ant"])
    return [
        with_curves(good),
        dataclasses.replace(
            entry("poor", {r: [10.0, 12.0] for r in robots}, agent="Poor"), label="replayed (tolerance)"
        ),
        entry("partial", {"Hopper": [150.0, 160.0, 180.0], "Ant": [11.0]}, agent=HOSTILE[0], authors=["Zoe"] * 2),
        entry("few", {"Hopper": [30.0]}, agent="Few", track="adaptation"),
    ]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_change_nothing_of_the_page(text):
    fields = {"authors": 2, "commands": 2, "agent": None, "description": None, "hardware": None}
    plain, hostile = (
        outline(site_page([entry("a", None, **{k: given if n is None else [given] * n for k, n in fields.items()})]))
        for given in ("plain", text)
    )
    assert hostile.tags == plain.tags
    assert hostile.handlers == []
    assert hostile.links == plain.links
    assert hostile.text.count(text) == plain.text.count("plain") > 8


@given(printable_lines)
@settings(max_examples=25, deadline=None)
def test_any_text_is_read_as_it_stands(text):
    found = outline(site_page([Entry("a", submission({"Hopper": [1.0]}).model_copy(update={"agent": text}))]))
    assert text in found.text


def test_links_are_those_given_and_nothing_is_loaded(entries):
    with_links = Entry("a", submission(paper="https://a.example/1?a=1&b=2", code="https://b.example/c"))
    found = outline(site_page([with_links]))
    assert {link for link in found.links if not link.startswith(("#", "data:"))} == {
        "https://a.example/1?a=1&b=2",
        "https://b.example/c",
    }
    assert all(link.startswith(("#", "data:")) for link in outline(site_page(entries)).links)
    assert {"img", "iframe", "object", "form", "base"}.isdisjoint(found.tags)


def test_the_policy_lets_no_script_run_but_the_pages_own(entries):
    page = site_page(entries)
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in outline(page).policy
    assert outline(page).policy.startswith("default-src 'none';")


def test_the_same_entries_give_the_same_bytes_and_none_say_so(entries):
    assert site_page(entries) == site_page(entries)
    assert "There are no entries yet." in outline(site_page([])).text


def test_numbers_by_hand(entries):
    page = site_page(entries)
    # Good: scores 50 and 60 on Ant in all dynamics, 52.5 below 100 … 45 in the mean
    assert 'data-column="Ant" data-mean="55.0" data-iqm="55.0" data-gap="45.0"' in page
    text = " ".join(outline(page).text.split())
    assert "55.00 ± 7.07" in text
    assert "55.0 [50.0, 60.0]rank 1" in text  # Poor's 5 to 6 lie below
    assert "53.21 ± 1.89" in text  # as published
    # each dynamics on its own scale (see `samples`), mean return 110: test1 from 10 to 125
    assert f"Ant test1: {100 * 100 / 115:.2f}" in page
    # over Poor: Good always wins, on five robots; the partial one has its single run on Ant against Poor's two: a half
    (table,) = [json.loads(found) for found in re.findall(r'data-table="([^"]*)"', page)]
    assert table[0][2] == [100, 100, 100, 5]
    assert table[1][2] == [75, -1, -1, 2]
    assert table[2][1] == [25, -1, -1, 2]
    assert [row[place] for place, row in enumerate(table)] == [None] * 3


def test_curves_and_commands_are_shown_where_given(entries):
    page = site_page(entries)
    good, poor = (page.split(f'<details id="entry-{slug}"')[1].split("</details>")[0] for slug in ("good", "poor"))
    assert (
        good.count('<polyline points="50.00,75.00 100.00,50.00"/>') == 10
    )  # returns of 50 and 100 are scores 25 and 50
    assert "1,000 steps" in good
    assert "train --robot Ant" in good
    assert "polyline" not in poor
    assert "None given." in poor


def test_scales_and_levels_by_hand():
    assert scale_of([37.0, 101.0]) == (0.0, 110.0)
    assert scale_of([-233.0, 1e9]) == (-50.0, 150.0)
    scale = Scale(-50.0, 150.0)
    assert scale.mark(Estimate(50.0, (-500.0, 100.0))) == Mark(50.0, 0.0, 75.0)
    assert scale.mark(Estimate(float("inf"), None)) == Mark(100.0, None, None)
    assert scale.ticks == [(0.0, -50), (25.0, 0), (50.0, 50), (75.0, 100), (100.0, 150)]
    assert [heat_level(score) for score in (-900, -0.1, 0, 9.9, 10, 99, 100, 800)] == [-4, -1, 0, 0, 1, 9, 10, 10]


def test_profiles_are_drawn_from_the_left_top_down():
    drawn = curve(profile({"a": np.array([[50.0], [101.0]])}))
    points = dict(point.split(",") for point in drawn.line.split())
    assert (points["0"], points["48"], points["50"], points["100"]) == ("0", "0", "50", "50")
    assert drawn.band is not None
    assert len(drawn.band.split()) == 2 * len(THRESHOLDS)
    assert drawn.band.split()[0] == "0,0"
    assert curve(profile({"a": np.array([[50.0]])})).band is None


@pytest.fixture
def tab(entries, tmp_path):
    """The page in Chromium on a phone in the dark; afterwards nothing was said and nothing asked for."""
    file = tmp_path / "index.html"
    file.write_text(site_page(entries), encoding="utf-8")
    with browser.opened(file) as made:
        yield made


def slugs(tab, section="zero-shot-last"):
    """The entries of a table that can be seen, from the top."""
    return tab.locator(f"#{section} .sortable tbody tr:visible").evaluate_all(
        "rows => rows.map(row => row.dataset.slug)"
    )


def test_it_sorts_filters_and_compares_in_a_browser(tab):
    for opened in (False, True):
        tab.evaluate("open => document.querySelectorAll('details').forEach(one => { one.open = open })", opened)
        for width in (320, 390, 1280):
            tab.set_viewport_size({"width": width, "height": 844})
            assert tab.evaluate("document.documentElement.scrollWidth") <= width, (opened, width)
    tab.evaluate("document.querySelectorAll('details').forEach(one => { one.open = false })")
    assert slugs(tab) == ["good", "partial", "poor"]

    hopper = tab.locator("#zero-shot-last th[data-column=Hopper]")
    hopper.get_by_role("button").press("Enter")
    assert slugs(tab) == ["partial", "good", "poor"]
    assert hopper.get_attribute("aria-sort") == "descending"
    hopper.get_by_role("button").press("Enter")
    assert slugs(tab) == ["poor", "good", "partial"]
    tab.locator("#zero-shot-last th[data-key=rank] button").click()
    assert slugs(tab) == ["good", "poor", "partial"]  # no rank over all robots is last
    tab.locator("#zero-shot-last th[data-key=name] button").click()
    assert slugs(tab) == ["partial", "good", "poor"]  # "<" is before letters

    tab.locator("#robot").select_option("Hopper")
    assert slugs(tab) == ["partial", "good", "poor"]
    assert tab.locator("#zero-shot-last .sortable th[data-column]:visible").all_inner_texts() == ["Hopper"]
    assert tab.locator("#zero-shot-last .panel:visible h4").all_inner_texts() == ["Hopper", "Hopper"]
    assert tab.locator("tr[data-slug=partial] [data-rank]:visible").inner_text() == "1"
    tab.locator("#robot").select_option("Walker")
    assert slugs(tab) == ["good", "poor"]
    assert slugs(tab, "adaptation-last") == []
    tab.locator("#adaptation-last th[data-key=rank] button").click()  # nothing to sort, and no error
    tab.locator("#robot").select_option("")

    assert tab.locator("#label option").all_inner_texts() == ["any label", "replayed (tolerance)", "replayed"]
    tab.locator("#label").select_option("replayed (tolerance)")
    assert slugs(tab) == ["poor"]
    assert tab.locator(".charts li[data-slug]:visible").evaluate_all(
        "rows => [...new Set(rows.map(row => row.dataset.slug))]"
    ) == ["poor"]
    tab.locator("#label").select_option("")
    tab.locator("#measure").select_option("gap")
    assert tab.locator("tr[data-slug=good] td[data-column=Ant]").inner_text() == "45.0 [40.0, 50.0]"
    tab.locator("#find").fill("zoe")
    assert slugs(tab) == ["partial"]
    assert tab.locator(".count").inner_text() == "1 of 4 entries"
    tab.locator("#find").fill("nobody")
    assert tab.locator(".count").inner_text() == "No entry is like that."
    tab.locator("#find").fill("")
    tab.locator("#track").select_option("adaptation-last")
    assert tab.locator("section.track:visible").count() == 1
    assert tab.locator("details:visible").count() == 1
    tab.locator("#track").select_option("")

    tab.locator("#zero-shot-last .over select").select_option("Poor")
    row = tab.locator("#zero-shot-last .improvement li[data-slug=partial]")
    assert row.locator(".value").inner_text() == "75 %"
    assert row.get_attribute("title").endswith(": 75 %, on 2 robots")
    assert tab.locator("#zero-shot-last .improvement li[data-slug=poor]").is_hidden()

    slider = tab.locator("#zero-shot-last .slider input")
    value = tab.locator(f"#zero-shot-last .profile[data-column='{ALL}'] .key li[data-slug=good] .value")
    # of runs of 50 and 60 on five robots half are above 50; 2 and 8 are the 2.5 and 97.5 % quantiles of ten fair coins
    assert value.inner_text() == "50 % [20, 80]"
    slider.press("ArrowLeft")
    assert value.inner_text() == "100 % [100, 100]"

    tab.locator("#zero-shot-last .sortable tr[data-slug=poor] a").press("Enter")
    tab.locator("#entry-poor .heat").wait_for(state="visible")  # the link opens what it leads to when it has arrived


def test_a_single_robot_is_chosen_from_the_start(tab, tmp_path):
    (tmp_path / "one.html").write_text(
        site_page([entry("a", {"Hopper": [80.0, 120.0]}), entry("b", {"Hopper": [90.0, 130.0]})]), encoding="utf-8"
    )
    with tab.context.new_page() as other:
        other.goto((tmp_path / "one.html").as_uri())
        assert slugs(other) == ["b", "a"]
        assert other.locator("[data-rank]:visible").all_inner_texts() == ["1–2", "1–2"]
