"""Dynamics in MuJoCo: each parameter changes what it names, what follows from it, and how the robot moves."""

import gymnasium
import mujoco
import numpy as np
import pytest

from dynagen_bench import ids
from dynagen_bench.dynamics import (
    PARAMETERS,
    Dynamics,
    Parameter,
    apply_dynamics,
    compile_nominal,
    factor_array,
    load_dynamics,
    model_path,
    nominal_robot,
)

GYMNASIUM_IDS = {
    "Walker": "Walker2d-v5",
    "Hopper": "Hopper-v5",
    "HalfCheetah": "HalfCheetah-v5",
    "SlimHumanoid": "Humanoid-v5",
    "Ant": "Ant-v5",
}
DERIVED = {
    "body_mass": {
        "body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0", "actuator_acc0", "tendon_invweight0",
        "cam_poscom0", "light_poscom0", "stat.meaninertia", "stat.meanmass",
    },
    "body_inertia": {
        "body_invweight0", "dof_invweight0", "dof_M0", "actuator_acc0", "tendon_invweight0", "stat.meaninertia",
    },
    "dof_damping": set(),
    "geom_friction": set(),
}  # fmt: skip
"""What MuJoCo derives from each parameter (engine_setconst.c); only robots with tendons have `tendon_invweight0`."""


