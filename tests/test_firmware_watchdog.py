"""The firmware's watchdog takes every decision of the reference."""

import ctypes
import math

import pytest
from firmware_library import CLimits, CWatchdog, firmware, floats, microseconds, needs_compiler
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.deploy.protocols.messages import RobotState
from fishmj.deploy.protocols.watchdog import Limits, Watchdog

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler
SOME = st.floats(-4, 4) | st.sampled_from([math.nan, math.inf, -math.inf])
ROW = st.tuples(SOME, SOME, SOME)
CALM = st.tuples(*[st.floats(-1.2, 1.2)] * 3)
STRAIGHT = st.tuples(*[st.floats(-0.03, 0.03)] * 3)
MEASURED = CALM | STRAIGHT | st.tuples(*[st.floats(-1.2, 1.2) | st.sampled_from([math.nan, 3.5, -40.0])] * 3)
PASSED = st.integers(0, 200_000) | st.sampled_from([0, 20_000, 50_000, 100_000, 200_000, 300_000])  # us; at the edges, too
ACTS = st.one_of(
    st.tuples(st.just("arm"), st.sampled_from([0.1, 0.05, 0.3, 2.5]), st.sampled_from([0.3, 0.2, 2.0])),
    st.tuples(st.just("disarm")),
    st.tuples(st.just("fault")),
    *[st.tuples(st.just("command"), CALM, st.none() | st.tuples(*[st.floats(0.1, 8)] * 3))] * 3,
    st.tuples(st.just("command"), ROW, st.none() | ROW),
    st.tuples(st.just("silence")),
)


def test_the_default_limits_are_the_same(firmware):
    ours = Limits()
    wanted = {name: getattr(ours, name) for name in ("servo_range", "rate", "neutral_rate", "lead", "near")}
    wanted["rest_us"] = microseconds(ours.rest)
    assert firmware.fj_default_limits().values() == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    "bad",
    [{"rate": 0.0}, {"lead": -1.0}, {"servo_range": math.nan}, {"neutral_rate": math.inf}, {"near": 0.0}, {"rest_us": 0}],
)
def test_limits_that_cannot_be_are_refused(firmware, bad):
    fine = {"servo_range": 1.0, "rate": 5.0, "neutral_rate": 1.0, "lead": 0.5, "near": 0.1, "rest_us": 1}
    assert firmware.fj_watchdog_init(ctypes.byref(CWatchdog()), 3, CLimits(**fine), 100_000, 300_000)
    limits = CLimits(**(fine | bad))
    assert not firmware.fj_watchdog_init(ctypes.byref(CWatchdog()), 3, limits, 100_000, 300_000)


@settings(max_examples=120)
@given(steps=st.lists(st.tuples(ACTS, PASSED, MEASURED), min_size=1, max_size=40))
def test_c_and_python_take_the_same_decisions(firmware, steps):
    python, limits = Watchdog(3), firmware.fj_default_limits()
    held = CWatchdog()
    it = ctypes.byref(held)
    assert firmware.fj_watchdog_init(it, 3, limits, 100_000, 300_000)
    ticks = 0
    for act, passed, measured in steps:
        ticks += passed
        now, read = ticks / 1e6, floats(measured)
        if act[0] == "arm":
            answers = (
                firmware.fj_watchdog_arm(it, ticks, microseconds(act[1]), microseconds(act[2]), read),
                python.arm(now, act[1], act[2], measured),
            )
        elif act[0] == "command":
            joint, speed = act[1:]
            answers = (
                firmware.fj_watchdog_command(it, ticks, 3, floats(joint), None if speed is None else floats(speed)),
                python.command(now, joint, speed),
            )
        else:
            if act[0] != "silence":
                getattr(firmware, f"fj_watchdog_{act[0]}")(it)
                getattr(python, act[0])()
            answers = True, True
        assert answers[0] == answers[1]
        moves, target = firmware.fj_watchdog_step(it, ticks, read), python.step(now, measured)
        assert moves == (target is not None) and held.state == python.state and held.rested == python.rested
        assert (held.hold_us, held.neutral_us) == (microseconds(python.hold), microseconds(python.neutral))
        if target is not None:
            assert held.target[:3] == pytest.approx(target, abs=2e-6)


def test_hold_and_neutral_begin_at_the_same_microsecond(firmware):
    for silent in (99_999, 100_000, 299_999, 300_000):
        python, held = Watchdog(3), CWatchdog()
        it = ctypes.byref(held)
        assert firmware.fj_watchdog_init(it, 3, firmware.fj_default_limits(), 50_000, 60_000)
        assert firmware.fj_watchdog_arm(it, 7, 100_000, 300_000, floats((0.0,) * 3)) and python.arm(7e-6, 0.1, 0.3, (0.0,) * 3)
        firmware.fj_watchdog_step(it, 7 + silent, floats((0.0,) * 3))
        python.step((7 + silent) / 1e6, (0.0,) * 3)
        assert held.state == python.state == 1 + (silent >= 100_000) + (silent >= 300_000)


@pytest.mark.parametrize("measured", [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (math.nan, 0.0, 0.0)])
def test_the_torque_goes_off_at_the_same_step_of_neutral(firmware, measured):
    """Straight joints, a stuck one, a silent one: each 0.02 s of 8 s after a fault."""
    python, held, offs = Watchdog(3), CWatchdog(), []
    it = ctypes.byref(held)
    assert firmware.fj_watchdog_init(it, 3, firmware.fj_default_limits(), 100_000, 300_000)
    start = (0.5, 0.0, 0.0)
    assert firmware.fj_watchdog_arm(it, 0, 100_000, 300_000, floats(start)) and python.arm(0.0, 0.1, 0.3, start)
    firmware.fj_watchdog_fault(it)
    python.fault()
    for tick in range(1, 401):
        moves = firmware.fj_watchdog_step(it, 20_000 * tick, floats(measured))
        assert moves == (python.step(0.02 * tick, measured) is not None)
        offs += [] if moves else [tick]
    assert 20 < offs[0] < 300 and offs == list(range(offs[0], 401)) and held.state == RobotState.NEUTRAL


@pytest.mark.parametrize(
    ("angle", "armed"), [(60.0, True), (61.9, True), (-61.9, True), (62.1, False), (-62.1, False), (400.0, False)]
)
def test_both_arm_up_to_the_same_angle(firmware, angle, armed):
    measured, held, python = (0.0, math.radians(angle), 0.0), CWatchdog(), Watchdog(3)
    assert firmware.fj_watchdog_init(ctypes.byref(held), 3, firmware.fj_default_limits(), 100_000, 300_000)
    assert firmware.fj_watchdog_arm(ctypes.byref(held), 0, 100_000, 300_000, floats(measured)) == armed
    assert python.arm(0.0, 0.1, 0.3, measured) == armed
    assert held.state == python.state == (RobotState.ARMED if armed else RobotState.IDLE)
