"""The drawings of the page, as SVG that is readable on a light and on a dark page.

What is here: `learning_curves` and `error_bars`, each a `Drawing`. Called by the page. It must not know files.
"""

import html
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from agents import AGENTS
from agents.summary.charts import Scale, curve_of, line, scale_of
from agents.summary.intervals import MeanEstimate
from dynagen_bench import svg

WIDTH, HEIGHT = 560, 240
"""Of the drawing area."""

LEFT, TOP, RIGHT, BOTTOM = 60, 64, 190, 44
"""Around it; names stand at the right."""

COLOURS: Final = (
    ("#0969da", "#58a6ff"),
    ("#c2500a", "#f0883e"),
    ("#1a7f37", "#3fb950"),
    ("#8250df", "#bc8cff"),
    ("#bf3989", "#f778ba"),
    ("#7d6608", "#d4a72c"),
    ("#57606a", "#9198a1"),
    ("#cf222e", "#ff7b72"),
)
"""On a light and on a dark page."""

_STYLE: Final = """
  text { font: 12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; fill: #57606a }
  .title { font-size: 16px; font-weight: 600; fill: #1f2328 } .end { text-anchor: end } .middle { text-anchor: middle }
  .page { fill: #ffffff } .panel { fill: #f6f8fa } .grid { stroke: #d8dee4 }
  .line { fill: none; stroke-width: 2.5; stroke-linejoin: round }
  .run { fill: none; stroke-width: 1; stroke-opacity: 0.4; stroke-linejoin: round }
  .whisker { stroke-width: 2 } .still { stroke: #57606a; stroke-dasharray: 5 4 }
"""
_DARK: Final = """
    text { fill: #9198a1 } .title { fill: #f0f6fc } .page { fill: #0d1117 } .panel { fill: #151b23 }
    .grid { stroke: #2a313c } .still { stroke: #9198a1 }
"""


class Drawing(NamedTuple):
    """What a file shows, in a few words, and its text."""

    title: str
    svg: str


def learning_curves(robot: str, curves: Mapping[str, Sequence[Mapping[int, float]]]) -> Drawing:
    """SVG of scores in the test dynamics by gradient steps: each run a thin line, their mean a thick one.

    Args:
        robot: for the title.
        curves: agent → steps → score, of each of its runs, at steps that all of them have.
    """
    numbers = {agent: _colour(agent, place) for place, agent in enumerate(curves)}
    means = {agent: curve_of(runs) for agent, runs in curves.items()}
    singles = {agent: [curve_of([run]) for run in runs] for agent, runs in curves.items()}
    every = [curve for own in singles.values() for curve in own]
    x, y = Scale(0.0, float(max(curve[-1].step for curve in every))), scale_of(every, may_bend=False)
    parts = [
        f'<polyline class="{kind} stroke{numbers[agent]}" points="{_stretched(line(curve, x, y))}"/>'
        for kind, drawn in (("run", singles), ("line", {agent: [curve] for agent, curve in means.items()}))
        for agent, own in drawn.items()
        for curve in own
    ]
    parts += [  # a run that was measured once is a point
        f'<circle class="fill{numbers[agent]}" cx="{x.at(point.step) * WIDTH / 100:.6g}" '
        f'cy="{HEIGHT - y.at(point.value.mean) * HEIGHT / 100:.6g}" r="3"/>'
        for agent, curve in means.items()
        for point in curve
    ]
    parts += [_x_label(x.at(tick), f"{tick:,.0f}") for tick in x.ticks]
    parts.append(f'<text class="middle" x="{WIDTH / 2:g}" y="{HEIGHT + 36}">gradient steps</text>')
    about = "Score in the test dynamics: each run, and the mean over runs"
    return _drawing(f"{robot}: learning curves", about, [_grid(y), *parts, _key(numbers)])


