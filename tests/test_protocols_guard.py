"""The guard of the robot's firmware: which faults it finds, and when."""

import math

import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.protocols.firmware_guard import Bounds, Guard
from fishmj.deploy.protocols.messages import ServoFault

AWAY, STRAIGHT = (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)
NONE, STUCK = ServoFault.NONE, ServoFault.STUCK


def first(guard: Guard, fault: ServoFault, ticks: int = 100, **reading) -> float | None:
    """s at which joint 0 has the fault first, a reading every 0.02 s."""
    for tick in range(ticks):
        values = {"target": STRAIGHT, "measured": STRAIGHT} | {k: v(tick) if callable(v) else v for k, v in reading.items()}
        if fault in guard.check(0.02 * tick, values.pop("target"), values.pop("measured"), **values)[0]:
            return 0.02 * tick
    return None


def test_a_joint_that_stays_away_from_its_target_is_stuck_after_its_time():
    guard = Guard(3)
    assert first(guard, STUCK, target=AWAY) == pytest.approx(Bounds().stuck)
    assert guard.check(0.5, AWAY, STRAIGHT) == (STUCK, NONE, NONE)
    assert guard.check(0.6, AWAY, (0.05, 0.0, 0.0))[0] is NONE, "it moves"


@pytest.mark.parametrize(
    "reading",
    [
        {"target": (0.15, 0.0, 0.0)},
        {"target": None},
        {"target": AWAY, "measured": (math.nan, 0.0, 0.0)},
        {"target": (1.0, 0.0, 0.0), "measured": lambda tick: (0.0075 * tick, 0.0, 0.0)},
    ],
    ids=["near its target", "without torque", "silent", "slow"],
)
def test_a_joint_is_not_stuck_that_is(reading):
    assert first(Guard(3), STUCK, **reading) is None


def test_hot_begins_at_its_bound_with_or_without_torque():
    assert Guard(3).check(0.0, None, STRAIGHT, (74.0, 75.0, 90.0)) == (NONE, ServoFault.HOT, ServoFault.HOT)


def test_a_battery_is_low_after_a_whole_second_without_a_reading_above():
    assert first(Guard(3), ServoFault.VOLTAGE, voltage=6.3) == pytest.approx(Bounds().sag)
    assert first(Guard(3), ServoFault.VOLTAGE, voltage=lambda tick: 7.0 if tick % 40 == 0 else 6.0) is None, "kicks"
    assert first(Guard(3), ServoFault.VOLTAGE, voltage=lambda tick: None if tick % 40 == 0 else 6.0) is None, "not read"
    assert first(Guard(3), ServoFault.VOLTAGE, voltage=6.4) is None


def test_what_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="joints"):
        Guard(0)
    with pytest.raises(ConfigError, match="above 0"):
        Bounds(low=math.nan)
