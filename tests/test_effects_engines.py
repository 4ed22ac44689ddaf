"""Effects of a description live in every simulator: same swim, same sensors, drawn for training, nothing where none is."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from fishmj import effects, engines
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects.effect_calibration import FittedEffect, Interval, write
from fishmj.effects.sites import SensorReadings
from fishmj.engines import batch, extensions, mjx, planar
from fishmj.engines.recorder import cubic
from fishmj.log import stacked
from fishmj.mjcf import load_robot
from fishmj.mjcf.description import Robot
from fishmj.sim import Sim
from fishmj.tasks import station_hold as task
from fishmj.tasks.sensing import Sensors
from fishmj.water.flow import Flow, stack

PLAIN = load_robot("fish")
EVERY_SITE = (  # command, servo, gear, fish, flow, body, water, measure; and the delays
    "command_gain_error", "move_time_ramp", "voltage_sag", "coulomb_friction", "gear_backlash", "body_mass", "current_shear",
    "tether", "wake_memory", "camera_scale", "joint_zero_offset", "power_offset", "command_latency", "joint_sensor_delay",
    "camera_latency", "velocity_filter",
)  # fmt: skip
POSE, TICKS = np.array([0.1, -0.2, 0.5]), 40


def typical(name: str) -> FittedEffect:
    """An effect at its larger typical value."""
    return FittedEffect(name, {p.name: Interval(p.probe, p.probe, p.probe) for p in effects.get(name).parameters})


def robot_with(*names: str) -> Robot:
    return replace(PLAIN, effects=tuple(typical(name) for name in names))


def beat(ticks=TICKS):
    """Bus commands (T, 3), rad; over the servo's range at times."""
    return 1.15 * np.sin(2 * np.pi * 1.3 * np.arange(ticks)[:, None] / 50 - np.arange(3))


FLOW = Flow(speed=0.2, direction=2.0, turbulence="default", intensity=0.1, seed=4)


def advance(engine, robot, count=2):
    """State and trace of `count` equal fish, NumPy."""
    params, state = engines.nominal_params(robot, count), engines.at_rest(robot, np.tile(POSE, (count, 1)))
    commands = np.tile(beat(), (count, 1, 1))
    out = engine.advance(state, commands, params, stack([FLOW] * count), np.zeros(count, np.int32))
    return jax.tree.map(np.asarray, tuple(out))


@pytest.fixture(scope="module")
def swim():
    """(robot with effects at every site, what the closed form makes of it)."""
    robot = robot_with(*EVERY_SITE)
    sites = {site for name in EVERY_SITE for site in effects.get(name).sites}
    assert sites == {"servo", "gear", "fish", "flow", "body", "water", "command", "measure"}
    with jax.enable_x64(True):
        return robot, advance(planar.PlanarEngine(robot), robot)


def same(one, two, atol):
    for name, a, b in zip((*one[0]._fields, *one[1]._fields), jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=name)


def test_compiled_engine_with_effects_matches_the_closed_form_engine(swim):
    pytest.importorskip("numba")
    from fishmj.engines import compiled

    robot, expected = swim
    same(advance(compiled.CompiledEngine(robot, dtype="float64"), robot), expected, 1e-11)


def test_mujoco_in_c_swims_with_effects_at_every_site_as_the_closed_form(swim):
    robot, expected = swim
    same(advance(batch.BatchEngine(robot, threads=1, evaluator="jax"), robot), expected, 1e-11)


def test_mjx_swims_with_effects_as_one_fish_in_mujoco():
    robot = robot_with("coulomb_friction", "command_gain_error")
    sim = Sim(robot, water="structured", flow=FLOW, pose=POSE)
    truth = sim.run(beat(), TICKS / 50).table("truth")
    with jax.enable_x64(True):
        state, trace = advance(mjx.MjxEngine(robot), robot, 1)
    np.testing.assert_allclose(trace.joint[0], stacked(truth, "j#"), rtol=0, atol=1e-8)
    np.testing.assert_allclose(state.memory[0], sim.water.memory, rtol=0, atol=1e-8)


