"""The page of runs: groups, intervals and numbers by hand, every text as it stands, and a real browser."""

import html
import json
import re

import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from agents.summary.__main__ import main
from agents.summary.builder import final_text, number_text, steps_text, summary_page
from agents.summary.charts import POINTS, Point, Scale, band, curve_of, line, scale_of
from agents.summary.intervals import MeanEstimate, mean_estimate, t_quantile
from agents.summary.runs import grouped, read_runs
from tests.browser import opened
from tests.leaderboard.test_site import HOSTILE, outline


def write_run(folder, seed=0, points=((10, 1.0), (20, 3.0)), agent="dadt", robot="Hopper", name=None, **config):
    """A run folder with the curve `test_return`, and a loss that falls to a hundredth."""
    place = folder / (name or f"{agent}-{robot}-seed{seed}-{len(list(folder.glob('*')))}")
    place.mkdir(parents=True)
    settings = {"robot": robot, "seed": seed, "every": 1, "name": name, "log_every": seed + 1}
    about = {"agent": agent, "config": {"steps": 20, **config}, "settings": settings, "data": {"episodes": 4}}
    about |= {"command": f"python -m agents.train {agent} --seed {seed}", "commit": "c0ffee"}
    (place / "config.json").write_text(json.dumps(about))
    rows = [f"{step},{100 / step**2},{3600 * step / 20},{value}" for step, value in points]
    (place / "curves.csv").write_text("\n".join(["step,loss,seconds,test_return", *rows]) + "\n")
    return place


@given(st.integers(1, 400))
def test_quantiles_are_those_of_students_distribution(freedom):
    assert t_quantile(freedom) == pytest.approx(scipy.stats.t.ppf(0.975, freedom), rel=1e-9)


def test_an_interval_by_hand():
    found = mean_estimate([1.0, 2.0, 6.0])  # s² = (4 + 1 + 9) / 2 = 7, t of two degrees of freedom is 4.302653
    assert (found.mean, found.std) == (3.0, pytest.approx(7**0.5))
    half = 4.302653 * (7 / 3) ** 0.5
    assert found.interval == (pytest.approx(3 - half, rel=1e-6), pytest.approx(3 + half, rel=1e-6))
    assert mean_estimate([5.0]) == (5.0, None, None)
    assert mean_estimate([5.0, 5.0]).interval == (5.0, 5.0)


def test_a_page_of_robots_on_which_an_agent_differs_in_other_facts(tmp_path):
    for weight in (0.5, 0.05):
        write_run(tmp_path, next_state_weight=weight)
    write_run(tmp_path, robot="Ant")
    page = summary_page(read_runs(tmp_path))
    assert "next-state-weight 0.5" in page


def test_groups_differ_in_more_than_their_seed(tmp_path):
    for weight in (0.5, 0.05, 0.1):
        for seed in (2, 1):
            write_run(tmp_path, seed, next_state_weight=weight)
    write_run(tmp_path, agent="dt")
    write_run(tmp_path, robot="Ant", next_state_weight=0.5)
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "config.json").write_text("{}")  # has no curves yet
    groups = grouped(read_runs(tmp_path))
    assert [(group.robot, group.label, [run.seed for run in group.runs]) for group in groups] == [
        ("Ant", "dadt", [0]),
        ("Hopper", "dadt, next-state-weight 0.05", [1, 2]),
        ("Hopper", "dadt, next-state-weight 0.1", [1, 2]),
        ("Hopper", "dadt, next-state-weight 0.5", [1, 2]),
        ("Hopper", "dt", [0]),
    ]


def test_a_seed_counts_once(tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1), ("d", 0)):
        write_run(tmp_path, seed, name=name)
    groups = grouped(read_runs(tmp_path))
    assert [(group.label, [run.name for run in group.runs]) for group in groups] == [
        ("dadt", ["a", "c"]),
        ("dadt, again", ["b"]),
        ("dadt, again (2)", ["d"]),
    ]


def test_a_line_ends_where_its_shortest_run_does(tmp_path):
    write_run(tmp_path, 0, ((10, 1.0), (20, 2.0), (30, "nan")))
    write_run(tmp_path, 1, ((10, 3.0), (15, 9.0), (20, 4.0), (30, 5.0)))
    (group,) = grouped(read_runs(tmp_path))
    assert group.curves("test_return") == [{10: 1.0, 20: 2.0}, {10: 3.0, 20: 4.0}]
    assert group.curves("next_state_loss") == []
    points = curve_of(group.curves("test_return"))
    assert [(point.step, point.value.mean) for point in points] == [(10, 2.0), (20, 3.0)]
    assert points[0].value.interval == (pytest.approx(2 - 12.706205), pytest.approx(2 + 12.706205))  # t · √2 / √2


