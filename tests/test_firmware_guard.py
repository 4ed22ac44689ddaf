"""The firmware's guard finds the faults of the reference, and its counts are those of the host."""

import ctypes
import math
import random

import pytest
from firmware_library import CBounds, CGuard, firmware, floats, microseconds, needs_compiler

from fishmj.base.errors import FishmjError
from fishmj.deploy.protocols import servo_counts
from fishmj.deploy.protocols.firmware_guard import Bounds, Guard
from fishmj.deploy.protocols.messages import ServoFault

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler


def test_the_default_bounds_are_the_same(firmware):
    ours = Bounds()
    wanted = {
        "far_off": ours.far, "still": ours.still, "stuck_us": microseconds(ours.stuck), "hot": ours.hot, "low": ours.low,
        "sag_us": microseconds(ours.sag),
    }  # fmt: skip
    assert firmware.fj_default_bounds().values() == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    "bad", [{"far_off": 0.0}, {"still": -1.0}, {"stuck_us": 0}, {"hot": math.nan}, {"low": 0.0}, {"sag_us": 0}]
)
def test_bounds_that_cannot_be_are_refused(firmware, bad):
    fine = firmware.fj_default_bounds().values()
    guard = ctypes.byref(CGuard())
    assert firmware.fj_guard_init(guard, 3, CBounds(**fine)) and not firmware.fj_guard_init(guard, 9, CBounds(**fine))
    assert not firmware.fj_guard_init(guard, 3, CBounds(**(fine | bad)))


@pytest.mark.parametrize("seed", range(3))
def test_c_and_python_find_the_same_faults(firmware, seed):
    rng, python, held = random.Random(seed), Guard(3), CGuard()
    assert firmware.fj_guard_init(ctypes.byref(held), 3, firmware.fj_default_bounds())
    ticks, found = 0, ServoFault.NONE
    target = measured = (0.0, 0.0, 0.0)
    for number in range(3_000):
        ticks += rng.choice([20_000, 20_000, 20_000, 100_000, 5_000])
        if rng.random() < 0.05:
            target = None if rng.random() < 0.2 else tuple(rng.uniform(-0.6, 0.6) for _ in range(3))
        if rng.random() < 0.1:
            measured = tuple(math.nan if rng.random() < 0.1 else rng.uniform(-0.6, 0.6) for _ in range(3))
        measured = tuple(angle + rng.uniform(-0.004, 0.004) for angle in measured)
        degrees = None if rng.random() < 0.2 else tuple(rng.choice([-20, 25, 74, 75, 76]) for _ in range(3))
        volts = None if rng.random() < 0.01 else 7.0 if number // 100 % 2 or rng.random() < 0.01 else rng.uniform(5.0, 6.39)
        fault = (ctypes.c_uint8 * 8)(ServoFault.LOCKED)
        told = python.check(ticks / 1e6, target, measured, degrees, volts)
        firmware.fj_guard_check(
            ctypes.byref(held), ticks, None if target is None else floats(target), floats(measured),
            None if degrees is None else (ctypes.c_int8 * 3)(*degrees), math.nan if volts is None else volts, fault,
        )  # fmt: skip
        assert list(fault[:3]) == [told[0] | ServoFault.LOCKED, *told[1:]], "and what the servos said stays"
        found |= told[0]
    assert found == ServoFault.STUCK | ServoFault.HOT | ServoFault.VOLTAGE


def test_counts_are_those_of_the_host(firmware):
    rng = random.Random(0)
    for _ in range(3_000):
        angle, zero = (ctypes.c_float(rng.uniform(-most, most)).value for most in (3.0, 0.3))
        exact = servo_counts.LX.centre + (angle + zero) / servo_counts.RAD_PER_COUNT
        if abs(exact % 1 - 0.5) > 1e-3:  # where single precision cannot tell the nearer one, either is right
            assert firmware.lx_counts(angle, zero) == servo_counts.counts(angle, zero)
        position = rng.randrange(-125, 1126)
        assert firmware.lx_angle(position, zero) == pytest.approx(servo_counts.angle(position, zero), abs=1e-6)
        speed = rng.choice([1e-6, 0.5, 2.0, 5.0])
        assert abs(firmware.lx_move_time(angle, speed) - servo_counts.move_time(angle, speed)) <= 1


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf])
def test_an_angle_that_is_none_has_no_count(firmware, angle):
    with pytest.raises(FishmjError):
        servo_counts.counts(angle)
    assert firmware.lx_counts(angle, 0.0) == firmware.lx_move_time(angle, 1.0) == firmware.lx_move_time(1.0, 0.0) == -1
