"""The page of all bodies: what was drawn, how the same actions end in several of them, what their data return.

What is here: `write_gallery`, one HTML file that needs nothing but itself. Called by `dynagen gallery`. It must not
know how a frame is drawn or a histogram made; how the page looks is in `gallery.html.jinja`.
"""

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium
from PIL import Image

from dynagen_bench import ids
from dynagen_bench.collection.policies import POLICY_FOLDER
from dynagen_bench.html import render
from dynagen_bench.pictures.backend import choose_backend
from dynagen_bench.pictures.factors import Group, factor_groups, legend
from dynagen_bench.pictures.returns import BINS, HEIGHT, Distributions, distributions, load_returns
from dynagen_bench.pictures.strips import LABELS, STEPS, Strip, draw_strips, make_strip
from dynagen_bench.whole import check_writable, write_whole

QUALITY: Final = 68
"""Of WebP; a frame of 240 × 240 pixels has about 3 kB."""


class Section(NamedTuple):
    """What the page has of one robot."""

    robot: str
    facts: list[tuple[str, str]]
    groups: list[Group]
    strip: Strip
    frames: dict[str, list[str]]
    """label → data: URIs, a moment each."""
    returns: Distributions


def write_gallery(
    output: Path,
    robots: Sequence[str] = ids.ROBOTS,
    *,
    labels: Sequence[str] = LABELS,
    steps: Sequence[int] = STEPS,
    size: int = 240,
    folder: Path = POLICY_FOLDER,
) -> None:
    """Write the page.

    Args:
        output: the HTML file.
        robots: which ones, in this order.
        labels: the dynamics that have a row of frames.
        steps: the control steps that have a frame.
        size: width and height of a frame, pixels.
        folder: where the behaviour policies are.

    Raises:
        ValueError: an unknown robot or dynamics, none or one twice, or data that are damaged.
        OSError: the file cannot be written.
        RuntimeError: a GL backend is missing.
    """
    for chosen in (robots, labels):
        if not chosen or len(set(chosen)) != len(chosen):
            raise ValueError(f"{list(chosen)} names nothing or something twice: give at least one, and none twice")
    for robot in robots:
        ids.check_robot(robot)
    check_writable(output)  # this and the next before minutes of work that ends there
    choose_backend()
    returns = {robot: distributions(load_returns(robot)) for robot in robots}
    strips = {robot: make_strip(robot, labels, steps, folder) for robot in robots}
    frames: dict[str, dict[str, list[str]]] = {robot: {label: [] for label in labels} for robot in robots}
    for robot, label, _, frame in draw_strips(list(strips.values()), size):
        frames[robot][label].append(_data_uri(frame))
    sections = [
        Section(robot, _facts(robot), factor_groups(robot), strips[robot], frames[robot], returns[robot])
        for robot in robots
    ]
    shown = {"legend": legend(), "bins": BINS, "height": HEIGHT, "size": size, "splits": ids.SPLIT_SIZES}
    page = render(__package__, "gallery.html.jinja", {}, sections=sections, **shown)
    write_whole(output, page)


def _data_uri(frame: Image.Image) -> str:
    content = io.BytesIO()
    frame.save(content, "WEBP", quality=QUALITY, method=6)
    return "data:image/webp;base64," + base64.b64encode(content.getvalue()).decode()


def _facts(robot: str) -> list[tuple[str, str]]:
    """What a reader wants to know of a robot first, as name and value."""
    env = gymnasium.make(ids.v0_env_id(robot), split="nominal")
    base: Any = env.unwrapped
    facts = [
        ("Gymnasium id", ids.v0_env_id(robot)),
        ("observation", f"{base.observation_space.shape[0]}"),
        ("action", f"{base.action_space.shape[0]}"),
        ("control step", f"{1000 * base.dt:g} ms"),
        ("bodies", f"{base.model.nbody - 1}"),
        ("geoms", f"{base.model.ngeom}"),
        ("degrees of freedom", f"{base.model.nv}"),
    ]
    env.close()
    return facts
