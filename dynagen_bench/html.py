"""Pages of HTML that are one file and load nothing else, each made from a template beside its own module.

What is here: `render`, and what pages with charts share: `html.css`, `html.js` and the looks of series. Called by the
gallery, the site of the leaderboard and the summary of runs. It must not know what a page says.
"""

import base64
import hashlib
import importlib.resources
from collections.abc import Callable, Mapping
from typing import Any, Final

import jinja2
import markupsafe

COLOURS: Final = 8
"""After so many series the colours come again, dashed."""


def render(package: str, template: str, filters: Mapping[str, Callable[[Any], str]], **shown: Any) -> str:
    """The text of a page, in which every text that is shown is escaped.

    Args:
        package: where the template lies, a module's `__package__`.
        template: the name of its file.
        filters: name in the template → function that writes a value.
        shown: name in the template → what it shows.

    Raises:
        jinja2.UndefinedError: the template shows something that it is not given.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters
    return environment.from_string(_text(package, template)).render(shown)


def style_and_script(package: str) -> dict[str, str]:
    """What a template shows as `style`, `script` and, in its policy, `script_hash`: ours alone, by its SHA-256.

    Args:
        package: where the page's own `page.css` and `page.js` lie; they come after those that all pages have.
    """
    style, script = (_text(__package__, f"html.{kind}") + _text(package, f"page.{kind}") for kind in ("css", "js"))
    return {
        "style": markupsafe.Markup(style),
        "script": markupsafe.Markup(script),
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    }


def look(place: int) -> str:
    """The classes of the series at a place, from 0: `k3`, its colour, and after the last colour dashes, `k3 d1`."""
    dashes = place // COLOURS % 3
    return f"k{place % COLOURS}" + (f" d{dashes}" if dashes else "")


def _text(package: str, name: str) -> str:
    return (importlib.resources.files(package) / name).read_text(encoding="utf-8")