def model_fields(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Every array and statistic of a model, options and visuals included."""
    fields: dict[str, np.ndarray] = {}
    for prefix, part in (("", model), ("stat.", model.stat), ("opt.", model.opt)):
        for name in dir(part):
            value = None if name.startswith("_") else getattr(part, name)
            if isinstance(value, np.ndarray | int | float):
                fields[prefix + name] = np.array(value)
    return fields


def changed_fields(model: mujoco.MjModel, other: mujoco.MjModel) -> set[str]:
    """Names of the fields in which two models differ in any bit."""
    ours, theirs = model_fields(model), model_fields(other)
    assert ours.keys() == theirs.keys()
    return {name for name in ours if not np.array_equal(ours[name], theirs[name])}


def drawn_model(robot: str, dynamics: Dynamics) -> mujoco.MjModel:
    """A fresh model of a robot with these dynamics."""
    model = compile_nominal(robot)
    apply_dynamics(robot, model, dynamics)
    return model


def own_factors(robot: str, parameter: Parameter) -> dict[str, dict[str, float]]:
    """A factor for each element of one parameter alone, whether v0 draws it or not."""
    names = [name for name in nominal_robot(robot).names[parameter.element] if name != "world"]
    exponents = np.random.default_rng(1).uniform(-3, 3, len(names))
    return {parameter.field: dict(zip(names, (parameter.base**exponents).tolist(), strict=True))}


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_nominal_is_gymnasiums_own_model_field_by_field(robot):
    theirs = gymnasium.make(GYMNASIUM_IDS[robot]).unwrapped.model
    theirs.vis.global_.offwidth = compile_nominal(robot).vis.global_.offwidth
    assert changed_fields(compile_nominal(robot), theirs) == set()
    assert changed_fields(drawn_model(robot, Dynamics()), theirs) == set()


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.field)
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_parameter_changes_its_field_and_what_follows_from_it(robot, parameter):
    nominal = compile_nominal(robot)
    changed = changed_fields(drawn_model(robot, Dynamics(**own_factors(robot, parameter))), nominal)
    assert parameter.field in changed
    expected = DERIVED[parameter.field] - (set() if nominal.ntendon else {"tendon_invweight0"})
    assert changed - {parameter.field} == expected


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_applying_twice_is_applying_once_and_nominal_comes_back_bit_for_bit(robot):
    model = drawn_model(robot, load_dynamics(robot, "test", 2))
    once = drawn_model(robot, load_dynamics(robot, "test", 2))
    apply_dynamics(robot, model, load_dynamics(robot, "test", 2))
    assert changed_fields(model, once) == set()
    apply_dynamics(robot, model, Dynamics())
    assert changed_fields(model, compile_nominal(robot)) == set()


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_derived_constants_are_those_of_a_model_compiled_from_the_edited_values(robot):
    ours = drawn_model(robot, load_dynamics(robot, "train", 7))
    spec = mujoco.MjSpec.from_file(str(model_path(robot)))
    spec.compiler.settotalmass = -1
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    for i, body in enumerate(spec.bodies):
        body.explicitinertial = True
        body.mass, body.inertia = ours.body_mass[i], ours.body_inertia[i]
        body.ipos, body.iquat = ours.body_ipos[i], ours.body_iquat[i]
    for i, geom in enumerate(spec.geoms):
        geom.friction = ours.geom_friction[i]
    for i, joint in enumerate(spec.joints):
        joint.damping[0] = ours.dof_damping[ours.jnt_dofadr[i]]
    assert changed_fields(ours, spec.compile()) == set()


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_every_inertia_is_physically_possible(robot):
    for name in ids.dynamics_ids(robot):
        inertia = drawn_model(robot, load_dynamics(robot, name.split, name.index)).body_inertia[1:]
        longest = inertia.max(axis=1)
        assert (inertia > 0).all()
        assert (longest <= inertia.sum(axis=1) - longest + 1e-12).all()


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda parameter: parameter.field)
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_parameter_changes_a_rollout_of_fixed_actions(robot, parameter):
    ends = []
    for dynamics in ({}, own_factors(robot, parameter)):
        env = gymnasium.make(ids.v0_env_id(robot), dynamics=dynamics).unwrapped
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(60):
            env.step(env.action_space.sample())
        ends.append(np.concatenate([env.data.qpos, env.data.qvel]))
    assert np.abs(ends[0] - ends[1]).max() > 1e-6


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_friction_of_a_contact_is_the_larger_of_its_two_geoms(robot):
    seen = []
    for index in range(5):
        model = drawn_model(robot, load_dynamics(robot, "test", index))
        data = mujoco.MjData(model)
        for _ in range(2000):
            mujoco.mj_step(model, data)
            if data.ncon:
                break
        contact = data.contact[0]
        expected = model.geom_friction[contact.geom].max(axis=0)
        np.testing.assert_array_equal(contact.friction[[0, 2, 3]], expected)
        seen.append(contact.friction[0])
    assert len(set(seen)) == 5


def test_unknown_element_names_what_there_is():
    with pytest.raises(ValueError, match="Hopper has no body 'wing': choose from world, torso, thigh, leg, foot"):
        apply_dynamics("Hopper", compile_nominal("Hopper"), Dynamics(body_mass={"wing": 2.0}))


def test_elements_of_two_types_are_unknown_all_the_same():
    with pytest.raises(ValueError, match="Hopper has no body 1: choose from"):
        apply_dynamics("Hopper", compile_nominal("Hopper"), Dynamics.from_json({"body_mass": {"wing": 2.0, 1: 2.0}}))


def test_elements_that_are_not_named_keep_their_value():
    factors = factor_array("Hopper", Dynamics(body_mass={"leg": 2.0}), PARAMETERS[0])
    np.testing.assert_array_equal(factors, [1, 1, 1, 2, 1])


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_element_names_are_unique(robot):
    for names in nominal_robot(robot).names.values():
        assert all(names)
        assert len(set(names)) == len(names)


def test_elements_without_a_name_of_their_own_are_refused(monkeypatch):
    """Else they would be one in every draw: Swimmer's links, for example, have no names."""
    xml = "<mujoco><worldbody><body name='a'><joint name='j'/>{}</body></worldbody></mujoco>"
    for geoms, name in (("<geom size='1'/>", "''"), ("<geom name='g' size='1'/><geom size='1'/>", "''")):
        model = mujoco.MjModel.from_xml_string(xml.format(geoms))
        monkeypatch.setattr("dynagen_bench.dynamics.parameters.compile_nominal", lambda robot, model=model: model)
        with pytest.raises(ValueError, match=f"Hopper has a geom whose name is {name}: give each a name of its own"):
            nominal_robot.__wrapped__("Hopper")
