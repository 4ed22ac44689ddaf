"""Effects drawn for training, and what both environments see through late and crooked sensors."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from test_effects_engines import PLAIN, robot_with, typical

from fishmj import effects, engines
from fishmj.base.errors import ConfigError
from fishmj.effects import randomise
from fishmj.engines import planar
from fishmj.tasks import station_hold as task
from fishmj.tasks.env import Options, StationHold
from fishmj.tasks.episode import Episodes, TaskOptions, TaskSpec


def test_drawn_effects_span_their_typical_range_and_fixed_effects_stay():
    robot = replace(robot_with("camera_scale"), effects=(typical("camera_scale"),))
    robot = engines.with_effects(robot, ["coulomb_friction", "command_gain_error"])
    names = ("coulomb_friction", "command_gain_error")
    u = np.random.default_rng(1).random((2000, task.n_fish(robot, names)))
    rows = task.draw_fish(np, robot, u, 1.0, names)[0].effects
    active = engines.Extensions.of(robot).active
    assert (rows[:, active.index("camera_scale", "scale")] == effects.get("camera_scale").parameter("scale").probe).all()
    for name, key in (("coulomb_friction", "torque"), ("command_gain_error", "gain")):
        p, value = effects.get(name).parameter(key), rows[:, active.index(name, key)]
        low, high = p.typical
        assert low <= np.abs(value).min() < low + 0.02 * (high - low) and high - 0.02 * (high - low) < np.abs(value).max() <= high
        assert (value < 0).any() == p.signed
    np.testing.assert_array_equal(
        randomise.drawn(np, active, rows, names, u[:, -4:], 0.0)[:, 1:], np.tile(active.null[1:], (2000, 1))
    )


@pytest.fixture(scope="module")
def school():
    """(environment of a robot with bad sensors whose latency and gains are drawn, four first episodes)."""
    robot = robot_with("camera_latency", "joint_sensor_delay", "camera_yaw", "joint_zero_offset")
    env = StationHold(robot, "planar", Options(effects=("command_latency", "servo_gain"), noise=0.0, turbulence="none"))
    return robot, env, env.reset(jax.random.key(1), 4)


def test_a_school_in_training_differs_in_its_drawn_effects_and_swims(school):
    robot, env, state = school
    active = env.sensors.added.active
    column = lambda *key: np.asarray(state.params.effects)[:, active.index(*key)]
    assert len(np.unique(column("servo_gain", "gain"))) == 4 and len(np.unique(column("camera_yaw", "angle"))) == 1
    assert len(np.unique(np.asarray(state.params.delay))) > 1
    for _ in range(2):
        state = env.step(state, np.full((4, 3), 0.3, np.float32))
    assert np.isfinite(np.asarray(state.obs)).all() and not np.asarray(state.diverged).any()
    with pytest.raises(ConfigError, match="servo_gain"):
        StationHold(PLAIN, planar.PlanarEngine(PLAIN), Options(effects=("servo_gain",)))


def test_both_environments_see_the_same_through_late_crooked_sensors(school):
    """NumPy's episodes and the functional ones: one scenario, one action, one sight."""
    robot, env, state = school
    drawn = ("command_latency", "servo_gain")
    rules = TaskSpec("station_hold", TaskOptions(robot=robot, noise=0.0, turbulence="none", randomisation=0.0, effects=drawn))
    episodes = Episodes(rules, env.engine, 4)
    now = episodes.scenario
    state = state._replace(
        fish=jax.tree.map(lambda a, b: np.asarray(a, b.dtype), episodes.fish, state.fish),
        params=jax.tree.map(lambda a, b: np.asarray(a, b.dtype), now.params, state.params),
        current=jax.tree.map(lambda a, b: np.asarray(a, b.dtype), now.current, state.current),
        history=np.float32(episodes.window.pose), target=np.float32(episodes.target), camera=np.asarray(now.camera, np.int32),
    )  # fmt: skip
    for seed in range(2):
        action = np.random.default_rng(seed).uniform(-1, 1, (4, 3)).astype(np.float32)
        state = env.step(state, action)
        episodes.step(action)
        np.testing.assert_allclose(np.asarray(state.obs), episodes.observation(np.zeros((4, 11))), rtol=0, atol=2e-3)
