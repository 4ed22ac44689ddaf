"""dm_control environments: one conformance suite over every task, dm_control's own on top, and the physics underneath."""

import importlib
import os
import subprocess
import sys
import threading
import unittest
from pathlib import Path
from unittest import mock

import dm_env
import numpy as np
import pytest
from dm_control import suite as dm_suite
from dm_control.rl import control
from dm_env import test_utils

from fishmj import engines, suite
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.engines.lbm import LbmEngine as LbmEngine
from fishmj.engines.single import HookedWater
from fishmj.tasks.dm_control import physics as fish_physics
from fishmj.tasks.episode import Episodes
from fishmj.water.dynamics import planar_chain

ROOT = Path(__file__).resolve().parent.parent
TASKS = pytest.mark.parametrize("name", [task for _, task in suite.ALL_TASKS])
NAMED = ("body", "joint", "geom", "site", "camera", "light", "mesh", "texture", "material", "actuator", "sensor")
CALM = dict(turbulence="none", noise=0.0, randomisation=0.0)


def load(name="station_hold", seed=0, flat=False, **kwargs):
    """An environment of the fish domain."""
    return suite.load("fish", name, {"random": seed, **kwargs}, {"flat_observation": flat})


def swim(env, steps, seed=0):
    """A fresh episode under random actions: time steps until it ends or `steps` are done."""
    rng, out = np.random.default_rng(seed), [env.reset()]
    while not out[-1].last() and len(out) <= steps:
        out.append(env.step(rng.uniform(-1, 1, 3)))
    return out


def stacked(steps):
    """Observations (T, 11) of time steps."""
    return np.array([np.concatenate(list(s.observation.values())) for s in steps])


# ---- conformance, every task ----


@TASKS
def test_time_steps_conform_to_the_specs_and_stay_finite(name):
    env = load(name)
    spec, action = env.observation_spec(), env.action_spec()
    assert isinstance(env, control.Environment) and isinstance(env, dm_env.Environment)
    assert list(spec) == ["target", "velocity", "yaw_rate", "joint", "joint_rate"]
    assert action.minimum.tolist() == [-1.0] * 3 and action.maximum.tolist() == [1.0] * 3
    steps = swim(env, 1000)  # a whole episode
    for step in steps:
        for key, value in step.observation.items():
            spec[key].validate(value)
        assert np.isfinite(stacked([step])).all()
        if not step.first():
            assert isinstance(step.reward, float) and np.isfinite(step.reward) and step.reward <= 1.0
            assert step.discount == 1.0 or step.last()
    assert steps[-1].last() and steps[-1].discount == env.task.get_termination(env.physics)


@TASKS
def test_the_same_seed_gives_the_same_trajectory(name):
    one, two = stacked(swim(load(name, 3), 12)), stacked(swim(load(name, 3), 12))
    np.testing.assert_array_equal(one, two)
    assert np.abs(one - stacked(swim(load(name, 4), 12))).max() > 0.01


@TASKS
def test_no_observation_is_constant_and_starts_differ(name):
    env = load(name, **CALM)
    assert (np.ptp(stacked(swim(env, 20)), axis=0) > 1e-4).all()
    before = env.task.scenario
    env.reset()
    for part in ("pose", "target", "direction"):
        old, new = (getattr(drawn.launch.start, part) for drawn in (before, env.task.scenario))
        assert np.abs(new - old).max() > 1e-3, part
    noisy = load(name)
    assert np.abs(stacked(swim(noisy, 0)) - stacked(swim(noisy, 0))).max() > 0.01


@TASKS
def test_time_steps_share_no_memory_and_looking_changes_nothing(name):
    env = load(name)
    first, second = env.reset(), env.step(np.zeros(3))
    for key in first.observation:
        assert not np.may_share_memory(first.observation[key], second.observation[key])
    again = env.task.get_observation(env.physics)
    for key, value in second.observation.items():
        np.testing.assert_array_equal(value, again[key])


