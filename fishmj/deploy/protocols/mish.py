"""The open robot's UDP layout as its firmware publishes it, and that firmware's conversion of angles. Little-endian.

    robot -> host   <3i 3f 3f 3i   servo id, joint [rad], voltage at the servo [V], temperature [deg C]   every 20 ms, 48 bytes
    host -> robot   <6f            joint [rad], speed [rad/s], 0 = as fast as it can                        24 bytes

Neither has a number, a time or a checksum. So an old datagram looks like a new one, and the robot keeps the last angle for ever
when the host falls silent: `LACKS`. A host that uses it has to ask a person before it arms.

Firmware 0.1.0 converts with whole numbers: 1000 / 240 is 4 instead of 4.17 servo counts a degree, so the joint goes to 0.96 of
the requested angle; 240 / 1000 is 0, so each reading is zero. "fixed" is the same layout from a firmware that converts with
floating-point numbers; then only the servo's own steps of 0.24 deg remain.
"""

import math
import struct
from collections.abc import Sequence
from typing import Literal, NamedTuple

from fishmj.base.errors import UnknownName
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.servo_counts import RAD_PER_COUNT

Firmware = Literal["mish-0.1.0", "fixed"]
FIRMWARES: tuple[Firmware, ...] = ("mish-0.1.0", "fixed")
UPLINK, DOWNLINK = struct.Struct("<3i3f3f3i"), struct.Struct("<6f")
JOINTS = 3
ROBOT_PORT, HOST_PORT = 2333, 6060
SERVO_RANGE = 1.047  # rad, the firmware's own bound
SLOWEST, FASTEST = 0.05, 5.23  # rad/s, the firmware's bounds of a speed that is not 0
LACKS = (
    "sequence number",
    "robot time",
    "checksum",
    "echo",
    "state",
    "watchdog",
    "battery voltage and current",
    "servo faults",
    "info",
)
MOST_ANGLE = 3.1415927410125732  # rad, pi as a float32: what is sent can be read back
MOST_SPEED = 50.0  # rad/s
MOST_VOLTAGE = 64.0  # V; exact as a float32
MOST_TEMPERATURE = 255.0  # deg C, either way
ANGLES, SPEEDS = (-MOST_ANGLE, MOST_ANGLE, "joint"), (0.0, MOST_SPEED, "speed", " rad/s")  # what a packet may hold
VOLTAGES, TEMPERATURES = (0.0, MOST_VOLTAGE, "servo voltage", " V"), (-MOST_TEMPERATURE, MOST_TEMPERATURE, "temperature")
_INT_SCALE = 4  # counts a degree in 0.1.0: the whole part of 1000 / 240


class Downlink(NamedTuple):
    """Content of a command datagram: rad, (3,); rad/s, (3,), 0 = as fast as it can."""

    joint: tuple[float, ...]
    speed: tuple[float, ...]


def encode_command(joint: Sequence[float], speed: Sequence[float] | None = None) -> bytes:
    """A command. joint: rad, (3,). speed: rad/s, (3,), 0 or None: as fast as it can. Raises ProtocolError."""
    speeds = (0.0,) * JOINTS if speed is None else tuple(speed)
    if len(joint) != JOINTS or len(speeds) != JOINTS:
        raise ProtocolError(f"command of {len(joint)} joints and {len(speeds)} speeds; this robot has {JOINTS}")
    return DOWNLINK.pack(*_checked(joint, *ANGLES), *_checked(speeds, *SPEEDS))


def decode_command(data: bytes) -> Downlink:
    """The command in a datagram. Raises ProtocolError for any bytes that are no command, and no other error."""
    values = DOWNLINK.unpack(_sized(data, DOWNLINK.size, "command"))
    return Downlink(_checked(values[:3], *ANGLES), _checked(values[3:], *SPEEDS))


def encode_telemetry(telemetry: Telemetry, ids: Sequence[int], firmware: Firmware = "fixed") -> bytes:
    """The robot's telemetry: true joint angles, rad, as converted by `firmware`.

    Args:
        ids: of the servos, (3,). Without servo_voltage and temperature zeros are sent, as the robot does for a silent servo.

    Raises ProtocolError: other counts, or a value that is not finite or out of range; UnknownName: no such firmware.
    """
    it = telemetry
    volts, degrees = it.servo_voltage or (0.0,) * JOINTS, it.temperature or (0.0,) * JOINTS
    if {len(it.joint), len(ids), len(volts), len(degrees)} != {JOINTS}:
        raise ProtocolError(f"telemetry of {len(it.joint)} joints and {len(ids)} servo ids; this robot has {JOINTS} of each")
    read = [reading(angle, firmware) for angle in _checked(it.joint, *ANGLES)]
    whole = [round(value) for value in _checked(degrees, *TEMPERATURES)]
    return UPLINK.pack(*_ids(ids), *read, *_checked(volts, *VOLTAGES), *whole)


def decode_telemetry(data: bytes) -> Telemetry:
    """The telemetry in a datagram; values outside the layout are None.

    Raises ProtocolError: for any bytes that are no telemetry; no other error occurs.
    """
    values = UPLINK.unpack(_sized(data, UPLINK.size, "telemetry"))
    _ids(values[:3])
    degrees = _checked([float(value) for value in values[9:]], *TEMPERATURES)
    return Telemetry(_checked(values[3:6], *ANGLES), servo_voltage=_checked(values[6:9], *VOLTAGES), temperature=degrees)


def commanded(joint: float, firmware: Firmware = "fixed") -> float:
    """Servo angle, rad, that the firmware sends for the request `joint`, rad; without the servo's own zero."""
    bound = max(-SERVO_RANGE, min(SERVO_RANGE, joint))
    counts = int(math.degrees(bound) * _INT_SCALE) if _checked_name(firmware) == "mish-0.1.0" else round(bound / RAD_PER_COUNT)
    return counts * RAD_PER_COUNT


def reading(joint: float, firmware: Firmware = "fixed") -> float:
    """Angle, rad, that the firmware reports for a joint at `joint`, rad."""
    return 0.0 if _checked_name(firmware) == "mish-0.1.0" else round(joint / RAD_PER_COUNT) * RAD_PER_COUNT


def moved_at(speed: float) -> float | None:
    """Speed of the firmware's motion for the request `speed`, rad/s; None: the servo's maximum."""
    return None if speed == 0.0 else max(SLOWEST, min(FASTEST, abs(speed)))


def _checked_name(firmware: str) -> str:
    if firmware not in FIRMWARES:
        raise UnknownName("firmware", firmware, FIRMWARES)
    return firmware


def _sized(data: bytes, size: int, what: str) -> bytes:
    if len(data) != size:
        raise ProtocolError(f"{what} of {len(data)} bytes; expected {size}")
    return data


def _checked(values: Sequence[float], low: float, high: float, what: str, unit: str = "") -> tuple[float, ...]:
    if not all(low <= value <= high for value in values):  # nan is not, either
        raise ProtocolError(f"{what} {tuple(values)}; expected {low:g} to {high:g}{unit}")
    return tuple(float(value) for value in values)


def _ids(values: Sequence[int]) -> tuple[int, ...]:
    if not all(isinstance(value, int) and 0 <= value <= 253 for value in values):
        raise ProtocolError(f"servo ids {tuple(values)}; expected 0 to 253")
    return tuple(int(value) for value in values)
