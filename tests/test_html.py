"""Pages from templates: nothing of a text is markup, nothing that is shown is missing, the script is ours."""

import base64
import hashlib
import sys

import jinja2
import pytest

from dynagen_bench import html


@pytest.fixture
def template(tmp_path, monkeypatch):
    """Makes a package `made` with a template of this text, a style and a script."""

    def make(text):
        for name, content in {"__init__.py": "", "a.jinja": text, "page.css": "b {}\n", "page.js": "open();\n"}.items():
            (tmp_path / "made" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "made" / name).write_text(content, encoding="utf-8")

    monkeypatch.delitem(sys.modules, "made", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    return make


def test_what_is_shown_is_escaped_and_has_to_be_given(template):
    template("{{ name }}, {{ name | loud }}")
    filters = {"loud": str.upper}
    assert html.render("made", "a.jinja", filters, name="<b>") == "&lt;b&gt;, &lt;B&gt;"
    with pytest.raises(jinja2.UndefinedError):
        html.render("made", "a.jinja", filters)


def test_a_page_has_what_all_have_and_its_own_and_the_hash_of_its_script(template):
    template("{{ style }}|{{ script }}|{{ script_hash }}")
    page = html.render("made", "a.jinja", {}, **html.style_and_script("made"))
    style, script, digest = page.split("|")
    assert style.startswith("/* What every page has")
    assert style.endswith("b {}\n")
    assert "=> {" in script
    assert script.endswith("open();\n")
    assert base64.b64decode(digest) == hashlib.sha256(script.encode()).digest()


def test_looks_do_not_come_again_before_all_colours_and_dashes_have():
    assert [html.look(place) for place in (0, 7, 8, 17, 24)] == ["k0", "k7", "k0 d1", "k1 d2", "k0"]
    assert len({html.look(place) for place in range(24)}) == 24