@TASKS
def test_every_object_has_a_name(name):
    model = load(name).physics.model
    count = {"joint": "njnt", "camera": "ncam", "texture": "ntex", "material": "nmat", "actuator": "nu"}
    for kind in NAMED:
        for i in range(getattr(model, count.get(kind, f"n{kind}"))):
            assert model.id2name(i, kind), f"{kind} {i} has no name"


@TASKS
def test_flat_observations_keep_the_order_of_the_eleven(name):
    flat, named = load(name, flat=True), load(name)
    assert flat.observation_spec()["observations"].shape == (11,)
    np.testing.assert_array_equal(flat.reset().observation["observations"], stacked([named.reset()])[0])


@TASKS
def test_time_up_is_the_last_step_with_discount_one(name):
    steps = swim(load(name, seconds=2.0, flow_speed=0.0), 99)
    assert len(steps) == 11 and steps[-1].last() and steps[-1].discount == 1.0


def test_an_episode_has_150_steps():
    env = load(flow_speed=0.0, **CALM)
    env.reset()
    kinds = [env.step(np.zeros(3)).step_type for _ in range(150)]
    assert [k.last() for k in kinds] == [False] * 149 + [True]


def test_leaving_the_domain_is_the_last_step_with_discount_zero():
    env = load(**CALM)
    env.reset()
    drawn = env.task.rules.draws(np.random.default_rng(0), 1)
    edge = env.task.rules.scenario(drawn, pose=np.array([[1.97, 0.0, 0.0]]), speed=np.array([0.3]), direction=np.array([0.0]))
    with env.physics.reset_context():
        env.task.begin(env.physics, edge)
    for _ in range(30):
        step = env.step(np.zeros(3))
        if step.last():
            break
    assert step.discount == 0.0 and env.physics.reference_pose()[0] > 2.0
    assert env.step(np.zeros(3)).first()


