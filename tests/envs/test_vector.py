"""The vectorised environment: Gymnasium's own SyncVectorEnv of our single environment, bit for bit, but faster."""

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

import dynagen_bench  # noqa: F401, registers
from dynagen_bench import ids
from dynagen_bench.dynamics import Dynamics, load_dynamics
from dynagen_bench.envs import HORIZON
from dynagen_bench.envs.vector import RandomDynamicsVector

MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


def sync_of(robot: str, kwargs: list[dict], mode: AutoresetMode) -> SyncVectorEnv:
    """Gymnasium's vector of single environments, each with the keywords given."""
    makers = [lambda k=k: gymnasium.make(f"{robot}-RandDyn-v0", max_episode_steps=25, **k) for k in kwargs]
    return SyncVectorEnv(makers, autoreset_mode=mode)


def assert_same_infos(ours: dict, theirs: dict) -> None:
    """Same keys, masks, types and values, also one level below."""
    assert set(ours) == set(theirs)
    for key, value in theirs.items():
        if isinstance(value, dict):
            assert_same_infos(ours[key], value)
        elif value.dtype == object:
            for mine, its in zip(ours[key], value, strict=True):
                assert (mine is None) == (its is None)
                if its is not None:
                    np.testing.assert_array_equal(mine, its)
        else:
            assert ours[key].dtype == value.dtype, key
            np.testing.assert_array_equal(ours[key], value, err_msg=key)


def assert_same_run(ours: gymnasium.vector.VectorEnv, theirs: SyncVectorEnv, seed, steps: int = 60) -> None:
    """Both give the same from the same seeds and actions, over several episodes."""
    rng = np.random.default_rng(3)
    (a, infos), (b, their_infos) = ours.reset(seed=seed), theirs.reset(seed=seed)
    np.testing.assert_array_equal(a, b)
    assert_same_infos(infos, their_infos)
    high = ours.single_action_space.high
    ends = 0
    for _ in range(steps):
        actions = rng.uniform(-1.2 * high, 1.2 * high, ours.action_space.shape).astype(np.float32)
        *arrays, infos = ours.step(actions)
        *their_arrays, their_infos = theirs.step(actions)
        for mine, its in zip(arrays, their_arrays, strict=True):
            assert mine.dtype == its.dtype
            np.testing.assert_array_equal(mine, its)
        assert_same_infos(infos, their_infos)
        ends += int((arrays[2] | arrays[3]).sum())
    assert ends >= ours.num_envs


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_bits_of_gymnasiums_sync_vector_env(robot, mode):
    ours = gymnasium.make_vec(
        f"{robot}-RandDyn-v0", num_envs=7, split="test", max_episode_steps=25, autoreset_mode=mode.value, threads=2
    )
    theirs = sync_of(robot, [{"split": "test", "index": i % 5} for i in range(7)], mode)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] is mode
    assert_same_run(ours, theirs, seed=11)
    ours.close()
    theirs.close()


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
@pytest.mark.parametrize("robot", ["Hopper", "Ant"])
def test_index_none_draws_as_the_single_environment_does(robot, mode):
    ours = gymnasium.make_vec(
        f"{robot}-RandDyn-v0", num_envs=4, index=None, max_episode_steps=25, autoreset_mode=mode, threads=1
    )
    assert_same_run(ours, sync_of(robot, [{}] * 4, mode), seed=[5, 6, 7, 5])
    assert len(set(ours.unwrapped.dynamics_indices.tolist())) > 1


@pytest.mark.parametrize(("num_envs", "threads"), [(1, 1), (1, 0), (3, 3), (11, 2)])
def test_any_number_of_environments_and_threads(num_envs, threads):
    ours = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=num_envs, max_episode_steps=25, threads=threads)
    kwargs = [{"split": "train", "index": i} for i in range(num_envs)]
    assert_same_run(ours, sync_of("Hopper", kwargs, AutoresetMode.NEXT_STEP), seed=0)