def error_bars(robot: str, errors: Mapping[str, MeanEstimate], unchanged: float | None = None) -> Drawing:
    """SVG of next-state errors, the paper's Figure 4: mean over runs, and its 95 % interval as a whisker.

    Args:
        robot: for the title.
        errors: agent → mean square error of normalised next states.
        unchanged: that of the present state in place of a prediction, a line.
    """
    ends = [end for one in errors.values() for end in (one.mean, *(one.interval or ()), unchanged or 0) if end > 0]
    y = Scale(min(ends) / 1.5, max(ends) * 1.5, logarithmic=True)
    parts = []
    for number, (agent, one) in enumerate(errors.items()):
        x = 100 * (number + 0.5) / len(errors)
        across, down = x * WIDTH / 100, HEIGHT - y.at(one.mean) * HEIGHT / 100
        if one.interval is not None:
            low, high = (HEIGHT - y.at(end) * HEIGHT / 100 for end in one.interval)
            parts.append(f'<path class="whisker stroke{number}" d="M{across:g} {low:g}V{high:g}"/>')
        parts.append(f'<circle class="fill{number}" cx="{across:g}" cy="{down:g}" r="5"/>')
        parts.append(_x_label(x, agent))
    if unchanged is not None:
        down = HEIGHT - y.at(unchanged) * HEIGHT / 100
        parts.append(f'<path class="still" d="M0 {down:g}H{WIDTH}"/>')
        parts.append(f'<text x="{WIDTH + 8}" y="{down + 4:g}">no change, {unchanged:.3g}</text>')
    about = "Mean square error of normalised next states in the test dynamics, logarithmic; less is better"
    return _drawing(f"{robot}: next-state errors", about, [_grid(y), *parts])


def _drawing(title: str, about: str, inside: Sequence[str]) -> Drawing:
    light, dark = (
        " ".join(
            f".fill{n} {{ fill: {pair[which]} }} .stroke{n} {{ stroke: {pair[which]} }}"
            for n, pair in enumerate(COLOURS)
        )
        for which in (0, 1)
    )
    style = f"{_STYLE}{light} @media (prefers-color-scheme: dark) {{{_DARK}{dark} }}"
    panel = [
        f'<g transform="translate({LEFT} {TOP})">',
        f'<rect class="panel" width="{WIDTH}" height="{HEIGHT}"/>',
        *inside,
        "</g>",
    ]
    size = LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM
    return Drawing(title, svg.drawing(size, title, about, style, panel, heading=(LEFT, 28)))


def _grid(y: Scale) -> str:
    parts = []
    for tick in y.ticks:
        down = round(HEIGHT - y.at(tick) * HEIGHT / 100, 1)
        parts.append(f'<path class="grid" d="M0 {down:g}H{WIDTH}"/>')
        parts.append(f'<text class="end" x="-8" y="{down + 4:g}">{tick:g}</text>')
    return "".join(parts)


def _x_label(place: float, text: str) -> str:
    return f'<text class="middle" x="{place * WIDTH / 100:g}" y="{HEIGHT + 18}">{html.escape(text)}</text>'


def _colour(agent: str, place: int) -> int:
    """The number of an agent's colour, the same on every drawing; of a name that is no agent's, that of its place."""
    return (list(AGENTS).index(agent) if agent in AGENTS else place) % len(COLOURS)


def _key(numbers: Mapping[str, int]) -> str:
    """Names and the numbers of their colours, one under the other."""
    return "".join(
        f'<rect class="fill{number}" x="{WIDTH + 14}" y="{8 + 20 * n}" width="12" height="12" rx="2"/>'
        f'<text x="{WIDTH + 32}" y="{18 + 20 * n}">{html.escape(name)}</text>'
        for n, (name, number) in enumerate(numbers.items())
    )


def _stretched(points: str) -> str:
    """Places in a drawing of 100 × 100, "x,y x,y …", as places in the drawing area."""
    pairs = (point.split(",") for point in points.split())
    return " ".join(f"{float(x) * WIDTH / 100:.6g},{float(y) * HEIGHT / 100:.6g}" for x, y in pairs)