class TestDmEnv(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own conformance tests."""

    def make_object_under_test(self):
        return load()


@pytest.mark.slow
def test_dm_controls_own_suite_passes_over_our_tasks(monkeypatch):
    """Its test module, run over the registered tasks only."""
    suite.register()
    monkeypatch.setitem(sys.modules, "mock", mock)
    for listing in ("ALL_TASKS", "REWARD_VIZ", "TASKS_BY_DOMAIN"):
        monkeypatch.setattr(dm_suite, listing, getattr(suite, listing))
    monkeypatch.delitem(sys.modules, "dm_control.suite.suite_test", raising=False)
    module = importlib.import_module("dm_control.suite.suite_test")
    monkeypatch.delitem(sys.modules, "dm_control.suite.suite_test")
    result = unittest.TestResult()
    unittest.defaultTestLoader.loadTestsFromModule(module).run(result)
    assert result.testsRun >= 8 * len(suite.ALL_TASKS) and result.wasSuccessful(), [*result.failures, *result.errors]


# ---- loading ----


def test_register_is_idempotent_and_keeps_what_dm_control_has():
    suite.register()
    before = (dm_suite.ALL_TASKS, dict(dm_suite.TASKS_BY_DOMAIN), dm_suite.EXTRA)
    suite.register()
    assert before == (dm_suite.ALL_TASKS, dict(dm_suite.TASKS_BY_DOMAIN), dm_suite.EXTRA)
    assert dm_suite.TASKS_BY_DOMAIN["fish"][:2] == ("upright", "swim") and ("cartpole", "swingup") in dm_suite.ALL_TASKS
    assert not set(suite.ALL_TASKS) & set(dm_suite.BENCHMARKING)
    env = dm_suite.load("fish", "station_hold", task_kwargs={"random": 0})
    assert isinstance(env.physics, fish_physics.Physics)
    np.testing.assert_array_equal(stacked(swim(env, 3)), stacked(swim(load(), 3)))
    assert dm_suite.load("fish", "swim").action_spec().shape == (5,)


def test_dm_controls_tasks_load_by_the_same_function():
    assert suite.load("fish", "upright").action_spec().shape == (5,)
    assert suite.load("cartpole", "balance", {"random": 1}).reset().first()


def test_wrong_names_and_options_are_one_clear_error():
    with pytest.raises(UnknownName, match="Did you mean 'fish station_hold'"):
        suite.load("fish", "station_hld")
    with pytest.raises(ConfigError, match="unknown option 'turbulance'"):
        load(turbulance="gust")
    with pytest.raises(ConfigError, match="set `seconds`"):
        suite.load("fish", "station_hold", environment_kwargs={"time_limit": 3})
    with pytest.raises(UnknownName, match="root"):
        load(root="floating")
    env = load()
    env.reset()
    with pytest.raises(ConfigError, match=r"expected finite numbers of shape \(3,\)"):
        env.step([0.0, np.nan, 0.0])


# ---- the physics underneath ----


@pytest.mark.parametrize("path", ["linear", "move_time"])
def test_the_environment_swims_as_the_batched_engine_does(path):
    """Randomised fish, turbulence, noise: the same observations and rewards over 20 steps."""
    env = load(seed=5, intensity=0.1, command_path=path)
    first = env.reset()
    episodes = Episodes(env.task.rules, "batch", 1)
    episodes.begin(env.task.scenario)
    np.testing.assert_allclose(episodes.observation(env.task.normals)[0], stacked([first])[0], atol=1e-12)
    rng = np.random.default_rng(1)
    for _ in range(20):
        action = rng.uniform(-1, 1, 3)
        step, out = env.step(action), episodes.step(action[None])
        np.testing.assert_allclose(stacked([step])[0], episodes.observation(env.task.normals)[0], rtol=0, atol=1e-9)
        assert step.reward == pytest.approx(out.reward[0], abs=1e-9)
        assert env.task.trace.power.mean() == pytest.approx(out.power[0], rel=1e-9)


def test_the_water_without_numba_is_the_same_water(monkeypatch):
    fast = stacked(swim(load(seed=2), 5))
    slow = lambda robot: HookedWater(robot, engines.Extensions.of(robot), planar_chain.nominal(robot))
    monkeypatch.setattr(fish_physics, "closed_form", slow)
    np.testing.assert_allclose(stacked(swim(load(seed=2), 5)), fast, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("water", "close"), [("structured", 0.015), ("fitted", 0.03)])
def test_a_free_root_swims_like_a_planar_one(water, close):
    planar, free = load(seed=7, water=water), load(seed=7, water=water, root="free")
    one, two = stacked(swim(planar, 15)), stacked(swim(free, 15))
    np.testing.assert_allclose(two[:, :2], one[:, :2], atol=close)
    height, up = free.physics.data.qpos[2], free.physics.named.data.xmat["head", "zz"]
    assert abs(height) < 0.05 and up > 0.98  # upright, at its depth, though masses were randomised


@pytest.mark.parametrize("root", ["planar", "free"])
def test_a_learnt_water_swims_on_both_roots(root):
    strips, fitted = (stacked(swim(load(seed=7, water=water, root=root), 3)) for water in ("swift-base", "swift"))
    assert np.abs(fitted[-1] - strips[-1]).max() > 1e-4  # the learnt force acts


def test_learnt_water_swims_alike_on_free_and_planar_roots_and_in_copies():
    planar, free = load(seed=7, water="swift"), load(seed=7, water="swift", root="free")
    one, two = stacked(swim(planar, 15)), stacked(swim(free, 15))
    np.testing.assert_allclose(two[:, :2], one[:, :2], atol=0.03)  # twice as fast as in the strips' own coefficients
    np.testing.assert_allclose(free.physics.water.memory[:16], planar.physics.water.memory[:16], atol=0.05)
    assert np.abs(free.physics.water.memory[:16]).max() > 0.1  # the wake
    twin = free.physics.copy()
    for physics in (twin, free.physics):
        physics.set_control([0.4, -0.2, 0.3])
        physics.step(25)
    np.testing.assert_array_equal(twin.data.qpos, free.physics.data.qpos)
    np.testing.assert_array_equal(twin.water.memory, free.physics.water.memory)


def test_waters_that_are_not_there_are_refused():
    with pytest.raises(ConfigError, match="planar root"):
        load(root="free", water="lbm")
    with pytest.raises(UnknownName, match="no_such_water"):
        load(water="no_such_water")


@pytest.mark.slow
def test_the_flow_solver_moves_a_fish_of_the_suite_as_it_does_a_judged_one():
    box = {"domain": "laptop", "device": "cpu"}
    env = load(seed=3, seconds=0.4, turbulence="gust", noise=0.0, water="lbm", solver=box)
    env.reset()
    rules, scenario = env.task.rules, env.task.scenario
    flow = env.physics.engine.flows[0]
    np.testing.assert_allclose(flow.current().mean, scenario.current.mean, rtol=1e-12)
    episodes = Episodes(rules, LbmEngine(rules.robot, [flow], **box), 1)
    episodes.begin(scenario)
    for action in ([0.5, 0.2, -0.4], [-0.3, 0.6, 0.1]):
        step, out = env.step(np.array(action)), episodes.step(np.array([action]))
        np.testing.assert_allclose(stacked([step])[0], episodes.observation(np.zeros((1, 11)))[0], rtol=0, atol=1e-12)
        assert step.reward == pytest.approx(out.reward[0], abs=1e-12)
    assert step.last() and env.physics.time() == pytest.approx(0.4)
    with pytest.raises(ConfigError, match="whole bus ticks"):
        env.physics.step(1)
    with pytest.raises(ConfigError, match="cannot be copied"):
        env.physics.copy()


def test_environments_in_threads_do_not_meet():
    made = lambda: [load(seed=0), load(seed=1), load(seed=2, root="free"), load(seed=3, root="free", water="swift")]
    alone, envs, found = [stacked(swim(env, 6)) for env in made()], made(), [None] * 4
    work = [threading.Thread(target=lambda i=i: found.__setitem__(i, stacked(swim(envs[i], 6)))) for i in range(4)]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    for a, b in zip(alone, found, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_copy_of_the_physics_swims_on_alike_and_apart():
    env = load(seed=1)
    swim(env, 4)
    twin = env.physics.copy()
    for physics in (env.physics, twin):
        physics.set_control([0.4, 0.2, -0.3])
    env.physics.step(40)
    assert np.abs(twin.data.qpos - env.physics.data.qpos).max() > 1e-3
    twin.step(40)
    np.testing.assert_array_equal(twin.data.qpos, env.physics.data.qpos)


@pytest.mark.parametrize("root", ["planar", "free"])
def test_fault_02_a_diverged_fish_raises_dm_controls_error(root):
    env = load(root=root)
    env.reset()
    env.physics.data.qvel[:] = 1e12
    with pytest.raises(control.PhysicsError):
        env.step(np.zeros(3))
    assert env.reset().first() and np.isfinite(stacked([env.step(np.zeros(3))])).all()


def test_rendering_shows_the_fish_and_the_reward_colours_the_target():
    code = (
        "import numpy as np; from fishmj import suite\n"
        "env = suite.load('fish', 'station_hold', {'random': 0}, visualize_reward=True); env.reset(); env.step(np.zeros(3))\n"
        "frames = [env.physics.render(120, 160, camera_id=c) for c in ('top', 'corner', 'follow')]\n"
        "print([f.shape for f in frames] == [(120, 160, 3)] * 3, min(np.ptp(f) for f in frames) > 50)\n"
    )
    environ = {**os.environ, "MUJOCO_GL": "egl"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=environ)
    if done.returncode and "gl" in done.stderr.lower():
        pytest.skip(f"no EGL here: {done.stderr.strip().splitlines()[-1]}")
    assert done.stdout.split() == ["True", "True"], done.stderr