def test_disabled_autoreset_waits_for_the_users_reset():
    mode = AutoresetMode.DISABLED
    ours = gymnasium.make_vec(
        "Hopper-RandDyn-v0", num_envs=3, split="test", max_episode_steps=4, autoreset_mode="Disabled"
    )
    theirs = SyncVectorEnv(
        [lambda i=i: gymnasium.make(f"Hopper-RandDyn-test{i}", max_episode_steps=4) for i in range(3)],
        autoreset_mode=mode,
    )
    for env in (ours, theirs):
        env.reset(seed=1)
        for _ in range(4):
            *_, truncations, _ = env.step(np.zeros((3, 3), dtype=np.float32))
        assert truncations.all()
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"sub-environments \[0, 1, 2\] have ended"):
        ours.step(np.zeros((3, 3), dtype=np.float32))
    mask = np.array([True, False, True])
    (a, infos), (b, their_infos) = (env.reset(options={"reset_mask": mask}) for env in (ours, theirs))
    np.testing.assert_array_equal(a, b)
    assert_same_infos(infos, their_infos)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[1\] have ended"):
        ours.step(np.zeros((3, 3), dtype=np.float32))


@pytest.mark.parametrize("mode", [None, "sync"])
@pytest.mark.parametrize(
    ("given", "limit"), [({}, 200), ({"max_episode_steps": None}, 200), ({"max_episode_steps": 9}, 9)]
)
def test_the_time_limit_is_that_of_gymnasium_make(given, limit, mode):
    env = gymnasium.make_vec("HalfCheetah-RandDyn-v0", num_envs=2, split="test", vectorization_mode=mode, **given)
    env.reset(seed=0)
    steps = 0
    while not env.step(np.zeros((2, 6)))[3].all():
        steps += 1
    assert steps + 1 == limit


def test_minus_one_is_no_time_limit_as_in_gymnasium_make():
    env = gymnasium.make_vec("HalfCheetah-RandDyn-v0", num_envs=1, max_episode_steps=-1)
    env.reset(seed=0)
    assert not any(env.step(np.zeros((1, 6)))[3].any() for _ in range(HORIZON + 5))


def test_the_factors_of_the_present_bodies_can_be_asked_for():
    env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=3, split="train", index=None)
    env.reset(seed=0)
    drawn = [load_dynamics("Hopper", "train", int(i)) for i in env.unwrapped.dynamics_indices]
    assert env.unwrapped.dynamics == drawn
    spread = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=6, split="test").unwrapped.dynamics
    assert spread == [load_dynamics("Hopper", "test", i % 5) for i in range(6)]


def test_which_dynamics_run_where():
    def indices(**kwargs) -> list[int]:
        return gymnasium.make_vec("Hopper-RandDyn-v0", **kwargs).unwrapped.dynamics_indices.tolist()

    assert indices(num_envs=7, split="test") == [0, 1, 2, 3, 4, 0, 1]
    assert indices(num_envs=3) == [0, 1, 2]
    assert indices(num_envs=3, split="test", index=4) == [4, 4, 4]
    assert indices(num_envs=5, split="test", indices=[3, 1]) == [3, 1, 3, 1, 3]
    assert indices(num_envs=2, split="nominal") == [0, 0]
    assert indices(num_envs=2, dynamics={"body_mass": {"torso": 2.0}}) == [-1, -1]
    short = gymnasium.make_vec("Hopper-RandDyn-test3", num_envs=2)
    assert short.unwrapped.dynamics_indices.tolist() == [3, 3]


def test_numpys_whole_numbers_are_taken_as_plain_ones_are():
    env_id, two = "Hopper-RandDyn-v0", np.int64(2)
    plain = gymnasium.make_vec(env_id, num_envs=2, split="test", indices=[0, 1])
    for chosen in ({"indices": np.arange(2)}, {"index": "spread"}):
        env = gymnasium.make_vec(env_id, num_envs=two, split="test", **chosen)
        for seed, its in ((np.int64(3), 3), (np.array([7, 5]), [7, 5]), ([np.int32(4), None], [4, None])):
            np.testing.assert_array_equal(env.reset(seed=seed)[0], plain.reset(seed=its)[0])
        assert type(env.num_envs) is int
        assert env.unwrapped.dynamics_indices.tolist() == [0, 1]
    gymnasium.make_vec(env_id, num_envs=1, max_episode_steps=np.int64(5), threads=np.uint8(1)).close()
    assert gymnasium.make_vec(env_id, num_envs=1, index=np.int64(3)).unwrapped.dynamics_indices == [3]
    single = gymnasium.make(env_id, split="test", index=np.int64(3)).unwrapped
    assert type(single.reset(seed=0)[1]["dynamics_index"]) is int


