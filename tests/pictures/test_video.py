"""Videos can be read again, and show what was asked for."""

import contextlib
from pathlib import Path

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from dynagen_bench.pictures import render_video


def read(path, **kwargs):
    """A small video, written and read: (F, H, W, 3) and what was said of it."""
    arguments = {"policy": "random", "width": 64, "height": 48, "speed": 0.5} | kwargs
    video = render_video("Hopper", arguments.pop("label", "test3"), path, **arguments)
    return imageio.imread(path), video


@pytest.mark.usefixtures("gl")
def test_an_mp4_has_the_frames_that_its_speed_asks_for(tmp_path):
    frames, video = read(tmp_path / "a.mp4", speed=0.4, seed=2)
    assert frames.shape == (video.frames, 48, 64, 3)
    assert video.frame_rate == pytest.approx(50)  # Hopper has 125 steps a second
    assert imageio.immeta(tmp_path / "a.mp4")["fps"] == pytest.approx(50)
    faster, less = read(tmp_path / "b.mp4", speed=1.0, seed=2)
    assert less.frame_rate == pytest.approx(62.5)
    assert less.returns == video.returns
    assert len(faster) == less.frames == (video.frames + 1) // 2
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.mp4", "b.mp4"]


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(("robot", "speed"), [("SlimHumanoid", 1.0), ("Hopper", 0.3)])
def test_a_gif_lasts_as_long_as_it_is_said_to(tmp_path, robot, speed):
    video = render_video(robot, "test3", tmp_path / "a.gif", policy="random", width=64, height=48, speed=speed)
    with Image.open(tmp_path / "a.gif") as gif:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
    assert len(durations) == video.frames > 10
    assert sum(durations) == pytest.approx(1000 * video.frames / video.frame_rate, abs=5)
    assert max(durations) - min(durations) == 10
    assert min(durations) >= 20  # what is shorter, browsers slow down


@pytest.mark.usefixtures("gl")
def test_a_policy_of_ones_own_is_filmed(tmp_path):
    class Still:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return np.zeros((len(observation), 3)), state

    own, told = read(tmp_path / "own.gif", policy=Still())
    zero, same = read(tmp_path / "zero.gif", policy="zero")
    assert told.returns == same.returns
    assert told.actor == "Still"
    assert own.shape == zero.shape
    with pytest.raises(ValueError, match=r"policy_of 'test0': leave one out"):
        read(tmp_path / "other.gif", policy=Still(), policy_of="test0")


@pytest.mark.usefixtures("gl")
def test_the_same_seed_gives_the_same_frames_and_other_dynamics_others(tmp_path):
    first, video = read(tmp_path / "a.gif")
    again, _ = read(tmp_path / "b.gif")
    other_body, _ = read(tmp_path / "c.gif", label="test0")
    other_seed, _ = read(tmp_path / "d.gif", seed=1)
    assert video.frames == len(first) > 2
    assert np.array_equal(first, again)
    for other in (other_body, other_seed):
        lower = slice(24, None)  # below the words
        assert len(other) != len(first) or not np.array_equal(other[:, lower], first[:, lower])


@pytest.mark.usefixtures("gl")
def test_another_ones_policy_acts_in_the_nominal_body_twice(tmp_path, tiny_policies):
    frames, video = read(
        tmp_path / "a.gif", label="nominal", policy="200", policy_of="train1", episodes=2, folder=tiny_policies
    )
    assert video.actor == "policy of train1, 200"
    assert len(video.returns) == 2
    assert video.returns[0] != video.returns[1]
    assert len(frames) == video.frames


def junk_writer(path, *_args, **_kwargs):
    """An ffmpeg on a full disk: it takes every frame, and what it leaves is no video."""
    with contextlib.suppress(GeneratorExit):
        while True:
            yield
    Path(path).write_bytes(b"junk")


def dying_writer(_path, *_args, **_kwargs):
    """An ffmpeg that stops, as imageio_ffmpeg tells it."""
    yield
    yield
    raise OSError("[Errno 32] Broken pipe\n\nFFMPEG COMMAND:\nffmpeg -y\n\nFFMPEG STDERR OUTPUT:\n")


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(
    ("writer", "message"),
    [
        (junk_writer, r"it has 0 of \d+ frames; look whether the disk is full"),
        (dying_writer, r"\[Errno 32\] Broken pipe"),
    ],
)
def test_an_mp4_that_is_not_whole_replaces_no_old_one(tmp_path, monkeypatch, writer, message):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"the old one")
    monkeypatch.setattr(imageio_ffmpeg, "write_frames", writer)
    with pytest.raises(OSError, match=f"^the mp4 could not be written: {message}$"):
        read(path)
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "a.avi"}, "let its name end in .mp4 or .gif"),
        ({"episodes": 0}, "episodes is 0: give a whole number from 1 on"),
        ({"episodes": 1.5}, "episodes is 1.5: give a whole number from 1 on"),
        ({"speed": 0.0}, "speed is 0: give a number from 0.01 to 100"),
        ({"seed": -1, "policy": "zero"}, "seed is -1: give a whole number from 0 on"),
        ({"width": 63}, "an even number from 32 to 2048"),
        ({"label": "test9"}, "from 0 to 4"),
        ({"policy_of": "best"}, "train0 to train19"),
        ({"policy": "random", "policy_of": "train0"}, "policy is 'random', which is of no dynamics"),
    ],
)
def test_a_mistake_writes_nothing(tmp_path, change, message):
    change = dict(change)
    with pytest.raises(ValueError, match=message):
        read(tmp_path / change.pop("name", "a.mp4"), **change)
    assert not list(tmp_path.iterdir())
