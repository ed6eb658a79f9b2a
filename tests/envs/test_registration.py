"""Every id of the benchmark makes the environment that it names."""

import math
import os
import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import dynagen_bench  # noqa: F401, registers the environments
from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import HORIZON, ROBOT_CLASSES, register_environments
from dynagen_bench.envs.rules import RANGES

SHORT_IDS = [name.env_id for robot in ids.ROBOTS for name in ids.dynamics_ids(robot)]
ALL_IDS = [*SHORT_IDS, *(ids.v0_env_id(robot) for robot in ids.ROBOTS)]

# Said of Gymnasium's own MuJoCo robots too: their observations have no bounds
USUAL_WARNINGS = ("observation space minimum value is -infinity", "observation space maximum value is infinity")


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_makes_without_a_warning_and_passes_the_checker(env_id):
    with warnings.catch_warnings(record=True) as made:
        warnings.simplefilter("always")
        env = gymnasium.make(env_id)
        env.reset(seed=0)
    assert not made
    with warnings.catch_warnings(record=True) as checked:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    assert not [w for w in checked if not any(usual in str(w.message) for usual in USUAL_WARNINGS)]


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_spec_survives_json_and_the_environment_survives_pickle(env_id):
    env = gymnasium.make(env_id)
    spec = gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())
    copies = [gymnasium.make(spec), pickle.loads(pickle.dumps(env))]  # noqa: S301, our own bytes
    action = env.action_space.high
    first, _ = env.reset(seed=5)
    after = env.step(action)
    for copy in copies:
        np.testing.assert_array_equal(copy.reset(seed=5)[0], first)
        np.testing.assert_array_equal(copy.step(action)[0], after[0])


def test_short_id_and_keywords_give_the_same_environment():
    short, v0 = gymnasium.make("Hopper-RandDyn-test3"), gymnasium.make("Hopper-RandDyn-v0", split="test", index=3)
    own = gymnasium.make("Hopper-RandDyn-v0", dynamics=load_dynamics("Hopper", "test", 3).to_json())
    for env in (v0, own):
        np.testing.assert_array_equal(env.unwrapped.model.body_mass, short.unwrapped.model.body_mass)
        np.testing.assert_array_equal(env.unwrapped.model.geom_friction, short.unwrapped.model.geom_friction)
    assert gymnasium.envs.registration.EnvSpec.from_json(own.spec.to_json()).kwargs == own.spec.kwargs


def test_module_id_needs_no_import():
    code = (
        "import gymnasium, warnings; warnings.simplefilter('error');"
        "print(gymnasium.make('dynagen_bench:Hopper-RandDyn-test3').spec.max_episode_steps)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(HORIZON)
    assert not done.stderr


def test_registering_twice_changes_nothing():
    before = dict(gymnasium.registry)
    register_environments()
    assert gymnasium.registry == before
    assert len(ALL_IDS) == 26 * len(ids.ROBOTS)
    assert set(ALL_IDS) <= set(before)


def test_index_none_draws_from_the_split_at_every_reset_by_the_seed():
    env = gymnasium.make("Hopper-RandDyn-v0", split="test")
    drawn = [env.reset(seed=11)[1]["dynamics_index"]] + [env.reset()[1]["dynamics_index"] for _ in range(40)]
    again = [env.reset(seed=11)[1]["dynamics_index"]] + [env.reset()[1]["dynamics_index"] for _ in range(40)]
    assert drawn == again
    assert set(drawn) == {0, 1, 2, 3, 4}
    expected = gymnasium.make(f"Hopper-RandDyn-test{drawn[-1]}").unwrapped.model.body_mass
    np.testing.assert_array_equal(env.unwrapped.model.body_mass, expected)


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"split": "valid"}, ValueError, "choose one of train, test, nominal"),
        ({"split": "test", "index": 5}, ValueError, "whole number from 0 to 4"),
        ({"split": "test", "dynamics": {}}, ValueError, "either dynamics= or split= and index="),
        ({"dynamics": {"body_mass": {"wing": 1.0}}}, ValueError, "has no body 'wing': choose from"),
        ({"dynamics": Dynamics()}, ValueError, r"give dynamics\.to_json\(\)"),
        ({"gravity": 2.0}, TypeError, "no keyword 'gravity': choose from split, index, dynamics"),
        ({"xml_file": "x.xml"}, TypeError, "no keyword 'xml_file'"),
    ],
)
def test_bad_keywords_end_in_one_line(keywords, error, message):
    with pytest.raises(error, match=message):
        gymnasium.make("Hopper-RandDyn-v0", **keywords)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"terminate_when_unhealthy": "False"}, "terminate_when_unhealthy is 'False': give True or False"),
        (
            {"healthy_z_range": (2, 1)},
            r"healthy_z_range is \(2, 1\): give two numbers, the lower one first",
        ),
        ({"healthy_z_range": 5}, "healthy_z_range is 5: give two numbers"),
        ({"healthy_angle_range": (float("nan"), 1.0)}, r"healthy_angle_range is \(nan, 1\.0\): give two"),
        ({"healthy_reward": float("nan")}, "healthy_reward is nan: give a finite number"),
        ({"ctrl_cost_weight": "0"}, "ctrl_cost_weight is '0': give a finite number"),
        ({"reset_noise_scale": -1}, "reset_noise_scale is -1: give a finite number from 0 on"),
        ({"velocity_limit": 0.0}, r"velocity_limit is 0\.0: give a number above 0, inf for no limit"),
    ],
)
def test_the_value_of_a_keyword_is_what_it_has_to_be(keywords, message):
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(ValueError, match=message):
            make("Hopper-RandDyn-v0", **keywords)