def test_own_dynamics_one_a_sub_environment():
    own = [{"body_mass": {"torso": 2.0}}, {"body_mass": {"torso": 0.5}}]
    ours = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2, dynamics=own, max_episode_steps=25)
    theirs = sync_of("Hopper", [{"dynamics": factors} for factors in own], AutoresetMode.NEXT_STEP)
    assert_same_run(ours, theirs, seed=0)


def test_rules_given_as_keywords_reach_every_sub_environment():
    kwargs = {"healthy_reward": 3.0, "exclude_current_positions_from_observation": False}
    ours = gymnasium.make_vec("Ant-RandDyn-test0", num_envs=2, max_episode_steps=25, **kwargs)
    theirs = sync_of("Ant", [{"split": "test", "index": 0, **kwargs}] * 2, AutoresetMode.NEXT_STEP)
    assert_same_run(ours, theirs, seed=0, steps=30)


def test_contact_that_is_rewarded_is_asked_for_too():
    ours = gymnasium.make_vec("Ant-RandDyn-test0", num_envs=2, max_episode_steps=25, contact_cost_weight=-1e-3)
    kwargs = {"split": "test", "index": 0, "contact_cost_weight": -1e-3}
    theirs = sync_of("Ant", [kwargs] * 2, AutoresetMode.NEXT_STEP)
    assert_same_run(ours, theirs, seed=0, steps=30)
    ours.reset(seed=0)
    contact = [ours.step(np.zeros(ours.action_space.shape))[4]["reward_contact"] for _ in range(20)]
    assert np.max(contact) > 0


