"""One environment: Gymnasium's robot where nothing is drawn, and one function of the state everywhere."""

import copy
import pickle

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco.ant_v5 import AntEnv
from gymnasium.envs.registration import EnvSpec

import dynagen_bench  # noqa: F401, registers the environments
from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import ROBOT_CLASSES
from tests.dynamics.test_parameters import GYMNASIUM_IDS

OBSERVATION_SIZES = {"Walker": 17, "Hopper": 11, "HalfCheetah": 17, "SlimHumanoid": 45, "Ant": 27}
STEPS = 30


def make(robot: str, **keywords):
    """A robot without its time limit."""
    return gymnasium.make(ids.v0_env_id(robot), **keywords).unwrapped


def state(env) -> np.ndarray:
    """All of qpos and qvel of an environment."""
    return np.concatenate([env.data.qpos, env.data.qvel])


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_nominal_moves_as_gymnasiums_robot_does(robot):
    ours, theirs = make(robot, split="nominal"), gymnasium.make(GYMNASIUM_IDS[robot]).unwrapped
    for seed in range(5):
        ours.reset(seed=seed)
        theirs.reset(seed=seed)
        np.testing.assert_array_equal(state(ours), state(theirs))
        ours.action_space.seed(seed)
        for _ in range(STEPS):
            # the warm start is all that differs: from the same state, the same step to the solver's tolerance
            theirs.set_state(ours.data.qpos, ours.data.qvel)
            action = ours.action_space.sample()
            _, reward, terminated, _, info = ours.step(action)
            _, their_reward, their_end, _, their_info = theirs.step(action)
            np.testing.assert_allclose(state(ours), state(theirs), rtol=1e-6, atol=1e-6)
            if robot not in ("SlimHumanoid", "Ant"):  # theirs have other rewards; what is healthy is compared below
                assert reward == pytest.approx(their_reward, abs=1e-6)
                assert terminated == their_end
            assert set(their_info) <= set(info)
            if terminated:
                break


@pytest.mark.parametrize("robot", [robot for robot in ids.ROBOTS if robot != "HalfCheetah"])  # which is always healthy
def test_healthy_is_what_gymnasiums_robot_calls_healthy(robot):
    ours, theirs = make(robot, split="nominal"), gymnasium.make(GYMNASIUM_IDS[robot]).unwrapped
    rng, sides = np.random.default_rng(0), set()
    low, high = ours.rules.healthy_z_range
    for _ in range(2000):
        qpos, qvel = ours.init_qpos.copy(), ours.init_qvel.copy()
        qpos[:3] += rng.uniform(-1.5, 1.5, 3)  # height, and pitch of a planar robot, on both sides of their ranges
        qvel[rng.integers(len(qvel))] = rng.uniform(-200, 200)
        for env in (ours, theirs):
            env.set_state(qpos, qvel)
        assert ours.is_healthy == theirs.is_healthy
        height = qpos[ours.rules.hidden_positions]
        sides.add((int(height > high) - int(height < low), ours.is_healthy))
    assert sides >= {(-1, False), (0, True)} | ({(1, False)} if high < np.inf else set())


def test_ants_reward_is_gymnasiums_at_the_new_state():
    env = make("Ant", split="nominal")
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(STEPS):
        x, action = env.data.qpos[0], env.action_space.sample()
        _, reward, *_ = env.step(action)
        mujoco.mj_forward(env.model, env.data)
        mujoco.mj_rnePostConstraint(env.model, env.data)
        # Gymnasium's own property, read after the forward pass at the new state
        contact_cost = AntEnv.contact_cost.fget(env)
        assert reward == pytest.approx(
            (env.data.qpos[0] - x) / 0.05 + 1 - 0.5 * (action**2).sum() - contact_cost, abs=1e-6
        )
    assert contact_cost > 0


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_gymnasiums_properties_are_the_terms_of_our_reward(robot):
    changed = {"ctrl_cost_weight": 9.0, "contact_cost_weight": 3e-4, "healthy_reward": 2.5}
    if robot != "HalfCheetah":
        changed["healthy_z_range"] = (5.0, 9.0)  # nobody stands so high
    for keywords, upright in (({"healthy_reward": 2.5}, True), (changed, robot == "HalfCheetah")):
        env = make(robot, split="nominal", **keywords)
        env.reset(seed=0)
        assert env.is_healthy == upright
        action = 2 * env.action_space.high  # beyond what the actuators take
        info = env.step(action)[4]
        assert env.healthy_reward == info["reward_survive"]
        assert env.control_cost(action) == -info["reward_ctrl"] > 0
        assert env.contact_cost == -info["reward_contact"]


def test_the_factors_of_the_present_body_can_be_asked_for():
    env = make("Hopper", split="test")
    assert env.dynamics == Dynamics()
    for seed in range(3):
        index = env.reset(seed=seed)[1]["dynamics_index"]
        assert env.dynamics == load_dynamics("Hopper", "test", index)
    own = {"body_mass": {"torso": 1.5}}
    assert make("Hopper", dynamics=own).dynamics == Dynamics.from_json(own)
    assert make("Hopper", split="nominal").dynamics == Dynamics()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301, our bytes
def test_a_copy_has_the_body_that_was_drawn(copied):
    env = make("Hopper", split="train")
    assert copied(env).dynamics_index == -1
    env.reset(seed=0)
    other = copied(env)
    assert other.dynamics_index == env.dynamics_index
    for one in (env, other):
        one.set_state(env.init_qpos, env.init_qvel)
    action = np.ones(3)
    np.testing.assert_array_equal(other.step(action)[0], env.step(action)[0])


