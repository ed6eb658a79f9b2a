"""The draws of v0: pinned, drawn again from their seed, inside their ranges."""

import hashlib
import importlib.resources
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynagen_bench import ids
from dynagen_bench.dynamics import PARAMETERS, Dynamics, draw_dynamics, draws_json, load_dynamics, nominal_robot
from dynagen_bench.dynamics.draws import DRAWN

PINNED = {
    "Walker": "d28553b35eb1e5df40e26cdd83ceee83b6d3234804642c8ebfc9c3b15024d7b5",
    "Hopper": "b88354ad5b5ac91d0e2ad9946d2078246a532a19174c9ae879d9831f4fe98a66",
    "HalfCheetah": "8333e2a7d29a3c66d82ad23b6f0f360e005c75b3305ff1885e57f4b388946cda",
    "SlimHumanoid": "a56648d77559c6b42f78b99a37cc2dd99b410045355944d350c3fea79d3f8fd5",
    "Ant": "8254c2eecd5978c93bd3c1295ea16f95fb52bd803f206bf4817c02db46238c13",
}


def _file(robot: str) -> bytes:
    return (importlib.resources.files("dynagen_bench.dynamics") / "data" / f"{robot}.json").read_bytes()


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_file_is_the_reviewed_one(robot):
    assert hashlib.sha256(_file(robot)).hexdigest() == PINNED[robot]


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_seed_draws_the_file_again(robot):
    assert draws_json(robot).encode() == _file(robot)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_25_different_dynamics_inside_the_stated_range(robot):
    dynamics = [load_dynamics(robot, name.split, name.index) for name in ids.dynamics_ids(robot)]
    assert len({json.dumps(d.to_json()) for d in dynamics}) == 25
    for parameter in DRAWN:
        names = set(nominal_robot(robot).names[parameter.element]) - {"world"}
        factors = np.array([list(getattr(d, parameter.field).values()) for d in dynamics])
        assert all(set(getattr(d, parameter.field)) == names for d in dynamics)
        assert factors.shape == (25, len(names))
        limit = parameter.base**3
        assert (factors >= 1 / limit - 1e-6).all()
        assert (factors <= limit + 1e-6).all()
        # 25 draws an element or more: they fill the range and do not lean to one side
        exponents = np.log(factors) / np.log(parameter.base)
        assert exponents.min() < -2.5
        assert exponents.max() > 2.5
        assert abs(exponents.mean()) < 4 * 3 / np.sqrt(3 * exponents.size)


def test_every_element_has_a_draw_of_its_own():
    factors = load_dynamics("Ant", "train", 0).to_json()
    values = [f for kind in factors.values() for f in kind.values()]
    assert len(set(values)) == len(values)


def test_nominal_has_no_factors():
    assert load_dynamics("Ant", "nominal", 0) == Dynamics()


def test_a_users_draw_depends_on_the_seed_alone():
    first, again, other = (draw_dynamics("Walker", np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


factor = st.floats(min_value=1e-3, max_value=1e3)


@given(
    st.dictionaries(
        st.sampled_from([parameter.field for parameter in PARAMETERS]), st.dictionaries(st.text(), factor), max_size=4
    )
)
def test_plain_form_round_trips(data):
    dynamics = Dynamics.from_json(data)
    assert Dynamics.from_json(json.loads(json.dumps(dynamics.to_json()))) == dynamics


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"gravity": {"torso": 2.0}}, "unknown dynamics parameter .*gravity.*choose from body_mass"),
        ({"body_mass": 2.0}, "body_mass must map element names to factors"),
        ({"body_mass": {"torso": -1.0}}, "finite factor above 0"),
        ({"body_mass": {"torso": float("nan")}}, "finite factor above 0"),
        ({"body_mass": {"torso": True}}, "finite factor above 0"),
        ({"body_mass": {"torso": float("inf")}}, "finite factor above 0"),
        ({"body_mass": {"torso": 10**400}}, "finite factor above 0"),
        ({1: {}, "a": {}}, r"unknown dynamics parameter \[1, 'a'\]: choose from"),
        (Dynamics(), r"dynamics are plain data, .*: give dynamics\.to_json\(\)"),
        ([1, 2], "unknown dynamics parameter"),
    ],
)
def test_bad_plain_form_is_refused(data, message):
    with pytest.raises(ValueError, match=message):
        Dynamics.from_json(data)
