"""Bodies of the loopback robot: what moves is what the simulators make, with the command's delay put in once."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback import bodies
from fishmj.gap.laboratory.virtual_robot import ClosedLoopRobot
from fishmj.mjcf.reading import load_robot
from fishmj.sim import Sim
from fishmj.water.flow import Flow

FISH = load_robot("fish")


def wave(t):
    return 0.4 * np.sin(2 * np.pi * t - 0.7 * np.arange(3))


def swim(body, ticks, step=0.02):
    """Truth (T, 3 + J) at the ends of the ticks, commands at their beginnings."""
    rows = []
    for _ in range(ticks):
        body.send(wave(body.time))
        for _ in range(round(0.02 / step)):
            body.advance(step)
            body.truth()
        rows.append(body.truth())
    return np.array(rows)


def test_the_second_robot_moves_as_its_own_class_does():
    """With its own nominal latency and without radio jitter; both read the same state."""
    effects = {"command_latency": {"delay": 0.02}, "servo_deadband": {"deadband": 0.02}}
    body = bodies.make("virtual", effects=effects, seed=4, noise=0.0, flow=Flow(speed=0.1, direction=2.0))
    twin = ClosedLoopRobot(effects, seed=4, noise=0.0, flow=(0.1, 2.0))
    twin_rows = []
    for _ in range(60):
        twin.send(wave(twin.time))
        twin.advance(0.02)
        twin_rows.append(twin.truth())
    np.testing.assert_allclose(swim(body, 60), twin_rows, atol=1e-9)


def test_reading_more_often_changes_nothing():
    one, two = (bodies.make("virtual", seed=4, noise=0.0) for _ in range(2))
    np.testing.assert_array_equal(swim(one, 25), swim(two, 25, step=0.001))


@pytest.mark.parametrize("water", ["fitted", "structured"])
def test_mujoco_bodies_move_as_sim_does(water):
    flow = Flow(speed=0.2, direction=3.0, turbulence="default", seed=5)
    body, sim, rows = bodies.make(water, flow=flow), Sim("fish", water=water, flow=flow), []
    for k in range(15):
        sim.step(wave(0.02 * k))
        rows.append([*sim.pose[:3], *sim.data.qpos[-3:]])
    np.testing.assert_allclose(swim(body, 15), rows, atol=1e-12)


@pytest.mark.parametrize("water", ["fitted", "structured"])
def test_the_compiled_engine_moves_as_mujoco_does(water):
    flow = Flow(speed=0.2, direction=3.0, turbulence="default", seed=5)
    rows = [swim(bodies.make(water, flow=flow, engine=engine), 20) for engine in bodies.ENGINES]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-5)


@pytest.mark.parametrize("name", ["virtual", "structured"])
def test_the_radios_share_of_the_latency_is_left_to_the_radio(name):
    """A command that the body gets later by what the radio takes moves the joints at the same time."""

    def first_move(radio):
        body = bodies.make(name, noise=0.0, radio=radio)
        body.advance(0.02)
        if radio:
            body.advance(radio)
        body.send((0.5, 0.5, 0.5))
        for _ in range(200):
            body.advance(0.001)
            if abs(body.truth()[3]) >= 0.02:
                return body.time
        raise AssertionError("the joint never moved")

    assert first_move(0.0) == pytest.approx(first_move(0.02), abs=0.0051)  # a tick of the servo's own firmware


@pytest.mark.parametrize(("name", "engine"), [("virtual", "mujoco"), ("structured", "mujoco"), ("structured", "compiled")])
def test_switches_take_torque_and_bind_gears(name, engine):
    body = bodies.make(name, noise=0.0, engine=engine)
    body.jam(1, True)
    body.send((0.5, 0.5, 0.5))
    body.advance(0.5)
    angles = body.truth()[3:]
    assert abs(angles[1]) < 0.05 and angles[0] > 0.45 and angles[2] > 0.45
    body.jam(1, False)
    body.torque(False)
    body.send((-0.5, -0.5, -0.5))
    body.advance(0.5)
    assert np.abs(body.truth()[3:] - angles).max() < 0.15
    body.torque(True)
    body.send((-0.5, -0.5, -0.5))
    body.advance(0.6)
    assert body.truth()[3:].max() < -0.4


def test_a_weaker_battery_moves_the_second_robot_more_slowly():
    def after(volts):
        body = bodies.make("virtual", noise=0.0)
        body.supply(volts)
        body.send((1.0, 1.0, 1.0))
        body.advance(0.2)
        return body.truth()[3], body.sensors().voltage

    (strong, full), (weak, low) = after(None), after(5.0)
    assert weak < 0.9 * strong and full > 7.0 and low < 5.1


def test_what_is_planted_in_the_camera_is_seen_and_not_true():
    body = bodies.make(
        "virtual", effects={"camera_scale": {"scale": 0.1}, "clock_offset": {"offset": 0.04}}, start=(1.0, 0.5, 0.0)
    )
    body.advance(0.1)
    stamp, seen = body.seen()
    assert stamp == pytest.approx(0.14, abs=1e-6)
    np.testing.assert_allclose(seen[:2], 1.1 * body.truth()[:2], atol=1e-3)


def test_gusts_of_the_second_robot_last_beyond_what_was_drawn_first(monkeypatch):
    from fishmj.deploy.loopback import virtual_body

    def drift(horizon):
        monkeypatch.setattr(virtual_body, "HORIZON", horizon)
        body = bodies.make("virtual", noise=0.0, flow=Flow(speed=0.1, turbulence="gust", intensity=0.2, seed=1))
        body.advance(3.0)
        return body.truth()

    np.testing.assert_array_equal(drift(1.0), drift(30.0))


def test_impossible_bodies_are_refused():
    with pytest.raises(UnknownName, match="virtual"):
        bodies.make("virtul")
    with pytest.raises(UnknownName, match="compiled"):
        bodies.make("fitted", engine="jax")
    with pytest.raises(ConfigError, match="body virtual"):
        bodies.make("fitted", effects={"gear_backlash": {"half_gap": 0.01}})
    with pytest.raises(ConfigError, match="varies in space"):
        bodies.make("virtual", flow=Flow(speed=0.2, turbulence="default"))
    with pytest.raises(ConfigError, match="whole milliseconds"):
        bodies.make("virtual").advance(0.0004)


@pytest.mark.oracle
@pytest.mark.slow
def test_the_flow_solver_is_a_body():
    body = bodies.make("lbm", domain="laptop")
    body.send((0.3, 0.3, 0.3))
    body.advance(0.2)
    assert body.truth()[3:].min() > 0.1 and np.isfinite(body.truth()).all()
    body.torque(False)
    before = body.truth()
    body.send((-0.3, -0.3, -0.3))
    body.advance(0.1)
    assert np.abs(body.truth()[3:] - before[3:]).max() < 0.2
