"""The observation on the host is the one that training computes, and readings that cannot be are not believed."""

import numpy as np
import pytest

from fishmj.deploy.loop.command_limits import Limiter, towards_zero
from fishmj.deploy.loop.observation import RATE_WINDOW, ObservationBuilder
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.deploy.tracker.fix import Fix
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold

ROBOT, DT = load_robot("fish"), 0.02
TARGET = (0.4, -0.3)


def fix(t, x=0.0, y=0.0, yaw=0.0):
    return Fix(t, x, y, yaw, np.eye(3), 1.0)


def seen(poses, start=5.0, step=DT):
    """An observer that got these poses (T, 3), and four equal readings."""
    one = ObservationBuilder(ROBOT, TARGET)
    for k in range(4):
        one.telemetry(5.0 + k * DT, Telemetry((0.1, 0.2, 0.3)))
    for k, pose in enumerate(poses):
        one.fix(fix(start + k * step, *pose), start + k * step + 0.06)
    return one


def swimming(t):
    """A pose at times t (T,) of a fish that turns through pi."""
    return np.stack([0.3 * np.cos(t), 0.3 * np.sin(1.3 * t), np.pi - 0.2 + 0.9 * t], -1)


def test_the_vector_is_what_training_observes_of_the_same_data():
    rng, window = np.random.default_rng(0), ROBOT.timing.velocity_window
    poses = swimming(np.arange(20) * DT)
    one = ObservationBuilder(ROBOT, TARGET)
    joint = rng.uniform(-1, 1, (20, 3)).cumsum(0) * 0.02
    for k in range(20):
        wrapped = (poses[k, 2] + np.pi) % (2 * np.pi) - np.pi
        one.fix(fix(k * DT, *poses[k, :2], wrapped), k * DT + 0.06)
        one.telemetry(k * DT, Telemetry(tuple(joint[k]), time=k * DT))
    rate = (joint[-1] - joint[-3]) / (2 * DT)  # the slope of a line through three even readings
    expected = station_hold.observe(
        np, ROBOT, poses[None], np.zeros(1, int), joint[-1:], rate[None], np.array([TARGET]), np.zeros((1, 11))
    )[0]
    assert RATE_WINDOW == 3 and window < 20
    np.testing.assert_allclose(one.vector(), expected, rtol=1e-9, atol=1e-12)


def test_frames_of_another_rate_are_laid_on_bus_ticks():
    """A fish of constant velocity has that velocity whatever the camera's rate."""
    for rate in (30.0, 60.0, 47.3):
        t = np.arange(12) / rate
        one = seen(np.stack([0.2 * t, -0.1 * t, 0.5 * t], -1), step=1 / rate)
        yaw = 0.5 * t[-1]
        c, s = np.cos(yaw), np.sin(yaw)
        np.testing.assert_allclose(one.vector()[2:5], [0.2 * c - 0.1 * s, -0.1 * c - 0.2 * s, 0.5], atol=1e-9)


def test_the_vector_is_absent_until_poses_and_joints_reach_back_far_enough():
    t = np.arange(ROBOT.timing.velocity_window - 1) * DT
    assert seen(swimming(t)).vector() is None
    t = np.arange(ROBOT.timing.velocity_window) * DT
    assert seen(swimming(t)).vector() is not None
    one = ObservationBuilder(ROBOT, TARGET)
    for k, pose in enumerate(swimming(t)):
        one.fix(fix(k * DT, *pose), k * DT)
    assert one.vector() is None


def test_an_older_fix_is_dropped_and_a_jump_is_refused_until_it_is_over():
    one = seen(swimming(np.arange(10) * DT))
    newest = one.pose
    assert one.fix(fix(newest.t - 0.01), 6.0) is None and one.late == 1 and not one.jumped
    assert one.fix(fix(newest.t + DT, newest.x + 0.3, newest.y, newest.yaw), 6.0) is None
    assert one.jumped and one.pose is newest
    assert one.fix(fix(newest.t + 2 * DT, newest.x, newest.y, newest.yaw + 2.5), 6.0) is None and one.jumps == 2
    assert one.fix(fix(newest.t + 3 * DT, newest.x + 0.01, newest.y, newest.yaw), 6.0) is not None
    assert not one.jumped


@pytest.mark.parametrize("bad", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (0.0, 0.0, np.nan)])
def test_a_fix_that_is_no_number_is_refused(bad):
    one = seen(swimming(np.arange(10) * DT))
    assert one.fix(fix(9.0, *bad), 9.0) is None and one.jumped
    assert np.isfinite(one.vector()).all()


def test_the_first_fix_must_be_finite_too():
    one = ObservationBuilder(ROBOT, TARGET)
    assert one.fix(fix(1.0, np.nan), 1.0) is None and one.pose is None


def test_a_robot_that_began_anew_gives_no_rates_across_its_restart():
    one = seen(swimming(np.arange(10) * DT))
    for t, angle in ((50.0, 0.0), (50.02, 0.1), (50.04, 0.2), (0.0, 1.0), (0.02, 1.0)):
        one.telemetry(t, Telemetry((angle,) * 3, time=t))
    assert one.joints() is None
    one.telemetry(0.04, Telemetry((1.0,) * 3, time=0.04))
    np.testing.assert_allclose(one.joints()[1], 0.0)


def test_rates_come_from_the_robots_stamps_where_it_has_a_clock():
    one = ObservationBuilder(ROBOT, TARGET)
    for k, late in enumerate((0.0, 0.013, 0.002)):
        one.telemetry(7.0 + k * DT + late, Telemetry((0.4 * k,) * 3, time=k * DT))
    np.testing.assert_allclose(one.joints()[1], 0.4 / DT)


def test_commands_stay_in_range_and_within_reach_of_the_measured_joint():
    limit = Limiter(1.0, ahead=0.08, rate=5.0)
    rng = np.random.default_rng(3)
    for _ in range(500):
        wanted, measured, age = rng.uniform(-3, 3, 3), rng.uniform(-1.2, 1.2, 3), rng.uniform(0, 0.1)
        allowed, far = limit(wanted, measured, age), 5.0 * (age + 0.08)
        assert (np.abs(allowed) <= 1.0 + 1e-12).all()
        inside = np.abs(measured) <= 1.0
        assert (np.abs(allowed - measured)[inside] <= far + 1e-12).all()
        between = (np.abs(wanted) <= 1.0) & (np.abs(wanted - measured) <= far)
        assert np.allclose(allowed[between], wanted[between])
    assert limit.acted > 100
    before = limit.acted
    limit(np.zeros(3), np.zeros(3), 0.0)
    assert limit.acted == before


def test_the_lead_does_not_grow_with_a_reading_that_comes_no_more():
    limit = Limiter(100.0, ahead=0.08, rate=5.0, oldest=0.3)
    far = [limit(np.full(3, 99.0), np.zeros(3), age)[0] for age in (0.1, 0.3, 2.0)]
    np.testing.assert_allclose(far, [5.0 * 0.18, 5.0 * 0.38, 5.0 * 0.38])


def test_the_way_to_zero_is_even_and_ends_there():
    at, steps = np.array([1.0, -0.5, 0.003]), 0
    while at.any():
        after = towards_zero(at, DT)
        assert (np.abs(after - at) <= 1.047 * DT + 1e-12).all() and (np.abs(after) <= np.abs(at)).all()
        at, steps = after, steps + 1
    assert steps == pytest.approx(1.0 / 1.047 / DT, abs=1)
