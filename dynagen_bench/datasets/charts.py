"""The charts of a data card: small multiples as SVG, readable on a light and on a dark page.

What is here: `learning_curves` and `return_histograms`, each the text of one SVG file. Called by `cards`. It must not
know where numbers come from or where files are put.

A chart is a grid of panels with the same axes. Train bodies are blue and test bodies orange; a learning curve stands
before all the others in grey.
"""

import html
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynagen_bench.svg import drawing, ticks

COLUMNS: Final = 5

WIDTH, HEIGHT, GAP = 176, 100, 26
"""Size of a panel and the space around it, in units of the drawing; a panel's name stands above it."""

LEFT, TOP, RIGHT, BOTTOM = 50, 88, 16, 30
"""Margins around the grid."""

BINS: Final = 40
"""Bins of a histogram over the range of all returns."""

SIDES: Final = {"train": 1, "test": -1}
"""Where a histogram grows from the zero line."""

STYLE: Final = """
  text { font: 12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; fill: #57606a }
  .title { font-size: 17px; font-weight: 600; fill: #1f2328 }
  .name { font-weight: 600; fill: #1f2328 }
  .start { text-anchor: start } .end { text-anchor: end } .middle { text-anchor: middle }
  .page { fill: #ffffff } .panel { fill: #f6f8fa }
  .grid { stroke: #d8dee4; stroke-width: 1; fill: none }
  .others { stroke: #c4ccd4; stroke-width: 1; fill: none; stroke-linejoin: round }
  .line { stroke-width: 2.2; fill: none; stroke-linejoin: round; stroke-linecap: round }
  .area { stroke-width: 1.2; fill-opacity: 0.25; stroke-linejoin: round }
  .line.train, .area.train { stroke: #0969da } .line.test, .area.test { stroke: #c2500a }
  .area.train, text.train, tspan.train { fill: #0969da } .area.test, text.test, tspan.test { fill: #c2500a }
  @media (prefers-color-scheme: dark) {
    text { fill: #9198a1 } .title, .name { fill: #f0f6fc }
    .page { fill: #0d1117 } .panel { fill: #151b23 }
    .grid { stroke: #2a313c } .others { stroke: #3d4753 }
    .line.train, .area.train { stroke: #58a6ff } .line.test, .area.test { stroke: #f0883e }
    .area.train, text.train, tspan.train { fill: #58a6ff } .area.test, text.test, tspan.test { fill: #f0883e }
  }
"""
"""Of a light page and of a dark one."""


class Axes(NamedTuple):
    """What all panels of a chart share: the ends of both axes, and where they are labelled."""

    x: tuple[float, float]
    y: tuple[float, float]
    x_labels: Mapping[float, str]
    y_labels: Mapping[float, str]

    def points(self, x: ArrayLike, y: ArrayLike) -> list[tuple[float, float]]:
        """Data (n,), (n,) in units of the drawing, from the panel's upper left corner."""
        across = (np.asarray(x, dtype=np.float64) - self.x[0]) / (self.x[1] - self.x[0]) * WIDTH
        down = (1 - (np.asarray(y, dtype=np.float64) - self.y[0]) / (self.y[1] - self.y[0])) * HEIGHT
        return [(round(float(a), 1), round(float(d), 1)) for a, d in zip(across, down, strict=True)]


