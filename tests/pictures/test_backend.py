"""The GL backend is chosen by what draws, and a missing one is said in one line."""

import os
import subprocess
import sys

import pytest

from dynagen_bench.pictures.backend import BACKENDS, choose_backend, require

CHOOSE = """
import os, sys
import dynagen_bench  # imports MuJoCo, before the backend is named
from dynagen_bench.pictures.backend import choose_backend
os.environ.update(dict(pair.split("=") for pair in sys.argv[1:]))
try:
    print(choose_backend())
except (ValueError, RuntimeError) as error:
    print(error, file=sys.stderr)
    sys.exit(2)
"""


def choose(*settings: str) -> subprocess.CompletedProcess[str]:
    """`choose_backend` in a fresh process without display and with the given variables."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    environment.pop("PYOPENGL_PLATFORM", None)  # left by MuJoCo's EGL, if this process has drawn
    return subprocess.run(
        [sys.executable, "-c", CHOOSE, *settings], env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.usefixtures("gl")
def test_a_backend_is_chosen_without_display():
    done = choose()
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in BACKENDS[:2]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["MUJOCO_GL=glfw"], "libegl1"),  # there is no display
        (["MUJOCO_GL=egl", "PYOPENGL_PLATFORM=osmesa"], "libegl1"),  # MuJoCo refuses the pair
        (["MUJOCO_GL=cgl"], "choose one of egl, osmesa, glfw"),
    ],
)
def test_a_backend_that_does_not_draw_ends_in_one_line(settings, message):
    done = choose(*settings)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert message in done.stderr
    assert "MUJOCO_GL" in done.stderr


def test_osmesa_ends_in_one_line_where_it_is_not_installed():
    done = choose("MUJOCO_GL=osmesa")
    if done.returncode == 0:
        pytest.skip("OSMesa is installed and draws")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "libosmesa6" in done.stderr


def test_what_the_user_set_is_kept(monkeypatch, gl):
    monkeypatch.setenv("MUJOCO_GL", gl)
    assert choose_backend() == gl
    assert os.environ["MUJOCO_GL"] == gl


def test_a_missing_extra_is_one_line():
    with pytest.raises(RuntimeError, match=r"an mp4 needs no_such_package: pip install 'dynagen-bench\[pictures\]'"):
        require("no_such_package", "an mp4")
    require("json", "anything")
