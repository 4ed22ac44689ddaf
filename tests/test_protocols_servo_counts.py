"""Counts, mV and offsets of servos against SI."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fishmj.deploy.protocols import servo_counts
from fishmj.deploy.protocols.protocol_error import ProtocolError

ZERO = st.floats(-0.2, 0.2)


def test_the_ends_are_120_deg_from_the_middle():
    assert servo_counts.angle(0) == pytest.approx(math.radians(-120))
    assert servo_counts.angle(1000) == pytest.approx(math.radians(120))
    assert servo_counts.angle(500) == 0.0


def test_a_servo_that_stands_at_510_when_straight_has_a_zero_of_2_4_deg():
    zero = math.radians(2.4)
    assert servo_counts.counts(0.0, zero) == 510 and servo_counts.angle(510, zero) == pytest.approx(0.0, abs=1e-12)


@given(st.integers(0, 1000), ZERO)
def test_each_position_comes_back(position, zero):
    assert servo_counts.counts(servo_counts.angle(position, zero), zero) == position


@given(st.floats(-1.8, 1.8), ZERO)
def test_an_angle_comes_back_to_half_a_count(angle, zero):
    assert abs(servo_counts.angle(servo_counts.counts(angle, zero), zero) - angle) <= 0.5001 * servo_counts.RAD_PER_COUNT


@given(st.floats(-10, 10))
def test_angles_beyond_the_servo_end_at_its_ends(angle):
    assert 0 <= servo_counts.counts(angle) <= 1000


def test_a_move_takes_distance_over_speed():
    assert servo_counts.move_time(0.5, 2.0) == 250
    assert servo_counts.move_time(-0.5, 2.0) == 250
    assert servo_counts.move_time(3.0, 1e-6) == 30_000


@pytest.mark.parametrize(
    "call",
    [
        lambda: servo_counts.counts(math.nan),
        lambda: servo_counts.counts(math.inf),
        lambda: servo_counts.move_time(0.1, 0.0),
        lambda: servo_counts.move_time(math.nan, 1.0),
    ],
)
def test_values_that_no_servo_knows_are_refused(call):
    with pytest.raises(ProtocolError):
        call()