def test_an_unstable_sub_environment_is_reported_and_touches_no_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where the process stands
    calm, shaken = (gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=3, split="test") for _ in range(2))
    for env in (calm, shaken):
        env.reset(seed=0)
    shaken.unwrapped.physics.qvel[1, 3] = 1e12
    actions = np.full((3, 3), 0.3, dtype=np.float32)
    good, bad = calm.step(actions), shaken.step(actions)
    assert "unstable" not in good[4]
    assert bad[4]["unstable"].tolist() == bad[4]["_unstable"].tolist() == bad[2].tolist() == [False, True, False]
    assert bad[1][1] == 0.0
    for mine, its in zip(good[:4], bad[:4], strict=True):
        np.testing.assert_array_equal(np.delete(mine, 1, axis=0), np.delete(its, 1, axis=0))
    observations, rewards, terminations, _, infos = shaken.step(actions)  # autoreset: a new episode, of that one alone
    assert not terminations.any()
    assert rewards[1] == 0.0
    assert np.abs(observations[1, 5:]).max() < 0.01
    assert infos["_dynamics_index"].tolist() == [False, True, False]


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
@pytest.mark.parametrize("speed", [9e9, 1e12])  # too fast after a substep, and before
@pytest.mark.parametrize("robot", ids.ROBOTS)
def test_an_unstable_step_is_that_of_the_single_environment(robot, speed, mode, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where the process stands
    ours = gymnasium.make_vec(f"{robot}-RandDyn-v0", num_envs=3, split="test", autoreset_mode=mode)
    theirs = sync_of(robot, [{"split": "test", "index": i} for i in range(3)], mode)
    for env in (ours, theirs):
        env.reset(seed=0)
    shaken = theirs.envs[1].unwrapped
    qvel = shaken.data.qvel.copy()
    qvel[3] = speed
    shaken.set_state(shaken.data.qpos.copy(), qvel)
    ours.unwrapped.physics.qvel[1, 3] = speed
    for step in range(3):
        actions = np.full(ours.action_space.shape, 0.1 * step, dtype=np.float32)
        *arrays, infos = ours.step(actions)
        *their_arrays, their_infos = theirs.step(actions)
        for mine, its in zip(arrays, their_arrays, strict=True):
            np.testing.assert_array_equal(mine, its)
        assert_same_infos(infos, their_infos)
        assert arrays[2].any() == (step == 0)


@pytest.mark.parametrize(
    ("kwargs", "error", "message"),
    [
        ({"split": "dev"}, ValueError, "unknown split 'dev': choose one of"),
        ({"num_envs": True}, ValueError, "num_envs is True: give a whole number from 1 on"),
        ({"num_envs": 2.0}, ValueError, "num_envs is 2.0: give a whole number from 1 on"),
        ({"num_envs": 0}, ValueError, "num_envs is 0: give a whole number from 1 on"),
        ({"split": "test", "index": 5}, ValueError, "index 5 is not in split 'test'"),
        ({"split": "test", "indices": [0, 9]}, ValueError, "index 9 is not in split 'test'"),
        ({"indices": []}, ValueError, "0 indices given for 2 sub-environments: give 1 to 2"),
        ({"indices": [0, 1, 2]}, ValueError, "3 indices given for 2 sub-environments"),
        ({"indices": [0], "index": 1}, ValueError, "either index= or indices="),
        ({"index": "all"}, ValueError, "index is 'all': give a number, None, or 'spread'"),
        ({"dynamics": {}, "split": "test"}, ValueError, "give either dynamics= or split="),
        ({"dynamics": {"body_mass": {"wing": 2.0}}}, ValueError, "wing"),
        ({"dynamics": Dynamics()}, ValueError, r"give dynamics\.to_json\(\)"),
        ({"dynamics": [Dynamics(), {}]}, ValueError, r"give dynamics\.to_json\(\)"),
        ({"dynamics": 3}, ValueError, "unknown dynamics parameter 3: choose from body_mass"),
        ({"dynamics": "heavy"}, ValueError, "unknown dynamics parameter 'heavy': choose from body_mass"),
        (
            {"autoreset_mode": "nextstep"},
            ValueError,
            "autoreset_mode is 'nextstep': choose from NextStep, SameStep, Disabled",
        ),
        ({"indices": 3}, ValueError, r"indices is 3: give a list of whole numbers, as \[0, 3\]"),
        (
            {"max_episode_steps": 0},
            ValueError,
            "max_episode_steps is 0: give a whole number from 1 on, -1 for no limit",
        ),
        *[
            ({"max_episode_steps": given}, ValueError, rf"^max_episode_steps is {given!r}: give a whole number from 1")
            for given in (2.5, True, "5", -2)
        ],
        *[
            ({"threads": given}, ValueError, rf"^threads is {given!r}: give a whole number from 0 on$")
            for given in (-5, 1.5, "2", True, None)
        ],
        ({"render_mode": "human"}, ValueError, "render_mode is 'human': choose from rgb_array"),
        ({"gravity": 3}, TypeError, "Hopper has no keyword 'gravity'"),
    ],
)
def test_a_mistake_ends_in_one_line(kwargs, error, message):
    with pytest.raises(error, match=message) as caught:
        gymnasium.make_vec("Hopper-RandDyn-v0", **{"num_envs": 2, **kwargs})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 4)), r"actions have shape \(2, 4\): give \(2, 3\)"),
        (np.zeros(3), r"actions have shape \(3,\)"),
        (np.array([[0, 0, 0], [0, np.nan, 0]]), "action 1 is not finite"),
        (np.array([[np.inf, 0, 0], [0, 0, 0]]), "action 0 is not finite"),
    ],
)
def test_bad_actions_never_reach_the_physics(actions, message):
    env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2)
    env.reset(seed=0)
    before = env.unwrapped.physics.states.copy()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    np.testing.assert_array_equal(env.unwrapped.physics.states, before)
    env.step(np.zeros((2, 3)))  # and the episode goes on


def test_an_unknown_robot_is_named_whatever_its_dynamics():
    for chosen in ({}, {"dynamics": {}}):
        with pytest.raises(ValueError, match=r"unknown robot 'hopper'.*did you mean 'Hopper'"):
            RandomDynamicsVector("hopper", 2, **chosen)


