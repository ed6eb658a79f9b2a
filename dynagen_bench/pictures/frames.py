"""Frames of a robot, drawn by its own environment.

What is here: an environment made to be looked at, a frame of a stored state, and captions. Called by videos and strips.
It must not know policies, data or files.
"""

from typing import Any, Final

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dynagen_bench import ids
from dynagen_bench.pictures.backend import choose_backend

CAMERA: Final = "track"
"""The camera in every robot's model that keeps its centre of mass in view. Gymnasium's default one stands still, and a
Hopper has left its picture after two seconds."""

SKY: Final = 236
FLOOR: Final = (175, 230)
"""Grey levels of the sky, and of the floor's dark and light squares: the stock ones, black and white, hide a leg."""

INK: Final = (32, 38, 46)
"""Colour of words in a frame."""

SMALLEST: Final = 32
LARGEST: Final = 2048
"""Allowed width and height of a frame, pixels."""


def check_pixels(what: str, pixels: int) -> None:
    """Raise ValueError if frames cannot be that many pixels wide or high; `what` is what the user calls the number."""
    if not SMALLEST <= pixels <= LARGEST or pixels % 2:
        raise ValueError(f"{what} is {pixels} pixels: give an even number from {SMALLEST} to {LARGEST}")


def open_robot(name: ids.DynamicsId, width: int, height: int) -> gymnasium.Env[NDArray[np.float64], Any]:
    """Gymnasium's environment of one dynamics, rendering to arrays (height, width, 3) uint8 from the side.

    Raises:
        ValueError: a size that cannot be drawn, or MUJOCO_GL names no backend.
        RuntimeError: no GL backend draws here.
    """
    check_pixels("width", width)
    check_pixels("height", height)
    choose_backend()
    env = gymnasium.make(
        ids.v0_env_id(name.robot),
        split=name.split,
        index=name.index,
        render_mode="rgb_array",
        width=width,
        height=height,
        camera_name=CAMERA,
    )
    _calm(env.unwrapped.model)  # type: ignore[attr-defined] # gymnasium declares the base class
    return env


def _calm(model: mujoco.MjModel) -> None:
    """Change what the model looks like, and nothing that moves it; textures go to GL with the first frame."""
    dark, light = FLOOR
    for texture in range(model.ntex):
        size = model.tex_height[texture] * model.tex_width[texture] * model.tex_nchannel[texture]
        pixels = model.tex_data[model.tex_adr[texture] : model.tex_adr[texture] + size]
        if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            pixels[:] = SKY
        elif model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:  # the floor's
            brightest = max(int(pixels.max()), 1)
            pixels[:] = (dark + (light - dark) * (pixels / brightest)).astype(np.uint8)
    # No shadow, which software GL draws with black patches, but a reflection: it shows too where the feet are.
    model.light_castshadow[:] = 0
    model.mat_reflectance[:] = 0.2
    model.vis.headlight.ambient[:] = 0.3
    model.light_diffuse[:] = 0.8


def frame_of(env: gymnasium.Env[Any, Any], qpos: NDArray[np.float64]) -> Image.Image:
    """The frame of a robot in pose qpos (nq,).

    Mass, inertia, damping and friction have no looks, but the camera follows the centre of mass: poses of several
    dynamics that are to be compared are drawn by one environment.
    """
    base: Any = env.unwrapped
    base.set_state(qpos, np.zeros(base.model.nv))
    return Image.fromarray(np.ascontiguousarray(base.render()))


def add_caption(frame: NDArray[np.uint8], left: str, right: str) -> NDArray[np.uint8]:
    """The frame (H, W, 3) with words in its sky, from its upper corners; a line break starts a new line."""
    picture = Image.fromarray(np.ascontiguousarray(frame))
    size = max(min(picture.width, picture.height) // 22, 8)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=size)
    for words, x, anchor, align in ((left, size, "la", "left"), (right, picture.width - size, "ra", "right")):
        draw.multiline_text((x, size), words, INK, font, anchor, align=align)
    return np.asarray(picture)
