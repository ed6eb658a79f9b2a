"""The same actions lead somewhere else in another body, and the picture shows it."""

import numpy as np
import pytest
from PIL import Image

from dynagen_bench.pictures import strips
from dynagen_bench.pictures.strips import make_strip, write_strip

LABELS = ("nominal", "test0", "test3")


def test_bodies_start_alike_and_part(tiny_policies):
    strip = make_strip("Hopper", LABELS, (0, 10, 40), tiny_policies)
    assert strip.qpos.shape == (3, 3, 6)
    assert strip.seconds == pytest.approx((0.0, 0.08, 0.32))
    assert (strip.qpos[:, 0] == strip.qpos[0, 0]).all()
    assert not strip.travelled[:, 0].any()
    parted = [np.abs(strip.qpos[i, 1] - strip.qpos[j, 1]).max() for i, j in ((0, 1), (0, 2), (1, 2))]
    assert min(parted) > 1e-4
    assert "test0" in strip.actions


def test_an_end_is_told_and_the_physics_goes_on(tiny_policies):
    strip = make_strip("Hopper", LABELS, (0, 60, 80), tiny_policies)
    assert all(ended is not None and 0 < ended < strip.seconds[1] for ended in strip.ended)  # untrained: it falls
    assert (strip.qpos[:, 1] != strip.qpos[:, 2]).any(axis=1).all()


def test_a_robot_without_policies_swings(tmp_path):
    strip = make_strip("HalfCheetah", ("test0", "test1"), (0, 30), tmp_path)
    assert "swing" in strip.actions
    assert strip.ended == (None, None)
    assert strip.travelled[0, 1] != strip.travelled[1, 1]


@pytest.mark.usefixtures("gl")
def test_the_picture_has_a_column_a_body_and_a_row_a_moment(tmp_path):
    path = tmp_path / "bodies.png"
    write_strip("HalfCheetah", path, labels=("test0", "test1"), steps=(0, 30), size=48, folder=tmp_path)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape == (8 + 2 * 50, 16 + 2 * 50, 3)
    frames = [[picture[8 + 50 * j : 56 + 50 * j, 16 + 50 * i : 64 + 50 * i] for i in (0, 1)] for j in (0, 1)]
    assert np.array_equal(frames[0][0], frames[0][1])
    assert not np.array_equal(frames[1][0], frames[1][1])
    assert not np.array_equal(frames[0][0], frames[1][0])


def test_the_gl_library_is_looked_for_before_the_work(tmp_path, monkeypatch):
    def missing():
        raise RuntimeError("no frame can be drawn")

    monkeypatch.setattr(strips, "choose_backend", missing)
    monkeypatch.setattr(strips, "make_strip", None)
    with pytest.raises(RuntimeError, match="no frame can be drawn"):
        write_strip("Hopper", tmp_path / "a.png", folder=tmp_path)


def test_mistakes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="numbers from 0 to 200"):
        make_strip("Hopper", LABELS, (0, 201), tmp_path)
    with pytest.raises(ValueError, match=r"let its name end in .png, .webp, .jpg"):
        write_strip("Hopper", tmp_path / "a.bmp")
    for size in (-2, 31, 2050, 10**9):
        with pytest.raises(ValueError, match=f"^size is {size} pixels: give an even number from 32 to 2048$"):
            write_strip("Hopper", tmp_path / "a.png", size=size, folder=tmp_path)