def test_sim_with_effects_matches_the_closed_form_engine(swim):
    robot, (_, trace) = swim
    sim = Sim(robot, water="structured", flow=FLOW, pose=POSE)
    trial = sim.run(beat(), TICKS / 50)
    truth = trial.table("truth")
    np.testing.assert_allclose(np.stack([truth[k] for k in ("x", "y", "yaw")], -1), trace.pose[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(stacked(truth, "j#"), trace.joint[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(sim.water.memory, swim[1][0].memory[0], rtol=0, atol=1e-8)


def test_the_log_of_one_fish_holds_what_late_and_crooked_sensors_report(swim):
    robot, (_, trace) = swim
    trial = Sim(robot, water="structured", flow=FLOW, pose=POSE).run(beat(), TICKS / 50)
    truth, pose, joint, power = (trial.table(name) for name in ("truth", "pose", "joint", "power"))
    late = lambda name: effects.get(name).parameter("delay").probe
    at = truth["t"][20:] - late("camera_latency")
    scale = 1 + effects.get("camera_scale").parameter("scale").probe
    np.testing.assert_allclose(pose["x"][20:], scale * np.interp(at, truth["t"], truth["x"]), rtol=0, atol=5e-4)
    offset = effects.get("joint_zero_offset").parameter("offset2").probe
    at = truth["t"][20:] - late("joint_sensor_delay")
    np.testing.assert_allclose(joint["j2"][20:], np.interp(at, truth["t"], truth["j2"]) - offset, rtol=0, atol=5e-3)
    more = effects.get("power_offset").parameter("power").probe
    sag, drawn = effects.get("voltage_sag"), SensorReadings(*[0.0] * 5, power=trace.power[0] + robot.servo.idle_power)
    left = sag.measure(
        np, SimpleNamespace(robot=effects.RobotScales(), resistance=sag.parameter("resistance").probe), drawn
    ).power
    np.testing.assert_allclose(power["V"] * power["I"], left + more, rtol=0, atol=1e-6)


def test_a_fish_without_effects_has_no_columns_and_no_hooks():
    state, params = engines.at_rest(PLAIN, np.zeros((5, 3))), engines.nominal_params(PLAIN, 5)
    assert state.memory.shape == (5, 0) and params.effects.shape == (5, 0) and state.buffer.shape == (5, engines.BUFFER, 3)
    assert extensions.Extensions.of(PLAIN).hooks(np, [], []) is None and Sim(PLAIN, water="structured").water.memory == []
    sensors, history = Sensors(PLAIN), np.random.default_rng(0).normal(size=(2, 11, 3))
    assert sensors.poses(np, params.effects, history) is history and sensors.behind == sensors.frames == 0


def test_effects_at_their_null_move_no_fish():
    """The forces reach MuJoCo in another way, through `qfrc_applied`: round-off, nothing else."""
    nothing = engines.with_effects(PLAIN, ["coulomb_friction", "tether", "command_gain_error", "wake_memory"])
    one, two = (Sim(robot, water="structured", flow=FLOW, pose=POSE).run(beat(), TICKS / 50) for robot in (nothing, PLAIN))
    for name in ("truth", "pose", "joint", "power"):
        for key, column in one.table(name).items():
            np.testing.assert_allclose(column, two.table(name)[key], rtol=0, atol=1e-8, err_msg=f"{name} {key}")


def test_a_description_lists_effects_in_their_order(tmp_path):
    from fishmj.base.calib import resolve

    path = tmp_path / "mine.toml"
    path.write_text(resolve("fish").read_text())
    assert load_robot(path).effects == () and load_robot("tendon_fish").effects == ()
    write(path, [typical("tether"), typical("coulomb_friction")])
    robot = load_robot(path)
    assert [fitted.name for fitted in robot.effects] == ["tether", "coulomb_friction"]
    assert repr(robot) == repr(load_robot("fish")).replace("'swift'", repr(robot.name))
    path.write_text(path.read_text().replace("coulomb_friction", "coulomb_frction"))
    with pytest.raises(ConfigError, match="mine.toml.*coulomb_friction"):
        load_robot(path)


def test_command_delays_become_physics_steps_and_make_room_on_the_bus():
    robot = robot_with("command_latency")
    value = effects.get("command_latency").parameter("delay").probe
    steps = round((robot.timing.command_latency + value) / robot.timing.physics_dt)
    assert engines.nominal_params(robot, 2).delay.tolist() == [steps, steps] and Sim(robot).delay == steps
    assert engines.rows_of(robot) == engines.BUFFER + 13  # 0.25 s, the parameter's bound


def test_pose_delays_join_the_camera_and_joint_delays_read_between_ticks():
    robot = robot_with("camera_latency", "joint_sensor_delay")
    draw = np.random.default_rng(0).random((3, task.n_fish(robot)))
    params, camera = task.draw_fish(np, robot, draw, 0.0)
    late = robot.timing.camera_latency + effects.get("camera_latency").parameter("delay").probe
    assert camera.tolist() == [int(np.ceil(late / 0.02 - 1e-6))] * 3
    assert task.history_length(robot) == task.history_length(PLAIN) + 13
    sensors, value = Sensors(robot), effects.get("joint_sensor_delay").parameter("delay").probe
    ramp = np.repeat(0.02 * np.arange(sensors.behind + 1)[None, :, None], 6, 2)  # rad: the time at which it was true
    joint, rate = sensors.joints(np, params.effects[:1], ramp)
    np.testing.assert_allclose(joint, ramp[:, -1, :3] - value, atol=1e-12)
    np.testing.assert_allclose(rate, ramp[:, -1, 3:] - value, atol=1e-12)


def test_feedback_alone_feels_a_slow_velocity_filter():
    robot = robot_with("velocity_filter")
    sensors, params = Sensors(robot), engines.nominal_params(robot, 1)
    t = 0.02 * np.arange(task.history_length(robot))
    history = np.stack([0.5 * t * t, 0 * t, 0 * t], -1)[None]  # m: the velocity is t
    seen = task.observe_with_sensors(
        np, robot, sensors, params, history, np.array([0]), np.zeros((1, 1, 6)), np.zeros((1, 2)), np.zeros((1, 11))
    )
    fast = task.observe(
        np, robot, history, np.array([0]), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)), np.zeros((1, 11))
    )
    late = np.ceil(effects.get("velocity_filter").parameter("time").probe / 0.02 - 1e-6) * 0.02
    np.testing.assert_allclose(fast[0, 2] - seen[0, 2], late, atol=1e-9)
    np.testing.assert_allclose(seen[0, :2], fast[0, :2])


def test_what_no_simulator_holds_is_said():
    with pytest.raises(ConfigError, match="packet_loss"):
        engines.with_effects(PLAIN, ["packet_loss"])
    with pytest.raises(UnknownName, match="coulomb_friction"):
        engines.with_effects(PLAIN, ["coulomb_frction"])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        engines.Extensions.of(robot_with("packet_loss"))
    assert "packet_loss" in str(said[0].message)
    robot = robot_with("coulomb_friction")
    for setting in (dict(root="free"), dict(water="ellipsoid")):
        with pytest.raises(ConfigError, match="planar root"):
            Sim(robot, **setting)


def test_on_a_dry_bench_friction_acts_and_water_does_not():
    dry = Sim(robot_with("coulomb_friction"), water="none", flow=Flow(speed=0.3)).run(beat(), 0.8).table("truth")
    plain = Sim(PLAIN, water="none").run(beat(), 0.8).table("truth")
    assert np.abs(dry["j1"] - plain["j1"]).max() > 1e-3
    null = Sim(engines.with_effects(PLAIN, ["coulomb_friction"]), water="none", flow=Flow(speed=0.3)).run(beat(), 0.8)
    np.testing.assert_allclose(null.table("truth")["j1"], plain["j1"], atol=1e-8)
    np.testing.assert_allclose(null.table("truth")["x"], plain["x"], atol=1e-8)


@pytest.fixture(scope="module")
def fitted_water(tmp_path_factory):
    """File of a fitted water with a learnt residual of small random weights."""
    from fishmj.water import residual_hooks, residual_network
    from fishmj.water.dynamics import planar_chain
    from fishmj.water.hydro_model import HydroModel, robot_hash
    from fishmj.water.prior import flat

    base, ch = planar_chain.nominal(PLAIN).water, planar_chain.chain_of(PLAIN)
    net = residual_network.blank(ch.n, 2, 4, seed=3)
    net = net._replace(outer=0.3 * np.random.default_rng(3).normal(size=net.outer.shape))
    learnt = residual_hooks.Residual(net, residual_hooks.unlimited(ch.n)._replace(spread=np.array(1.0)))
    members = np.tile(flat(base), (2, 1))
    made = HydroModel(
        name="made", robot=PLAIN.name, robot_sha256=robot_hash(PLAIN), dt=ch.dt, slip=1.0, base=base._replace(ke=0.4),
        members=members, alone=np.tile(members[:1], (3, 1)), learnt=learnt,
    )  # fmt: skip
    return made.save(tmp_path_factory.mktemp("water"))


def test_a_fitted_water_and_effects_act_together_in_every_simulator(fitted_water):
    robot = engines.in_water(robot_with("coulomb_friction", "command_gain_error"), fitted_water)
    alone = engines.in_water(PLAIN, fitted_water)
    assert alone.water["ke"] == 0.4 and engines.at_rest(alone, np.zeros((1, 3))).memory.shape == (1, 18)
    sim = Sim(robot_with("coulomb_friction", "command_gain_error"), water=str(fitted_water), flow=FLOW, pose=POSE)
    truth = sim.run(beat(), TICKS / 50).table("truth")
    state, trace = advance(batch.BatchEngine(robot, threads=1, evaluator="jax"), robot, 1)
    np.testing.assert_allclose(trace.joint[0], stacked(truth, "j#"), rtol=0, atol=1e-8)
    np.testing.assert_allclose(state.memory[0], sim.water.memory, rtol=0, atol=1e-8)
    assert state.memory.shape == (1, 26) and np.abs(state.memory[0, 8:24]).max() > 1e-3  # time, current, friction, wake, ...
    strips = Sim(robot, flow=FLOW, pose=POSE)  # the robot carries its water
    np.testing.assert_allclose(strips.run(beat(), TICKS / 50).table("truth")["x"], truth["x"], atol=1e-12)
    with pytest.raises(ConfigError, match="fitted for robot"):
        engines.in_water(load_robot("tendon_fish"), fitted_water)


def test_the_cubic_between_samples_is_exact_for_a_cubic():
    t = np.arange(6) * 0.02
    f, g = (lambda s: (s**3 - s)[:, None]), (lambda s: (3 * s**2 - 1)[:, None])
    at = np.array([0.0, 0.013, 0.05, 0.099, 0.1])
    np.testing.assert_allclose(cubic(t, f(t), g(t), at), f(at), atol=1e-14)
    np.testing.assert_allclose(cubic(t, f(t), g(t), np.array([-1.0])), f(t[:1]))
