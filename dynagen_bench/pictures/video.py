"""Videos of episodes.

What is here: `render_video`, one actor in one dynamics, written as mp4 or gif. Called by `dynagen render`. It must not
know how an actor chooses or how a frame is drawn.
"""

import contextlib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dynagen_bench import ids
from dynagen_bench.collection.policies import POLICY_FOLDER
from dynagen_bench.envs import HORIZON
from dynagen_bench.pictures.actors import Act, Predicts, choose_actor, given_actor
from dynagen_bench.pictures.backend import require
from dynagen_bench.pictures.frames import add_caption, open_robot
from dynagen_bench.terminal import track
from dynagen_bench.whole import whole_file

FRAME_RATES: Final = {".mp4": 60.0, ".gif": 25.0}
"""Suffix → about as many frames a second as such a file shows well; browsers slow down a gif of over 50."""

Write = Callable[[NDArray[np.uint8]], None]


class Video(NamedTuple):
    """What was written."""

    frames: int
    frame_rate: float
    """Frames a second."""
    returns: list[float]
    """Undiscounted, an episode."""
    actor: str
    """Who acted, in words."""

    def __str__(self) -> str:
        """One line: who acted, what it returned, and how long the video is."""
        returns = ", ".join(f"{total:.1f}" for total in self.returns)
        return f"{self.actor}, return {returns}, {self.frames} frames, {self.frames / self.frame_rate:.1f} s"


def render_video(
    robot: str,
    label: str,
    output: Path,
    *,
    policy: str | Predicts = "best",
    policy_of: str | None = None,
    episodes: int = 1,
    seed: int = 0,
    speed: float = 1.0,
    width: int = 480,
    height: int = 480,
    folder: Path = POLICY_FOLDER,
) -> Video:
    """Write a video of episodes in one dynamics, one after the other.

    The same arguments give the same frames; a behaviour policy's episode of a reset seed is that of the data.

    Args:
        robot: name of the robot.
        label: `train0` to `train19`, `test0` to `test4`, or `nominal`.
        output: the file, `.mp4` or `.gif`.
        policy: `best`, a snapshot's environment steps, `random` or `zero`; or a policy of one's own, that `evaluate`
            would score, as `agents.load("runs/dadt-Hopper-seed0").policy()`.
        policy_of: the dynamics whose behaviour policies act; those of `label` if not given.
        episodes: how many.
        seed: reset seed of the first episode; the next one has the next number.
        speed: 1 is real time, 0.25 is slow motion.
        width: of a frame, pixels, even.
        height: of a frame, pixels, even.
        folder: where the behaviour policies are.

    Raises:
        ValueError: an unknown robot, dynamics or policy, another suffix, or a number that makes no video.
        FileNotFoundError: no behaviour policies of that dynamics.
        OSError: the file cannot be written, as on a full disk; what was at `output` is still there.
        RuntimeError: the [pictures] extra or a GL backend is missing.
    """
    name, source = ids.parse_label(ids.check_robot(robot), label), ids.parse_label(robot, policy_of or label)
    if policy_of and (not isinstance(policy, str) or policy in ("random", "zero")):
        raise ValueError(f"policy is {policy!r}, which is of no dynamics, and policy_of {policy_of!r}: leave one out")
    if output.suffix not in FRAME_RATES:
        raise ValueError(f"cannot write {output.name!r}: let its name end in {' or '.join(FRAME_RATES)}")
    episodes, seed = ids.check_count("episodes", episodes), ids.check_count("seed", seed, least=0)
    if not 0.01 <= speed <= 100:
        raise ValueError(f"speed is {speed:g}: give a number from 0.01 to 100")
    if output.suffix == ".mp4":
        require("imageio_ffmpeg", "an mp4")
    env = open_robot(name, width, height)
    try:
        space: Any = env.action_space
        actor = choose_actor(policy, source, space.high, folder) if isinstance(policy, str) else given_actor(policy)
        rate = speed * env.metadata["render_fps"]
        stride = max(1, round(rate / FRAME_RATES[output.suffix]))
        count, returns = 0, []
        with (
            whole_file(output) as unfinished,
            _open_video(unfinished, output.suffix, rate / stride, (width, height)) as write,
        ):
            for episode in range(episodes):
                words = (f"{robot} {label}", actor.label)
                frames, total = _film(env, actor.start(seed + episode), seed + episode, stride, words, write)
                count += frames
                returns.append(total)
    finally:
        env.close()
    return Video(count, rate / stride, returns, actor.label)


def _film(
    env: gymnasium.Env[Any, Any], act: Act, seed: int, stride: int, words: tuple[str, ...], write: Write
) -> tuple[int, float]:
    """Write the frames of one episode: its start, and every `stride` steps; returns their number and the return."""
    observation, _ = env.reset(seed=seed)
    total = reward = 0.0
    write(_frame(env, words, 0, total))
    frames = 1
    for t in track(range(HORIZON), f"{words[0]}, seed {seed}", HORIZON):
        observation, earned, terminated, truncated, _ = env.step(act(observation, t, reward))
        reward = float(earned)
        total += reward
        if (t + 1) % stride == 0:
            write(_frame(env, words, t + 1, total))
            frames += 1
        if terminated or truncated:
            break
    return frames, total


def _frame(env: gymnasium.Env[Any, Any], words: tuple[str, ...], step: int, total: float) -> NDArray[np.uint8]:
    frame: Any = env.render()
    return add_caption(frame, "\n".join(words), f"step {step}\nreturn {total:.1f}")


@contextlib.contextmanager
def _open_video(path: Path, suffix: str, rate: float, size: tuple[int, int]) -> Iterator[Write]:
    """Yield what adds a frame of `size` (width, height) to the file at `path`, whose own name says no format."""
    if suffix == ".mp4":
        with _open_mp4(path, rate, size) as write:
            yield write
        return
    frames: list[Image.Image] = []
    yield lambda frame: frames.append(Image.fromarray(frame))
    # a gif counts in hundredths: each frame ends at the one nearest to its moment, so that the rounding does not add up
    ends = [round(100 * (i + 1) / rate) for i in range(len(frames))]
    durations = [10 * (end - start) for start, end in itertools.pairwise([0, *ends])]  # ms
    frames[0].save(path, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)


@contextlib.contextmanager
def _open_mp4(path: Path, rate: float, size: tuple[int, int]) -> Iterator[Write]:
    """As `_open_video`; counts the frames of the file in the end, as imageio_ffmpeg does not look how ffmpeg ends.

    Raises:
        OSError: ffmpeg has stopped, or has not written them all.
    """
    import imageio_ffmpeg  # type: ignore[import-untyped]

    sent = 0

    def write(frame: NDArray[np.uint8]) -> None:
        nonlocal sent
        try:
            ffmpeg.send(np.ascontiguousarray(frame))
        except OSError as error:
            first, _, _ = str(error).partition("\n")  # ffmpeg's whole command comes after it
            raise OSError(f"the mp4 could not be written: {first}") from error
        sent += 1

    encoding = {"fps": rate, "codec": "libx264", "quality": 8, "macro_block_size": 2}
    with contextlib.closing(
        imageio_ffmpeg.write_frames(str(path), size, **encoding, output_params=["-f", "mp4"])
    ) as ffmpeg:
        ffmpeg.send(None)  # starts it
        yield write
    try:
        found, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:  # no video at all
        found = 0
    if found != sent:
        raise OSError(f"the mp4 could not be written: it has {found} of {sent} frames; look whether the disk is full")
