"""The page: every text as it stands and never as markup, and the same bytes each time."""

import re
from html.parser import HTMLParser

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from leaderboard.entries import Entry
from leaderboard.markdown import escape, iqm_text, number_text, page, rank_text, score_text
from leaderboard.standings import Cell
from leaderboard.statistics import Estimate, Rank
from tests.evaluation.samples import submission

HOSTILE = [
    "<script>alert(1)</script>",
    "a | b | c",
    "**bold** _italic_ ~~gone~~ `code`",
    "[text](https://a.example) ![image](https://a.example/x.png)",
    "https://a.example www.a.example me@a.example @somebody #1",
    "&lt;b&gt; &copy; <!-- hidden",
    "\\| \\\\ \\<b>",
    "# heading",
    "- item",
    "1. item",
    "--- ===",
    "$x^2$ :smile: [^1] {#id}",
]

rendering = MarkdownIt("gfm-like", {"linkify": False, "html": True})
"""GitHub's Markdown: CommonMark with tables and strike-through, HTML let through."""


class Outline(HTMLParser):
    """Tags, links and text of a rendered page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags, self.links, self.text = set(), [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.links += [value for name, value in attrs if name in {"href", "src"}]

    def handle_data(self, data):
        self.text += data


def outline(markdown):
    parser = Outline()
    parser.feed(rendering.render(markdown))
    parser.close()
    return parser


printable_lines = st.text(st.characters(codec="utf-8"), min_size=1).filter(lambda t: t.isprintable() and t == t.strip())


@given(printable_lines | st.lists(st.sampled_from(HOSTILE)).map(" ".join).filter(bool))
@settings(max_examples=300, deadline=None)
def test_escaped_text_is_read_as_it_stands(text):
    found = outline(f"| a | b |\n| --- | --- |\n| {escape(text)} | next |\n")
    assert found.tags == {"table", "thead", "tbody", "tr", "th", "td"}
    assert text in found.text
    assert "next" in found.text


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_change_nothing_of_the_page(text):
    harmless = outline(page([Entry("a", submission())]))
    given_submission = submission(agent=text, authors=[text] * 2, description=text, hardware=text)
    found = outline(page([Entry("a", given_submission)]))
    assert found.tags == harmless.tags
    assert found.links == []
    assert found.text.count(text) == 8  # agent and two authors in the table and again below, about, hardware


def test_links_are_those_given():
    given_submission = submission(paper="https://arxiv.org/abs/1?a=1&b=2", code="https://github.com/a_b/c*d")
    assert outline(page([Entry("a", given_submission)])).links == [
        "https://arxiv.org/abs/1?a=1&b=2",
        "https://github.com/a_b/c*d",
    ]


def test_numbers():
    assert score_text(None) == "–"
    cell = Cell(74.694, 4.216, 5, bold=True, iqm=Estimate(73.006, (70.1, 78.0)))
    assert score_text(cell) == "74.69 ± 4.22"
    assert score_text(cell._replace(runs=3)) == "74.69 ± 4.22 (3 runs)"
    assert score_text(cell._replace(mean=-0.001, std=None, runs=1)) == "0.00 (1 run)"
    assert iqm_text(cell) == "73.01 [70.10, 78.00]"
    assert iqm_text(cell._replace(iqm=Estimate(1.0, None))) == iqm_text(None) == "–"
    assert [rank_text(rank) for rank in (Rank(1, 1), Rank(2, 4), None)] == ["1", "2–4", "–"]
    assert number_text(-12.3456) == "-12.35"


def test_the_table_by_hand():
    entries = [
        Entry(
            "b",
            submission({"Hopper": [80.0, 100.0, 120.0], "Ant": [20.0]}, agent="B", privileged="own-history"),
            "replayed (tolerance)",
        ),
        Entry("a", submission({"Hopper": [20.0] * 5}, agent="A"), "replayed"),
        Entry("c", submission({"Hopper": [190.0] * 2}, agent="C")),  # nobody has replayed it
    ]
    text = page(entries)
    assert "## Zero-shot, last checkpoint (official)" in text
    table = re.search(r"\| Agent .*?\n\n", text, re.DOTALL)
    assert table is not None
    assert table[0].strip().split("\n") == [
        "| Agent | Authors | Walker | Hopper | HalfCheetah | SlimHumanoid | Ant | Privileged | Label |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| B *(partial)* | A\\. Author | – | **50.00 ± 10.00 (3 runs)** | – | – | **10.00 (1 run)** | own-history "
        "| replayed (tolerance) |",
        "| A *(partial)* | A\\. Author | – | 10.00 ± 0.00 | – | – | – | none | replayed |",
        "| C *(partial)* | A\\. Author | – | 95.00 ± 0.00 (2 runs) | – | – | – | none | self-reported |",
        "| *behaviour data* |  | – | 26.00 | 26.00 | 26.00 | 26.00 |  | reference |",
    ]
    assert "| Hopper | 100.00 | 78.26 | 61.54 | 48.28 | 37.50 |" in text  # B's mean return 100 in each test dynamics
    ranks = re.search(r"\| Agent [^\n]* All robots .*?\n\n", text, re.DOTALL)
    assert ranks is not None
    assert ranks[0].strip().split("\n") == [
        "| Agent | Walker | Hopper | HalfCheetah | SlimHumanoid | Ant | All robots |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| B | – | 50.00 [40.00, 60.00], 1 | – | – | – | – |",  # one run on Ant
        "| A | – | 10.00 [10.00, 10.00], 2 | – | – | – | – |",
        "| C | – | 95.00 [95.00, 95.00] | – | – | – | – |",
    ]
    assert page(entries) == text


def test_single_runs_have_no_second_table():
    assert "All robots" not in page([Entry("a", submission({"Hopper": [80.0], "Ant": [20.0]}))])


def test_an_empty_board_says_so():
    assert "There are no entries yet." in page([])