def test_the_specification_is_text_whatever_was_given():
    for chosen in ({"split": "test", "index": np.int64(3)}, {"healthy_z_range": (np.float32(0.5), np.inf)}):
        env = gymnasium.make("Hopper-RandDyn-v0", **chosen)
        again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        assert again.spec == env.spec
        assert again.unwrapped.dynamics == env.unwrapped.dynamics
    assert type(env.unwrapped).spec is None  # as Gymnasium's
    assert type(env.unwrapped)().spec is None


def test_slim_humanoids_reward_is_the_papers():
    env = make("SlimHumanoid", split="test", index=0)
    env.reset(seed=0)
    env.action_space.seed(0)
    seen = set()
    for _ in range(150):
        x, action = env.data.qpos[0], env.action_space.sample()
        _, reward, terminated, *_ = env.step(action)
        height = env.data.qpos[2]
        upright = 1.0 <= height <= 2.0
        expected = 1.25 * (env.data.qpos[0] - x) / 0.015 - 0.1 * (action.astype(float) ** 2).sum() + 5.0 * upright
        assert reward == pytest.approx(expected, abs=1e-9)
        assert not terminated
        seen.add(upright)
    assert seen == {True, False}


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_observation_is_the_state_without_the_place_and_nothing_of_the_draw(robot):
    firsts = []
    for index in range(5):
        env = make(robot, split="test", index=index)
        observation, _ = env.reset(seed=3)
        firsts.append(observation)
        for _ in range(5):
            observation = env.step(env.action_space.high)[0]
            hidden = 2 if robot in ("SlimHumanoid", "Ant") else 1
            limit = 10 if robot in ("Hopper", "Walker") else np.inf
            velocity = np.clip(env.data.qvel, -limit, limit)
            np.testing.assert_array_equal(observation, np.concatenate([env.data.qpos[hidden:], velocity]))
        assert observation.shape == env.observation_space.shape == (OBSERVATION_SIZES[robot],)
    # the same seed, five bodies: before anything has moved, nothing tells them apart
    assert all(np.array_equal(first, firsts[0]) for first in firsts)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_a_step_depends_on_state_and_action_alone(robot):
    env = make(robot, split="train", index=4)
    env.reset(seed=0)
    env.action_space.seed(0)
    visited = []
    for _ in range(STEPS):
        before, action = (env.data.qpos.copy(), env.data.qvel.copy()), env.action_space.sample()
        result = env.step(action)
        visited.append((before, action, result, state(env)))
    other = make(robot, split="train", index=4)
    other.reset(seed=9)
    for i in np.random.default_rng(0).permutation(STEPS):
        before, action, result, after = visited[i]
        other.set_state(*before)
        observation, reward, terminated, *_ = other.step(action)
        np.testing.assert_array_equal(observation, result[0])
        np.testing.assert_array_equal(state(other), after)
        assert (reward, terminated) == (result[1], result[2])


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_actions_outside_their_range_are_clipped(robot):
    env = make(robot, split="test", index=1)
    results = []
    for scale in (1.0, 7.0):
        env.reset(seed=0)
        results.append(env.step(scale * env.action_space.high))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    assert results[0][1] == results[1][1]


@pytest.mark.parametrize(
    ("action", "message"),
    [(np.zeros(4), r"shape \(4,\): Hopper takes \(3,\)"), (np.array([0, np.nan, 0]), "not finite"),
     (np.array([0, 0, np.inf]), "not finite")],
)  # fmt: skip
def test_bad_actions_never_reach_the_physics(action, message):
    env = make("Hopper", split="test", index=0)
    env.reset(seed=0)
    before = state(env)
    with pytest.raises(ValueError, match=message):
        env.step(action)
    np.testing.assert_array_equal(state(env), before)


def test_an_unstable_step_is_reported_and_never_a_silent_reset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where the process stands
    env = make("Hopper", split="test", index=0)
    env.reset(seed=0)
    qvel = env.data.qvel.copy()
    qvel[3] = 1e12
    env.set_state(env.data.qpos.copy(), qvel)
    before = state(env)
    _, reward, terminated, _, info = env.step(np.zeros(3))
    assert terminated
    assert info["unstable"]
    assert reward == 0.0
    np.testing.assert_array_equal(state(env), before)


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_info_keeps_gymnasiums_meaning(robot):
    env = make(robot, split="test", index=2)
    env.reset(seed=0)
    x = env.data.qpos[0]
    _, reward, *_, info = env.step(env.action_space.high)
    assert info["x_position"] == env.data.qpos[0]
    assert info["x_velocity"] == (env.data.qpos[0] - x) / env.dt
    terms = [info[f"reward_{term}"] for term in ("forward", "survive", "ctrl", "contact")]
    assert reward == pytest.approx(sum(terms))


@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_documented_tables_have_a_row_for_every_number(robot):
    text = ROBOT_CLASSES[robot].__doc__
    env = make(robot, split="nominal")
    sizes = [env.action_space.shape[0], env.observation_space.shape[0]]
    tables = text.split("| index |")[1:]
    for table, size in zip(tables, sizes, strict=True):
        covered = []
        for row in table.splitlines()[2:]:
            if not row.strip().startswith("|"):
                break
            cell = row.split("|")[1].strip()
            first, last = cell.split(" to ") if " to " in cell else (None, None)
            covered += range(int(first), int(last) + 1) if first else [int(n) for n in cell.split(",")]
        assert covered == list(range(size))


def test_a_users_dynamics_are_applied():
    heavy = make("Hopper", dynamics={"body_mass": {"torso": 2.0}})
    nominal = make("Hopper", split="nominal")
    np.testing.assert_allclose(heavy.model.body_mass / np.maximum(nominal.model.body_mass, 1e-9), [0, 2, 1, 1, 1])
    assert load_dynamics("Hopper", "nominal", 0).to_json()["body_mass"] == {}
