"""What every drawing made here has alike: a frame that is readable on a light and on a dark page, and round ticks.

What is here: `drawing` and `ticks`. Called by the charts of data cards, the gallery and the results page. It must not
know what is drawn.
"""

import html
import math
from collections.abc import Sequence


def drawing(
    size: tuple[int, int],
    title: str,
    about: str,
    style: str,
    inside: Sequence[str],
    *,
    heading: tuple[int, int],
    shared: str | None = None,
) -> str:
    """The text of an SVG file: a page of a colour of its own, its heading, and what is inside.

    A viewer that takes the other colour scheme than the page around it still shows a readable drawing.

    Args:
        size: width and height in units of the drawing.
        title: plain text, escaped here.
        about: a sentence below it, likewise.
        style: CSS, with the classes `page` and `title` of the frame.
        inside: elements, in their order.
        heading: left end and foot line of the title; the sentence stands 20 below.
        shared: elements that those inside refer to.
    """
    width, height = size
    left, top = heading
    title, about = html.escape(title), html.escape(about)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-label="{title}">',
            f"<title>{title}</title>",
            f"<desc>{about}</desc>",
            f"<style>{style}</style>",
            *([] if shared is None else [f"<defs>{shared}</defs>"]),
            f'<rect class="page" width="{width}" height="{height}" rx="8"/>',
            f'<text class="title" x="{left}" y="{top}">{title}</text>',
            f'<text x="{left}" y="{top + 20}">{about}</text>',
            *inside,
            "</svg>",
            "",
        ]
    )


def ticks(low: float, high: float) -> list[float]:
    """Round numbers, two to six of them, the outermost of which hold `low` and `high`."""
    span = high - low
    raw = (span if span > 1e-9 else 1.0) / 4
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(size * factor for factor in (1, 2, 2.5, 5, 10) if size * factor >= raw)
    first = math.floor(low / step)
    last = max(math.ceil(high / step), first + 1)
    return [round(step * k, 10) for k in range(first, last + 1)]
