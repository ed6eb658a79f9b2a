"""What may differ between two bodies of one robot, and how a set of factors becomes a MuJoCo model.

What is here: the table of the four varied parameters, `Dynamics` (plain factors by element name) and `apply_dynamics`.
Called by the environments, the drawing code and the command line. It must not know splits, seeds or files.
"""

import dataclasses
import functools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium.envs.mujoco
import mujoco
import numpy as np
from numpy.typing import NDArray

from dynagen_bench import ids


class Parameter(NamedTuple):
    """One kind of parameter: what it is called in MuJoCo, and how far it is drawn from its nominal value."""

    field: str
    """The `mjModel` field it multiplies, and its name in every file of ours."""
    element: str
    """What has a factor of its own: `body`, `geom` or `dof`."""
    base: float
    """A factor is base**r with r ~ Uniform(-3, 3) (paper, appendix B)."""
    unit: str
    meaning: str


PARAMETERS: Final = (
    Parameter("body_mass", "body", 1.5, "kg", "mass of a body"),
    Parameter("body_inertia", "body", 1.5, "kg m²", "inertia of a body, one factor for its three axes"),
    Parameter("dof_damping", "dof", 1.3, "N s/m, N m s/rad", "viscous damping of a degree of freedom"),
    Parameter("geom_friction", "geom", 1.5, "1", "friction of a geom; a contact takes the larger of its two geoms"),
)

MODEL_FILES: Final = {
    "Walker": "walker2d_v5.xml",
    "Hopper": "hopper.xml",
    "HalfCheetah": "half_cheetah.xml",
    "SlimHumanoid": "humanoid.xml",
    "Ant": "ant.xml",
}
"""Gymnasium's own model of each robot, in its package's assets; we ship no XML."""


@dataclasses.dataclass(frozen=True)
class Dynamics:
    """Factors on one robot's nominal parameters; an element that is not named keeps its nominal value.

    Attributes:
        body_mass, body_inertia: body name → factor, without unit.
        dof_damping: degree of freedom → factor, without unit.
        geom_friction: geom name → factor, without unit.
    """

    body_mass: Mapping[str, float] = dataclasses.field(default_factory=dict)
    body_inertia: Mapping[str, float] = dataclasses.field(default_factory=dict)
    dof_damping: Mapping[str, float] = dataclasses.field(default_factory=dict)
    geom_friction: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Dynamics":
        """Read the plain form `{"body_mass": {"torso": 1.3}, ...}`.

        Raises:
            ValueError: an unknown parameter, a factor that is not a finite number above 0, or a `Dynamics`, which is no
                plain data.
        """
        known = [parameter.field for parameter in PARAMETERS]
        if isinstance(data, Dynamics):
            raise ValueError("dynamics are plain data, as an environment's spec holds them: give dynamics.to_json()")
        if not isinstance(data, Mapping) or not set(data) <= set(known):
            given = sorted(set(data) - set(known), key=str) if isinstance(data, Mapping) else data
            raise ValueError(f"unknown dynamics parameter {given!r}: choose from {', '.join(known)}")
        for field, factors in data.items():
            if not isinstance(factors, Mapping):
                raise ValueError(f"{field} must map element names to factors, got {factors!r}")
            for name, factor in factors.items():
                number = isinstance(factor, int | float | np.integer | np.floating) and not isinstance(factor, bool)
                if not number or not 0 < factor <= sys.float_info.max:  # no infinity, no NaN, no int beyond all floats
                    raise ValueError(
                        f"{field} of {name!r} must be a finite factor above 0, as a number, got {factor!r}"
                    )
        return cls(**{field: {name: float(f) for name, f in factors.items()} for field, factors in data.items()})

    def to_json(self) -> dict[str, dict[str, float]]:
        """The plain form that `from_json` reads: numbers and strings only, as an environment's spec holds it."""
        return {parameter.field: dict(getattr(self, parameter.field)) for parameter in PARAMETERS}


class NominalRobot(NamedTuple):
    """What `apply_dynamics` starts from: a robot's own values, by `mjModel` field, and the names of their elements."""

    values: Mapping[str, NDArray[np.float64]]
    names: Mapping[str, tuple[str, ...]]
    """`body`, `geom`, `dof` → names in MuJoCo's order. The world body is named `world`; it has no mass."""


def model_path(robot: str) -> Path:
    """Path of Gymnasium's XML of a robot; raises ValueError for an unknown robot."""
    return Path(gymnasium.envs.mujoco.__file__).parent / "assets" / MODEL_FILES[ids.check_robot(robot)]


