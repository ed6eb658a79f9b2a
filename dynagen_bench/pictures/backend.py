"""Which GL library draws, and the optional packages that pictures need: asked once, before anything is drawn.

What is here: `choose_backend` and `require`. Called by everything that draws or writes a picture. It must not know
robots or pictures.
"""

import functools
import importlib
import os
import subprocess
import sys
from typing import Final

BACKENDS: Final = ("egl", "osmesa", "glfw")
"""What Gymnasium's renderer takes as MUJOCO_GL. EGL and OSMesa need no display; GLFW does."""

_VARIABLE: Final = "MUJOCO_GL"

_PROBE: Final = (
    "import mujoco; context = mujoco.GLContext(16, 16); context.make_current(); "
    "mujoco.MjrContext(mujoco.MjModel.from_xml_string('<mujoco/>'), 100)"
)

_HELP: Final = (
    "install EGL (Debian: libegl1 libgl1-mesa-dri) or OSMesa (Debian: libosmesa6); "
    "MUJOCO_GL=egl, osmesa or glfw chooses"
)


def choose_backend() -> str:
    """Choose a GL backend that draws here and leave it in `MUJOCO_GL`, where Gymnasium's renderer reads it.

    What the user has set is kept. Else EGL, then OSMesa, and GLFW where there is a display. It has to be called before
    the first frame of the process; the libraries are tried in a process of their own, because a GL library that was
    loaded cannot be taken back, and some end the process that loads them.

    Raises:
        ValueError: MUJOCO_GL names no backend.
        RuntimeError: none of them draws; the message says what to install.
    """
    given = os.environ.get(_VARIABLE, "")
    if given and given not in BACKENDS:
        raise ValueError(f"MUJOCO_GL is {given!r}: choose one of {', '.join(BACKENDS)}, or leave it unset")
    display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    tried = (given,) if given else BACKENDS if display else BACKENDS[:2]
    for backend in tried:
        if _draws(backend):
            os.environ[_VARIABLE] = backend
            return backend
    raise RuntimeError(f"no frame can be drawn with GL by {' or '.join(tried)}: {_HELP}")


@functools.cache
def _draws(backend: str) -> bool:
    environment = {**os.environ, _VARIABLE: backend}
    done = subprocess.run([sys.executable, "-c", _PROBE], env=environment, capture_output=True, check=False)
    return done.returncode == 0


def require(module: str, purpose: str) -> None:
    """Check that a package of the [pictures] extra is there; raises RuntimeError with the command that installs it."""
    try:
        importlib.import_module(module)
    except ImportError:
        raise RuntimeError(f"{purpose} needs {module}: pip install 'dynagen-bench[pictures]'") from None