def test_keywords_may_come_out_of_json_and_numpy():
    env = gymnasium.make(
        "Hopper-RandDyn-v0", healthy_z_range=[0.5, float("inf")], healthy_reward=np.float32(2), index=0
    )
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    for one in (env, again):
        one.reset(seed=0)
        assert one.step(np.zeros(3))[4]["reward_survive"] == 2.0


@pytest.mark.parametrize(
    ("robot", "keyword", "value"),
    [
        ("HalfCheetah", "healthy_z_range", (0.2, 1.0)),
        ("HalfCheetah", "healthy_state_range", (-1.0, 1.0)),
        ("HalfCheetah", "healthy_angle_range", (-0.1, 0.1)),
        ("Ant", "healthy_state_range", (-1.0, 1.0)),
        ("Ant", "healthy_angle_range", (-0.1, 0.1)),
        ("SlimHumanoid", "healthy_state_range", (-1.0, 1.0)),
        ("SlimHumanoid", "healthy_angle_range", (-0.1, 0.1)),
        *((robot, "hidden_positions", 0) for robot in ids.ROBOTS),
    ],
)
def test_a_keyword_that_would_not_act_is_refused(robot, keyword, value):
    with pytest.raises(TypeError, match=f"{robot} has no keyword '{keyword}': choose from split") as caught:
        ROBOT_CLASSES[robot](**{keyword: value})
    assert keyword not in str(caught.value).partition("choose from")[2]


@pytest.mark.parametrize(
    ("robot", "keyword"),
    [
        *(("Hopper", keyword) for keyword in RANGES),
        *(("Walker", keyword) for keyword in RANGES),
        ("Ant", "healthy_z_range"),
        ("SlimHumanoid", "healthy_z_range"),
    ],
)
def test_a_range_that_is_taken_decides_what_is_healthy(robot, keyword):
    survived = []
    for limits in ((-math.inf, math.inf), (1e6, 2e6)):
        env = gymnasium.make(f"{robot}-RandDyn-test0", **{keyword: limits})
        env.reset(seed=0)
        survived.append(env.step(np.zeros(env.action_space.shape))[4]["reward_survive"] > 0)
    assert survived == [True, False]


def test_a_wrong_id_suggests_the_near_ones():
    with pytest.raises(gymnasium.error.NameNotFound, match="Hopper-RandDyn-test"):
        gymnasium.make("Hopper-RandDyn-test9")


def test_keywords_of_gymnasiums_robot_still_work():
    env = gymnasium.make("Hopper-RandDyn-test3", ctrl_cost_weight=0.5, terminate_when_unhealthy=False)
    env.reset(seed=0)
    for _ in range(199):
        _, _, terminated, truncated, info = env.step(env.action_space.high)
        assert not terminated
        assert not truncated
    assert info["reward_ctrl"] == pytest.approx(-0.5 * 3)
    assert env.step(env.action_space.high)[3]


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize(
    ("given", "word"), [({"index": 1}, "index 3, got 1"), ({"split": "train"}, "split 'test', got")]
)
def test_the_id_of_a_body_is_of_no_other_one(make, given, word):
    with pytest.raises(ValueError, match=f"Hopper-RandDyn-test3 has {word}.*: leave it out, or make an id with -v0"):
        make("Hopper-RandDyn-test3", **given)
    make("Hopper-RandDyn-test3", split="test", index=3).close()
    make("Hopper-RandDyn-v0", **given).close()


def test_without_gl_it_is_said_how_to_choose_one():
    code = "import gymnasium, dynagen_bench\nenv = gymnasium.make('Hopper-RandDyn-test3', render_mode='rgb_array')\n"
    code += "env.reset(seed=0)\ntry:\n    env.render()\nexcept RuntimeError as error:\n    print(error)\n"
    hidden = {name: text for name, text in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=hidden | {"MUJOCO_GL": "glfw"}, capture_output=True, text=True, check=False
    )
    assert "where there is no display, set MUJOCO_GL to egl or osmesa before Python starts" in done.stdout
