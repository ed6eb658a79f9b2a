"""The same actions in several bodies, as rows of frames.

What is here: the poses that one sequence of actions leads to in several dynamics, and one picture of them. Called by
the gallery and by `dynagen strip`. It must not know HTML or data.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dynagen_bench import ids
from dynagen_bench.collection.best import best_snapshot
from dynagen_bench.collection.episodes import roll_out
from dynagen_bench.collection.policies import POLICY_FOLDER, policy_file
from dynagen_bench.dynamics import compile_nominal, load_dynamics
from dynagen_bench.envs import HORIZON, ROBOT_CLASSES, BatchPhysics
from dynagen_bench.pictures.actors import smooth_actions, stored_snapshots
from dynagen_bench.pictures.backend import choose_backend
from dynagen_bench.pictures.frames import INK, check_pixels, frame_of, open_robot
from dynagen_bench.terminal import track
from dynagen_bench.whole import check_writable, whole_file

LABELS: Final = ("nominal", "test0", "test1", "test2", "test3", "test4")
STEPS: Final = (0, 20, 40, 60, 80)
"""Control steps that have a frame."""
SEED: Final = 0
"""Reset seed of the start, and of the swinging actions where there is no policy."""
ACTOR_LABEL: Final = "test0"
"""The dynamics whose best behaviour policy gives the actions, where there is one."""


@dataclasses.dataclass(frozen=True, eq=False)
class Strip:
    """What the same actions lead to, in L dynamics at F moments.

    Attributes:
        robot: name of the robot.
        labels: (L) names of the dynamics.
        seconds: (F) moments, s.
        qpos: (L, F, nq) float64, the poses.
        travelled: (L, F) float64, displacement of the root along x since the start, m.
        ended: (L) seconds after which an episode would have ended here, s; None if it would not have by the last
            moment. The physics goes on.
        actions: whose actions they are, in words.
    """

    robot: str
    labels: tuple[str, ...]
    seconds: tuple[float, ...]
    qpos: NDArray[np.float64]
    travelled: NDArray[np.float64]
    ended: tuple[float | None, ...]
    actions: str


def make_strip(
    robot: str, labels: Sequence[str] = LABELS, steps: Sequence[int] = STEPS, folder: Path = POLICY_FOLDER
) -> Strip:
    """Repeat one episode's actions in several dynamics, from the same start.

    The actions are those of the best behaviour policy of `test0` in its own dynamics, or swinging ones where the robot
    has no stored policies.

    Raises:
        ValueError: an unknown robot or dynamics, no dynamics, or a step outside the horizon.
    """
    names = [ids.parse_label(ids.check_robot(robot), label) for label in labels]
    if not steps or min(steps) < 0 or max(steps) > HORIZON:
        raise ValueError(f"steps {list(steps)} are no moments of an episode: give numbers from 0 to {HORIZON}")
    physics = BatchPhysics(robot, [load_dynamics(robot, name.split, name.index) for name in names])
    control_step = compile_nominal(robot).opt.timestep * ROBOT_CLASSES[robot].substeps  # s
    actions, words = _actions(robot, physics.action_limit, control_step, folder)
    everyone = np.arange(len(names))
    physics.start(everyone, [seeding.np_random(SEED)[0] for _ in names])
    qpos = [physics.qpos.copy()]
    ended: list[float | None] = [None] * len(names)
    for t in range(max(steps)):
        terminated = physics.step(np.repeat(actions[t : t + 1], len(names), axis=0)).terminated
        qpos.append(physics.qpos.copy())
        for i in np.flatnonzero(terminated):
            if ended[i] is None:
                ended[i] = (t + 1) * control_step
    poses = np.stack([qpos[step] for step in steps], axis=1)  # (L, F, nq)
    return Strip(
        robot=robot,
        labels=tuple(labels),
        seconds=tuple(step * control_step for step in steps),
        qpos=poses,
        travelled=poses[:, :, 0] - qpos[0][:, :1],
        ended=tuple(ended),
        actions=words,
    )


def _actions(
    robot: str, limit: NDArray[np.float64], control_step: float, folder: Path
) -> tuple[NDArray[np.float32], str]:
    """Actions (HORIZON, A), zero after the episode's end, and whose they are."""
    name = ids.parse_label(robot, ACTOR_LABEL)
    if not policy_file(name, folder).is_file():
        words = "A swing of each joint, 0.5 to 2 times a second"
        return smooth_actions(SEED, limit, control_step), words
    snapshots = stored_snapshots(name, folder)
    step = best_snapshot(name, snapshots)
    own = BatchPhysics(robot, [load_dynamics(robot, name.split, name.index)])
    (episode,) = roll_out(own, snapshots[step], step, [SEED])
    actions = np.zeros((HORIZON, len(limit)), dtype=np.float32)
    actions[: len(episode)] = episode.actions
    return actions, f"The actions of an episode of {ACTOR_LABEL}, by its best behaviour policy (after {step:,} steps)"