def compile_nominal(robot: str, contact_forces: bool = False) -> mujoco.MjModel:
    """Compile Gymnasium's model of a robot; raises ValueError for an unknown robot.

    With `contact_forces`, the root body carries an accelerometer, for which the engine computes `cfrc_ext` in every
    forward pass; it changes no trajectory.

    HalfCheetah's XML asks the compiler to scale the total mass, which MuJoCo 4 does with a warning on stderr and in
    a log file, each time: the same scaling is done on the compiled model instead, as that warning advises.
    """
    spec = mujoco.MjSpec.from_file(str(model_path(robot)))
    total_mass, spec.compiler.settotalmass = spec.compiler.settotalmass, -1.0
    if contact_forces:
        root = spec.bodies[1]
        site = root.add_site(name="root_site")
        spec.add_sensor(type=mujoco.mjtSensor.mjSENS_ACCELEROMETER, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site.name)
    model = spec.compile()
    if total_mass > 0:
        mujoco.mj_setTotalmass(model, total_mass)
        _set_derived(model)
    return model


def _set_derived(model: mujoco.MjModel) -> None:
    """Recompute what MuJoCo derives from masses, inertias and friction, as its compiler would.

    `mj_setConst` leaves `stat.meaninertia` (it scales the solver's tolerance) and `stat.meanmass` as compiled.
    It moves the `MjData` that it is given to the reference pose, so it gets one of its own.
    """
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # cumsum adds from left to right, as the compiler does; sum() does not from Python 3.12 on, and the last bit differs
    model.stat.meaninertia = np.cumsum(model.dof_M0)[-1] / model.nv
    model.stat.meanmass = np.cumsum(model.body_mass[1:])[-1] / (model.nbody - 1)


@functools.cache
def nominal_robot(robot: str) -> NominalRobot:
    """Nominal parameter values and element names of a robot, compiled once.

    Raises:
        ValueError: an element of its XML has no name of its own, by which its factor is drawn and given.
    """
    model = compile_nominal(robot)
    values = {parameter.field: getattr(model, parameter.field).copy() for parameter in PARAMETERS}
    for array in values.values():
        array.flags.writeable = False
    geoms = tuple(model.geom(i).name for i in range(model.ngeom))
    bodies = tuple(_body_name(model, i, geoms) for i in range(model.nbody))
    dofs = tuple(_dof_name(model, i) for i in range(model.nv))
    named = {"body": bodies, "geom": geoms, "dof": dofs}
    for element, names in named.items():
        if bad := [name for name in names if not name or names.count(name) > 1]:
            raise ValueError(
                f"{robot} has a {element} whose name is {bad[0]!r}: give each a name of its own in its XML"
            )
    return NominalRobot(values, named)


def _body_name(model: mujoco.MjModel, body: int, geoms: tuple[str, ...]) -> str:
    # Ant's lower legs have no name of their own: they take their geom's, `left_ankle_geom` → `left_ankle`
    return str(model.body(body).name) or geoms[model.body_geomadr[body]].removesuffix("_geom")


def _dof_name(model: mujoco.MjModel, dof: int) -> str:
    joint = model.dof_jntid[dof]
    name = str(model.joint(joint).name)
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return name
    return f"{name}_{('x', 'y', 'z', 'rx', 'ry', 'rz')[dof - model.jnt_dofadr[joint]]}"


def factor_array(robot: str, dynamics: Dynamics, parameter: Parameter) -> NDArray[np.float64]:
    """Factors of one parameter in MuJoCo's element order, (nbody,), (ngeom,) or (nv,) float64.

    Raises:
        ValueError: the dynamics names an element that the robot does not have.
    """
    names = nominal_robot(robot).names[parameter.element]
    factors: Mapping[str, float] = getattr(dynamics, parameter.field)
    unknown = sorted(set(factors) - set(names), key=str)
    if unknown:
        raise ValueError(f"{robot} has no {parameter.element} {unknown[0]!r}: choose from {', '.join(names)}")
    return np.array([factors.get(name, 1.0) for name in names])


def apply_dynamics(robot: str, model: mujoco.MjModel, dynamics: Dynamics) -> None:
    """Write nominal × factor into `model` and recompute what MuJoCo derives from it.

    Starts from the nominal values and never from the model's present ones, so applying twice is applying once. No
    `MjData` of the caller's is touched.

    Raises:
        ValueError: the dynamics names an element that the robot does not have.
    """
    nominal = nominal_robot(robot).values
    for parameter in PARAMETERS:
        value = nominal[parameter.field]
        factors = factor_array(robot, dynamics, parameter)
        getattr(model, parameter.field)[:] = value * factors.reshape(-1, *(1,) * (value.ndim - 1))
    _set_derived(model)