def test_long_curves_are_averaged_over_neighbours():
    curve = {step: float(step % 2) for step in range(1, 2 * POINTS + 1)}
    found = curve_of([curve])
    assert len(found) == POINTS
    assert {point.value.mean for point in found} == {0.5}
    assert (found[0].step, found[-1].step) == (2, 2 * POINTS)
    assert [point.value.mean for point in curve_of([dict(list(curve.items())[:POINTS])])] == list(curve.values())[
        :POINTS
    ]


def test_places_and_scales_by_hand():
    points = [Point(0, MeanEstimate(1.0, 1.0, (0.0, 2.0))), Point(10, MeanEstimate(2.0, 1.0, (1.0, 99.0)))]
    x, y = Scale(0.0, 10.0), Scale(0.0, 4.0)
    assert line(points, x, y) == "0,75 100,50"
    assert band(points, x, y) == "0,50 100,0 100,75 0,100"
    assert band([Point(0, MeanEstimate(1.0, None, None))], x, y) is None
    alone = [Point(10, MeanEstimate(1.0, 1.0, (0.0, 2.0)))]
    assert line(alone, x, y) == "97,75 100,75"  # a dash: of one place nothing would be drawn
    assert band(alone, x, y) == "97,50 100,50 100,100 97,100"
    assert y.ticks == [0, 1, 2, 3, 4]
    high = scale_of([points], may_bend=True).high  # not at 99: that would flatten the line
    assert 2.5 < high < 2.7
    bent = scale_of(
        [[Point(0, MeanEstimate(1000.0, None, None)), Point(1, MeanEstimate(1.0, None, None))]], may_bend=True
    )
    assert bent.logarithmic
    assert bent.ticks == pytest.approx([1, 10, 100, 1000])
    assert bent.at(31.6227766) == pytest.approx(50, abs=0.01)
    assert scale_of([[Point(0, MeanEstimate(3.0, None, None))]], may_bend=True).at(3.0) == 50


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_lie_on_their_scale(low, width):
    ticks = Scale(low, low + width).ticks
    assert 2 <= len(ticks) <= 8
    assert all(low - width * 1e-6 <= tick <= low + width * (1 + 1e-6) for tick in ticks)


def test_numbers_are_written_for_reading():
    assert [number_text(x) for x in (0.0123456, -12.345, 123456.78, 0)] == ["0.01235", "−12.35", "123,456.8", "0"]
    assert [steps_text(x) for x in (500, 20_000, 1_500_000)] == ["500", "20K", "1.5M"]
    assert final_text(mean_estimate([1.0, 2.0, 6.0])) == "3.00 ± 2.65"
    assert [final_text(mean_estimate(x)) for x in ([4.0], [4.0, 4.0])] == ["4", "4 ± 0"]


def test_the_page_has_results_intervals_commands_and_configs(tmp_path):
    for seed, last in enumerate((1.0, 2.0, 6.0)):
        write_run(tmp_path / "runs", seed, ((10, 0.5), (20, last)), lambda_=0.25)
    main([str(tmp_path / "runs"), "--output", str(tmp_path / "page.html")])
    page = (tmp_path / "page.html").read_text()
    text = " ".join(outline(page).text.split())
    assert "dadt3.00 ± 2.6532" in text.replace(" 0K", "0")  # mean ± std, then three runs of 20 steps
    (readings,) = [json.loads(html.unescape(found)) for found in re.findall(r'data-readings="([^"]*)"', page)][:1]
    assert readings == [[50.0, "0.5", "[0.5, 0.5]"], [100.0, "3", "[−3.572, 9.572]"]]
    for seed in range(3):
        assert f"python -m agents.train dadt --seed {seed}" in text
    assert '"lambda_": 0.25' in text
    assert "95 % t interval" in text
    main([str(tmp_path / "runs"), "--output", str(tmp_path / "again.html")])
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "page.html").read_bytes()
    assert "There are no runs yet." in outline(summary_page([])).text


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_change_nothing_of_the_page(text, tmp_path):
    pages = []
    for place, given_text in (("plain", "plain"), ("hostile", text)):
        made = write_run(tmp_path / place, agent=given_text, robot=given_text, name="run", option=given_text)
        write_run(tmp_path / place, agent=given_text, robot=given_text, name="other", option="else")
        about = json.loads((made / "config.json").read_text())
        (made / "config.json").write_text(json.dumps(about | {"command": given_text, "commit": given_text}))
        if "/" not in given_text:
            made.rename(made.with_name(given_text))
        pages.append(outline(summary_page(read_runs(tmp_path / place))))
    plain, hostile = pages
    assert hostile.tags == plain.tags
    assert hostile.handlers == []
    assert hostile.links == plain.links
    assert hostile.text.count(text) > 8
    assert all(link.startswith(("#", "data:")) for link in hostile.links)
    assert hostile.policy.startswith("default-src 'none';")


