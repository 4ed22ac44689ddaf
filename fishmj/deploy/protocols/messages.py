"""Messages between host and robot, in SI units, for any protocol.

A protocol converts these values to bytes and back (`mish` and `fishmj1` beside this file). A value that a protocol lacks is None,
never made up: the reader must decide on a robot without it.
"""

from enum import IntEnum, IntFlag
from typing import NamedTuple


class RobotState(IntEnum):
    """State of the robot's own firmware."""

    IDLE = 0  # servos without torque, commands are not taken
    ARMED = 1  # commands are taken
    HOLD = 2  # no command for `hold` seconds: the last angles stay
    NEUTRAL = 3  # none for `neutral` seconds, or a fault: joints go to zero slowly, then lose torque; leaves only by DISARM


class ServoFault(IntFlag):
    """Faults of a bus servo, bit by bit as LX servos number them; NO_REPLY and STUCK are the firmware's own.

    The firmware also sets HOT and VOLTAGE if its guard (`firmware_guard.py`) finds a servo hot or the battery low.
    """

    NONE = 0
    HOT = 1
    VOLTAGE = 2
    LOCKED = 4
    NO_REPLY = 8
    STUCK = 16


class Telemetry(NamedTuple):
    """One packet of the robot. J joints, from the head to the tail."""

    joint: tuple[float, ...]  # rad, (J,)
    seq: int | None = None  # number of this packet
    time: float | None = None  # s, the robot's clock
    echo: int | None = None  # number of the newest command that the robot took
    echo_time: float | None = None  # s, the host's clock when that command was sent
    state: RobotState | None = None
    voltage: float | None = None  # V, battery lead (INA226)
    current: float | None = None  # A, battery lead (INA226)
    servo_voltage: tuple[float, ...] | None = None  # V, (J,)
    temperature: tuple[float, ...] | None = None  # deg C, (J,)
    fault: tuple[ServoFault, ...] | None = None  # (J,)


class RobotInfo(NamedTuple):
    """Identification of the robot, needed before it may be armed."""

    firmware: str  # name and version
    firmware_sha256: str  # hex digest
    servo_ids: tuple[int, ...]  # on the bus, from the head to the tail
    joints: tuple[str, ...]  # names in the same order
    servo_range: float  # rad, commands are clamped to +- this
    hold: float  # s without a command until HOLD
    neutral: float  # s without a command until NEUTRAL
    policy_sha256: str = ""  # of a policy in the firmware, "" for none
