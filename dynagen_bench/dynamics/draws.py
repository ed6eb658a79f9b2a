"""The draws of the benchmark: 20 train and 5 test dynamics of each robot, and how one makes more.

What is here: drawing from a seed, and reading the reviewed draws of v0 from the package's JSON files. Called by the
environments and the command line. It must not know how factors reach a model.

The files hold what `draw_split` gives for `SEED`; a test pins their hashes and draws them again.
"""

import functools
import importlib.resources
import json
from typing import Any, Final

import numpy as np

from dynagen_bench import ids
from dynagen_bench.dynamics.parameters import PARAMETERS, Dynamics, nominal_robot

SEED: Final = 20221128
"""Entropy of v0's draws: the first day of NeurIPS 2022, where the paper appeared at a workshop."""

DRAWN: Final = tuple(
    parameter
    for parameter in PARAMETERS
    if parameter.field in ("body_mass", "body_inertia", "dof_damping", "geom_friction")
)
"""The parameters that v0 draws; one that is added to `PARAMETERS` can be set, and is drawn in a version of its own."""

LOG_RANGE: Final = 3.0
"""r ~ Uniform(-3, 3) in base**r (paper, appendix B)."""

DECIMALS: Final = 6
"""Factors are rounded, so that the file that was reviewed is the definition, whatever a platform's pow() gives."""


def draw_dynamics(robot: str, rng: np.random.Generator) -> Dynamics:
    """Draw one dynamics: every element of every parameter has its own r ~ Uniform(-3, 3).

    Drawn in the order of `DRAWN`, elements in MuJoCo's order, the floor geom included and the massless world body
    left out. An element whose nominal value is 0 (the damping of a root joint) has a draw that does nothing.

    Raises:
        TypeError: a seed in place of a generator.
    """
    if not isinstance(rng, np.random.Generator):
        raise TypeError(f"rng is {rng!r}: give a generator, np.random.default_rng(seed)")
    drawn: dict[str, dict[str, float]] = {}
    for parameter in DRAWN:
        names = [name for name in nominal_robot(robot).names[parameter.element] if name != "world"]
        factors = parameter.base ** rng.uniform(-LOG_RANGE, LOG_RANGE, size=len(names))
        drawn[parameter.field] = {name: round(float(f), DECIMALS) for name, f in zip(names, factors, strict=True)}
    return Dynamics.from_json(drawn)


def draw_split(robot: str, split: str, seed: int = SEED) -> list[Dynamics]:
    """Draw the dynamics of one split; each depends on (seed, robot, split, index) alone.

    Raises:
        ValueError: an unknown robot or split, or `nominal`, of which there is nothing to draw.
    """
    if ids.check_split(split) == "nominal":
        raise ValueError("split 'nominal' is the unchanged robot: draw 'train' or 'test'")
    return [
        draw_dynamics(robot, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=name.key)))
        for name in ids.dynamics_ids(robot, (split,))
    ]


@functools.cache
def _read(robot: str) -> dict[str, Any]:
    file = importlib.resources.files("dynagen_bench.dynamics") / "data" / f"{ids.check_robot(robot)}.json"
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return content


def load_dynamics(robot: str, split: str, index: int) -> Dynamics:
    """The benchmark's own dynamics of this name; `nominal` has no factors.

    Raises:
        ValueError: an unknown robot or split, or an index that the split does not have.
    """
    name = ids.make_id(robot, split, index)
    if name.split == "nominal":
        return Dynamics()
    return Dynamics.from_json(_read(robot)[name.split][name.index])


def drawn_factors(dynamics: Dynamics) -> dict[str, dict[str, float]]:
    """The factors of what v0 draws, as plain data; a parameter that is added since is not among them."""
    plain = dynamics.to_json()
    return {parameter.field: plain[parameter.field] for parameter in DRAWN}


def draws_json(robot: str, seed: int = SEED) -> str:
    """The text of a robot's JSON file: how it was drawn, then its factors, one element a line for review."""
    content = {
        "robot": robot,
        "drawn": f"base**r, r ~ Uniform(-{LOG_RANGE:g}, {LOG_RANGE:g}), one draw an element",
        "seed": seed,
        "base": {parameter.field: parameter.base for parameter in DRAWN},
        **{
            split: [drawn_factors(dynamics) for dynamics in draw_split(robot, split, seed)]
            for split in ("train", "test")
        },
    }
    return json.dumps(content, indent=1) + "\n"