def test_a_bad_seed_resets_nothing():
    env, same = (gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2) for _ in range(2))
    for one in (env, same):
        one.reset(seed=3)
    with pytest.raises(gymnasium.error.Error, match="Seed must be greater or equal to zero, actual value: -1"):
        env.reset(seed=[5, -1])
    np.testing.assert_array_equal(env.reset()[0], same.reset()[0])  # the generators go on


def test_order_and_arguments_of_reset_are_checked():
    env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset\(\) before step"):
        env.step(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="first reset starts every"):
        env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="3 seeds given: give 2"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match=r"seed is 1\.5: give a whole number, a list of 2, or None"):
        env.reset(seed=1.5)
    with pytest.raises(ValueError, match=r"reset_mask has shape \(3,\)"):
        env.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    with pytest.raises(ValueError, match="0 set"):
        env.reset(options={"reset_mask": np.zeros(2, dtype=bool)})


def test_nothing_returned_is_shared_with_what_comes_next():
    env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2)
    first, infos = env.reset(seed=0)
    kept, kept_info = first.copy(), infos["x_position"].copy()
    second, *_, infos2 = env.step(np.ones((2, 3)))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(infos["x_position"], kept_info)
    second[:] = 0.0
    for value in infos2.values():
        value[...] = 0
    third = env.step(np.ones((2, 3)))[0]
    other = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=2)
    other.reset(seed=0)
    other.step(np.ones((2, 3)))
    np.testing.assert_array_equal(third, other.step(np.ones((2, 3)))[0])


def test_gymnasiums_vector_wrappers():
    env = gymnasium.make_vec("HalfCheetah-RandDyn-v0", num_envs=3, split="test", max_episode_steps=5)
    env = wrappers.RecordEpisodeStatistics(env)
    env = wrappers.NormalizeObservation(wrappers.RescaleAction(wrappers.ClipReward(env, -1, 1), -2.0, 2.0))
    env = wrappers.DictInfoToList(env)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(5):
        *_, infos = env.step(env.action_space.sample())
    assert [info["episode"]["l"] for info in infos] == [5, 5, 5]


def test_the_specification_makes_it_again():
    env = gymnasium.make_vec("Hopper-RandDyn-v0", num_envs=3, split="test", autoreset_mode="SameStep")
    again = gymnasium.make_vec(env.spec)
    assert again.num_envs == 3
    assert again.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    np.testing.assert_array_equal(env.reset(seed=4)[0], again.reset(seed=4)[0])


@pytest.mark.parametrize(
    "chosen",
    [
        {"num_envs": np.int64(2), "indices": np.array([0, 1]), "autoreset_mode": AutoresetMode.SAME_STEP},
        {"num_envs": 2, "index": np.int64(3), "healthy_z_range": (np.float32(0.5), np.inf)},
    ],
)
def test_the_specification_is_text_whatever_was_given(chosen):
    env = gymnasium.make_vec("Hopper-RandDyn-v0", **chosen)
    again = gymnasium.make_vec(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec == env.spec
    np.testing.assert_array_equal(env.reset(seed=4)[0], again.reset(seed=4)[0])


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(("robot", "camera"), [("Hopper", None), ("Ant", "track")])  # which follows the centre of mass
def test_render_of_one_sub_environment(robot, camera):
    looks = {"render_mode": "rgb_array", "width": 64, "camera_name": camera}
    env = gymnasium.make_vec(f"{robot}-RandDyn-v0", num_envs=2, split="test", **looks)
    env.reset(seed=0)
    env.step(np.ones(env.action_space.shape))
    frames = env.render()
    single = gymnasium.make(f"{robot}-RandDyn-test1", **looks)
    single.reset(seed=1)
    single.step(np.ones(single.action_space.shape))
    # a frame of Gymnasium's shows where the last substep began: ours is of the state, so the state is put in again
    single.unwrapped.set_state(single.unwrapped.data.qpos, single.unwrapped.data.qvel)
    assert len(frames) == 2
    assert frames[1].shape == (480, 64, 3)
    np.testing.assert_array_equal(frames[1], single.render())
    np.testing.assert_array_equal(env.unwrapped.render_one(1), frames[1])
    with pytest.raises(ValueError, match="no sub-environment 2: choose from 0 to 1"):
        env.unwrapped.render_one(2)
    env.close()