def draw_strips(strips: Sequence[Strip], size: int) -> Iterator[tuple[str, str, int, Image.Image]]:
    """Yield robot, label, number of the moment and its frame, size × size pixels, strip by strip, under one bar.

    Raises:
        ValueError: a size that cannot be drawn.
        RuntimeError: no GL backend draws here.
    """
    yield from track(_draw(strips, size), "frames", sum(strip.qpos[..., 0].size for strip in strips))


def _draw(strips: Sequence[Strip], size: int) -> Iterator[tuple[str, str, int, Image.Image]]:
    for strip in strips:
        env = open_robot(ids.make_id(strip.robot, "nominal", 0), size, size)
        try:
            env.reset(seed=SEED)
            for i, label in enumerate(strip.labels):
                for j in range(len(strip.seconds)):
                    yield strip.robot, label, j, frame_of(env, strip.qpos[i, j])
        finally:
            env.close()


def write_strip(
    robot: str,
    output: Path,
    *,
    labels: Sequence[str] = LABELS,
    steps: Sequence[int] = STEPS,
    size: int = 160,
    folder: Path = POLICY_FOLDER,
) -> None:
    """Write one picture of the same actions in several dynamics: a column a dynamics, a row a moment.

    Args:
        robot: name of the robot.
        output: the file, `.png`, `.webp` or `.jpg`.
        labels: the dynamics.
        steps: the control steps that have a frame.
        size: width and height of a frame, pixels.
        folder: where the behaviour policies are.

    Raises:
        ValueError: as `make_strip`, another suffix, or a size that cannot be drawn.
        OSError: the file cannot be written.
        RuntimeError: no GL backend draws here.
    """
    formats = {".png": "PNG", ".webp": "WEBP", ".jpg": "JPEG"}
    if output.suffix not in formats:
        raise ValueError(f"cannot write {output.name!r}: let its name end in {', '.join(formats)}")
    check_pixels("size", size)  # before a picture of many of them is allocated
    ids.check_robot(robot)
    check_writable(output)  # this and the next before the work that ends there
    choose_backend()
    strip = make_strip(robot, labels, steps, folder)
    margin, head, pitch = size // 3, size // 6, size + 2
    picture = Image.new("RGB", (margin + pitch * len(labels), head + pitch * len(steps)), "white")
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size=max(size // 11, 8))
    for i, label in enumerate(labels):
        draw.text((margin + pitch * i + size // 2, head // 2), label, INK, font, "mm")
    for j, seconds in enumerate(strip.seconds):
        draw.text((margin // 2, head + pitch * j + size // 2), f"{seconds:.2f} s", INK, font, "mm")
    for _, label, j, frame in draw_strips([strip], size):
        picture.paste(frame, (margin + pitch * strip.labels.index(label), head + pitch * j))
    with whole_file(output) as unfinished:
        picture.save(unfinished, formats[output.suffix], quality=82)