def learning_curves(robot: str, curves: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> str:
    """SVG of the learning curves of a robot's SAC runs, a panel a run.

    Args:
        robot: name of the robot, for the title.
        curves: label (`train0` ... `test4`) → environment steps (n,) and mean returns (n,).
    """
    last = max(steps[-1] for steps, _ in curves.values())
    returns = [value for _, values in curves.values() for value in values]
    marks = ticks(min(0.0, *returns), max(returns))
    x_labels = {0: "0", last / 2: _thousands(last / 2), last: f"{_thousands(last)} steps"}
    axes = Axes((0, last), (marks[0], marks[-1]), x_labels, {mark: f"{mark:g}" for mark in marks})
    lines = {label: _path(axes.points(*curve)) for label, curve in curves.items()}
    panels = {}
    for label, (_, values) in curves.items():
        split = _split(label)
        final = f'<text class="{split} end" x="{WIDTH - 6}" y="{HEIGHT - 8}">{values[-1]:.0f}</text>'
        panels[label] = f'<use href="#all"/><path class="line {split}" d="{lines[label]}"/>{final}'
    about = (
        f"Mean return of the last 100 episodes while SAC learns in each of {robot}'s bodies. The number is the last."
    )
    shared = f'<path id="all" class="others" d="{" ".join(lines.values())}"/>'
    return _chart(f"Learning curves of {robot}'s behaviour policies", about, axes, panels, shared)


def return_histograms(robot: str, returns: Mapping[str, tuple[NDArray[np.float64], NDArray[np.int64]]]) -> str:
    """SVG of the returns in a robot's data, a panel a snapshot.

    Args:
        robot: name of the robot, for the title.
        returns: `train` and `test` → returns (E,) and snapshots (E,) of the episodes.
    """
    everything = np.concatenate([values for values, _ in returns.values()])
    marks = ticks(float(everything.min()), float(everything.max()))
    edges = np.linspace(marks[0], marks[-1], BINS + 1)
    shares = {
        split: {int(snapshot): _shares(values[stamps == snapshot], edges) for snapshot in np.unique(stamps)}
        for split, (values, stamps) in returns.items()
    }
    above, below = (
        1.08 * max((float(share.max()) for share in shares.get(split, {}).values()), default=0.0) for split in SIDES
    )
    y_labels = {share: f"{100 * abs(share):g} %" for share in ticks(-below, above) if -below <= share <= above}
    axes = Axes((marks[0], marks[-1]), (-below, above), {mark: f"{mark:g}" for mark in marks}, y_labels)
    panels: dict[str, str] = {}
    for split, of_split in shares.items():
        for snapshot, share in sorted(of_split.items()):
            heights = SIDES[split] * np.concatenate([[0], np.repeat(share, 2), [0]])
            outline = _path(axes.points(np.repeat(edges, 2), heights))
            name = f"{_thousands(snapshot)} steps"
            panels[name] = panels.get(name, "") + f'<path class="area {split}" d="{outline}"/>'
    about = f"Share of the episodes by return: upwards in {robot}'s train bodies, downwards in its test bodies."
    return _chart(f"Returns in {robot}'s data by the age of the policy", about, axes, panels)


def _chart(title: str, about: str, axes: Axes, panels: Mapping[str, str], shared: str = "") -> str:
    """The whole file: heading, key, and the panels row by row; `shared` is drawn by panels that refer to it."""
    rows = math.ceil(len(panels) / COLUMNS)
    width = LEFT + COLUMNS * WIDTH + (COLUMNS - 1) * GAP // 2 + RIGHT
    height = TOP + rows * HEIGHT + (rows - 1) * GAP + BOTTOM
    parts = [
        f'<text class="end" x="{width - RIGHT}" y="30"><tspan class="train">■ train bodies</tspan>'
        '<tspan class="test" dx="12">■ test bodies</tspan></text>',
    ]
    for number, (name, inside) in enumerate(panels.items()):
        row, column = divmod(number, COLUMNS)
        place = LEFT + column * (WIDTH + GAP // 2), TOP + row * (HEIGHT + GAP)
        lowest = number + COLUMNS >= len(panels)
        parts.append(_panel(name, inside, axes, place, labelled=(lowest, column == 0)))
    return drawing((width, height), title, about, STYLE, parts, heading=(LEFT, 30), shared=shared)


def _panel(name: str, inside: str, axes: Axes, place: tuple[int, int], labelled: tuple[bool, bool]) -> str:
    """One panel: its name, its grid, what is in it, and the labels of its x and y axis where they are asked for."""
    parts = [
        f'<g transform="translate({place[0]} {place[1]})">',
        f'<rect class="panel" width="{WIDTH}" height="{HEIGHT}"/>',
    ]
    for tick, label in axes.y_labels.items():
        ((_, y),) = axes.points([axes.x[0]], [tick])
        parts.append(f'<path class="grid" d="M0 {y:g}H{WIDTH}"/>')
        if labelled[1]:
            parts.append(f'<text class="end" x="-7" y="{y + 4:g}">{label}</text>')
    if labelled[0]:
        places = [axes.points([tick], [axes.y[0]])[0][0] for tick in axes.x_labels]
        for x, label in zip(places, axes.x_labels.values(), strict=True):
            side = "start" if x == 0 else "end" if x == WIDTH else "middle"
            parts.append(f'<text class="{side}" x="{x:g}" y="{HEIGHT + 17}">{label}</text>')
    parts += [f'<text class="name" x="0" y="-6">{html.escape(name)}</text>', inside, "</g>"]
    return "".join(parts)


def _split(label: str) -> str:
    return "test" if label.startswith("test") else "train"


def _path(points: Sequence[tuple[float, float]]) -> str:
    """A line through points; one that stays on its height or place takes fewer letters."""
    steps = [f"M{points[0][0]:g} {points[0][1]:g}"]
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        if (x0, y0) != (x1, y1):
            steps.append(f"H{x1:g}" if y0 == y1 else f"V{y1:g}" if x0 == x1 else f"L{x1:g} {y1:g}")
    return "".join(steps)


def _shares(returns: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the episodes in each bin, (bins,), of returns (E,)."""
    return np.histogram(returns, edges)[0] / max(1, len(returns))


def _thousands(steps: float) -> str:
    """`50K`, `1M`: how the paper writes environment steps."""
    return f"{steps / 1e6:g}M" if steps >= 1e6 else f"{steps / 1e3:g}K"