def test_what_is_no_run_is_told_in_one_line(tmp_path):
    made = write_run(tmp_path / "runs")
    for file, content, message in (
        ("curves.csv", "step,loss\n1,x\n", r"curves\.csv is no table of curves"),
        ("config.json", "{}", "tells no agent, config and settings"),
        ("config.json", '{"agent": "a", "config": {}, "settings": {}}', "tells no robot and seed"),
        ("config.json", "[", r"config\.json is not JSON"),
    ):
        (made / file).write_text(content)
        with pytest.raises(SystemExit, match=message) as stop:
            main([str(tmp_path / "runs"), "--output", str(tmp_path / "page.html")])
        assert "\n" not in str(stop.value)
    with pytest.raises(SystemExit, match=r"error: no folder .*nowhere"):
        main([str(tmp_path / "nowhere")])
    with pytest.raises(SystemExit, match=r"error: .* holds no run folders: give the one that they are in"):
        main([str(made)])
    assert not (tmp_path / "page.html").exists()


def test_in_a_browser_a_curve_of_one_point_is_seen(tmp_path):
    pytest.importorskip("playwright.sync_api")
    for seed in (0, 1):
        write_run(tmp_path / "runs", seed, [(20, 10.0 + seed)])
    main([str(tmp_path / "runs"), "--output", str(tmp_path / "page.html")])
    with opened(tmp_path / "page.html") as tab:
        panel = tab.locator(".panel", has=tab.get_by_role("heading", name="Return")).locator("svg")
        seen = panel.screenshot()
        tab.evaluate("document.querySelectorAll('.line, .band').forEach(shape => shape.remove())")
        assert panel.screenshot() != seen


def test_in_a_browser_values_are_read_with_pointer_and_keys(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    for weight in (0.05, 0.5):
        for seed in (0, 1):
            points = [(step, weight * step + seed) for step in range(10, 110, 10)]
            write_run(tmp_path / "runs", seed, points, next_state_weight=weight)
    write_run(tmp_path / "runs", agent=HOSTILE[0])
    main([str(tmp_path / "runs"), "--output", str(tmp_path / "page.html")])
    with opened(tmp_path / "page.html") as tab:
        for width in (390, 1280):
            tab.set_viewport_size({"width": width, "height": 844})
            assert tab.evaluate("document.documentElement.scrollWidth") <= width
        assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 26)"

        panel = tab.locator(".panel", has=tab.get_by_role("heading", name="Return"))
        value = panel.locator(".key li", has_text="next-state-weight 0.5").locator(".value")
        assert value.inner_text() == "50.5 [44.15, 56.85]"  # 50 and 51: t · s / √n is 6.353
        slider = tab.get_by_role("slider")
        slider.press("Home")
        assert value.inner_text() == "5.5 [−0.8531, 11.85]"
        slider.press("ArrowRight")
        assert tab.locator("output").inner_text() == "1"  # of 100 steps, half a per cent
        box = panel.locator("svg").bounding_box()
        tab.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 5)
        assert tab.locator("output").inner_text() == "70"
        assert value.inner_text().startswith("35.5 [")
        value.hover()
        assert tab.locator(".charts.hot .on").count() == 2 * 2  # line and name, in two charts

        tab.locator(".board a", has_text="next-state-weight 0.05").press("Enter")
        group = tab.locator("details", has_text="next-state-weight 0.05").first
        playwright.expect(group.get_by_text('"next_state_weight": 0.05')).to_be_visible()
        tab.locator("summary").last.press("Enter")
        playwright.expect(tab.locator("details[open]")).to_have_count(2)
