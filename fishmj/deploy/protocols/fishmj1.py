"""fishmj-1: the datagram between host and robot. Little-endian, one message in each, at most 272 bytes.

    magic "FJ" | version u8 | kind u8 | joints u8 | 0 u8 | length u16 | seq u32 | time u64 | payload[length] | crc32 u32

`seq` numbers the sender's datagrams and wraps at 2^32; `time` is the sender's clock in us. The checksum is CRC-32 as in Ethernet
and zip (`zlib.crc32`), over all bytes before it. Every message has exactly one encoding; all other bytes are refused.
Byte table, with what each kind carries: docs/tank/protocols.md. The C code of `firmware/fishmj1.c` gives the same bytes.
"""

import math
import re
import struct
import zlib
from collections.abc import Sequence
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

from fishmj.base.names import is_name
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError

MAGIC, VERSION = b"FJ", 1
HEADER, CRC = struct.Struct("<2sBBBBHIQ"), struct.Struct("<I")
ARM, INFO, TELEMETRY, JOINT = (
    struct.Struct("<II"),
    struct.Struct("<IIf32s32s32s"),
    struct.Struct("<BBHIQff"),
    struct.Struct("<fHbB"),
)
TEXT, NAME = 32, 16  # bytes of the firmware's name and of a joint's, zeros behind
MOST_JOINTS = 8
MOST_BYTES = 272  # of a datagram: INFO of eight joints
MOST_ANGLE = 3.1415927410125732  # rad, of any joint: pi as a float32, so that what is sent can be read back
MOST_SPEED = 50.0  # rad/s, of any joint
MOST_VOLTAGE = 41.0  # V; full scale of an INA226's bus register is 2^15 x 1.25 mV = 40.96 V
MOST_CURRENT = 100.0  # A
MOST_WAIT = 60.0  # s, of watchdog times; what a firmware takes is shorter (`watchdog.LONGEST`)
MOST_TIME = 1 << 50  # us, 35 years: a float64 of seconds brings each microsecond back up to here
_SEQ = 1 << 32


class Kind(IntEnum):
    """Kinds of datagrams."""

    HELLO = 1  # host -> robot: who are you? Answered by INFO
    ARM = 2  # host -> robot: take commands, with these watchdog times. Answered by INFO
    DISARM = 3  # host -> robot: torque off
    COMMAND = 4  # host -> robot: joint angles
    TELEMETRY = 5  # robot -> host: what is measured
    INFO = 6  # robot -> host: what the robot is


class FieldFlags(IntFlag):
    """Flags of the present parts of TELEMETRY; the bytes of the others are zero."""

    ECHO = 1
    POWER = 2
    SERVO_VOLTAGE = 4
    TEMPERATURE = 8
    FAULT = 16


class WatchdogTimes(NamedTuple):
    """Watchdog times in ARM, in s without a command."""

    hold: float
    neutral: float


class CommandMessage(NamedTuple):
    """Content of COMMAND: angles, rad, (J,); speeds, rad/s, (J,), None: the firmware's maximum."""

    joint: tuple[float, ...]
    speed: tuple[float, ...] | None = None


class Message(NamedTuple):
    """A datagram. value: WatchdogTimes, CommandMessage, Telemetry, RobotInfo; None of HELLO, DISARM. time: s of the sender."""

    kind: Kind
    seq: int
    time: float
    value: Any


def encode_hello(seq: int, time: float) -> bytes:
    """Request to identify. seq: number of the datagram. time: s, the host's clock. Raises ProtocolError."""
    return _frame(Kind.HELLO, seq, time, 0, b"")


def encode_arm(seq: int, time: float, hold: float, neutral: float) -> bytes:
    """Request to take commands, with the watchdog's times `hold` and `neutral`, s without a command. Raises ProtocolError."""
    return _frame(Kind.ARM, seq, time, 0, ARM.pack(*_watch(hold, neutral)))


def encode_disarm(seq: int, time: float) -> bytes:
    """Request to switch torque off. Raises ProtocolError."""
    return _frame(Kind.DISARM, seq, time, 0, b"")


def encode_command(seq: int, time: float, joint: Sequence[float], speed: Sequence[float] | None = None) -> bytes:
    """Command of joint angles.

    Args:
        joint: rad, (J,), from the head to the tail. speed: largest speed of each, rad/s, (J,); None: the firmware's maximum.

    Raises ProtocolError: a value is not finite or out of range, or the counts differ.
    """
    angles = [_angle(value, f"joint {k}") for k, value in enumerate(joint)]
    speeds = [] if speed is None else [_within(value, 0.0, MOST_SPEED, f"speed {k}", "rad/s") for k, value in enumerate(speed)]
    if speed is not None and len(speeds) != len(angles):
        raise ProtocolError(
            f"command of {len(angles)} joints and {len(speeds)} speeds; expected as many speeds as joints, or None"
        )
    payload = struct.pack(f"<{len(angles) + len(speeds)}f", *angles, *speeds)
    if speeds and min(struct.unpack(f"<{len(speeds)}f", payload[4 * len(angles) :])) <= 0.0:
        raise ProtocolError(
            f"speeds {tuple(speeds)} rad/s; expected above 0; leave them out to move as fast as the firmware lets it"
        )
    return _frame(Kind.COMMAND, seq, time, len(angles), payload)


def encode_info(seq: int, time: float, info: RobotInfo) -> bytes:
    """The robot's identification. time: s, the robot's clock. Raises ProtocolError if a value does not fit."""
    count = len(info.joints)
    if len(info.servo_ids) != count:
        raise ProtocolError(f"info with {len(info.servo_ids)} servo ids and {count} joints; expected as many ids as joints")
    payload = INFO.pack(
        *_watch(info.hold, info.neutral),
        _range(info.servo_range),
        _text(info.firmware, TEXT, "firmware"),
        _digest(info.firmware_sha256, "firmware_sha256"),
        _digest(info.policy_sha256, "policy_sha256"),
    )
    ids = bytes(_whole(number, 253, f"servo id of joint {k}") for k, number in enumerate(info.servo_ids))
    if len(set(ids)) != count or len(set(info.joints)) != count:
        raise ProtocolError(f"servo ids {info.servo_ids}, joints {info.joints}; expected each of them once")
    names = b"".join(_text(name, NAME, f"name of joint {k}") for k, name in enumerate(info.joints))
    return _frame(Kind.INFO, seq, time, count, payload + ids + names)


def encode_telemetry(telemetry: Telemetry) -> bytes:
    """Telemetry of the robot. Voltages of servos are sent in mV, temperatures in whole deg C.

    Raises ProtocolError: seq, time or state is None; a value is not finite or out of range; counts differ; one of echo and
    echo_time, or of voltage and current, is there without the other.
    """
    it = telemetry
    if it.seq is None or it.time is None or it.state is None:
        raise ProtocolError(f"telemetry with seq {it.seq}, time {it.time}, state {it.state}; fishmj-1 carries all three")
    has = FieldFlags(0)
    for one, other, bit in ((it.echo, it.echo_time, FieldFlags.ECHO), (it.voltage, it.current, FieldFlags.POWER)):
        if (one is None) != (other is None):
            raise ProtocolError(f"telemetry with {bit.name} {one}, {other}; expected both or none")
        has |= FieldFlags(0) if one is None else bit
    count = len(it.joint)
    for row, bit in (
        (it.servo_voltage, FieldFlags.SERVO_VOLTAGE),
        (it.temperature, FieldFlags.TEMPERATURE),
        (it.fault, FieldFlags.FAULT),
    ):
        if row is not None and len(row) != count:
            raise ProtocolError(f"telemetry of {count} joints with {bit.name} of {len(row)}; expected one a joint")
        has |= FieldFlags(0) if row is None else bit
    head = TELEMETRY.pack(
        _whole(it.state, max(RobotState), "state"),
        has,
        0,
        _whole(0 if it.echo is None else it.echo, _SEQ - 1, "echo"),
        _ticks(0.0 if it.echo_time is None else it.echo_time, "echo_time"),
        _within(0.0 if it.voltage is None else it.voltage, 0.0, MOST_VOLTAGE, "voltage", "V"),
        _within(0.0 if it.current is None else it.current, -MOST_CURRENT, MOST_CURRENT, "current", "A"),
    )
    rows = zip(it.joint, it.servo_voltage or [0.0] * count, it.temperature or [0.0] * count, it.fault or [0] * count, strict=True)
    body = b"".join(
        JOINT.pack(
            _angle(angle, f"joint {k}"),
            round(_within(volts, 0.0, 65.535, f"voltage of servo {k}", "V") * 1000),
            round(_within(degrees, -128.0, 127.0, f"temperature of servo {k}", "deg C")),
            _whole(fault, _FAULTS, f"fault of servo {k}"),
        )
        for k, (angle, volts, degrees, fault) in enumerate(rows)
    )
    return _frame(Kind.TELEMETRY, it.seq, it.time, count, head + body)


def clamped_to_wire_range(telemetry: Telemetry, last: Sequence[float]) -> Telemetry:
    """The telemetry clamped to the wire's range, so that the host receives a packet for any measurement.

    Args:
        telemetry: with all faults. last: angle of each joint at its servo's last answer, rad, (J,).

    Returns:
        A joint without an angle (nan, beyond +- pi) has its last angle and NO_REPLY. A voltage or a current beyond the range is
        clamped; if one of them is nan, both are None.
    """
    it, angles, faults = telemetry, list(telemetry.joint), list(telemetry.fault or (ServoFault.NONE,) * len(telemetry.joint))
    for k, angle in enumerate(angles):
        if not abs(angle) <= MOST_ANGLE:
            angles[k], faults[k] = last[k], faults[k] | ServoFault.NO_REPLY
    volts, amperes = it.voltage, it.current
    if volts is None or amperes is None or math.isnan(volts + amperes):
        volts = amperes = None
    else:
        volts, amperes = max(0.0, min(MOST_VOLTAGE, volts)), max(-MOST_CURRENT, min(MOST_CURRENT, amperes))
    return it._replace(joint=tuple(angles), fault=tuple(faults), voltage=volts, current=amperes)


def decode(data: bytes) -> Message:
    """The message in one datagram.

    Raises ProtocolError: for any bytes that are not exactly one message; no other error occurs.
    """
    if not HEADER.size + CRC.size <= len(data) <= MOST_BYTES:
        raise ProtocolError(f"datagram of {len(data)} bytes; expected {HEADER.size + CRC.size} to {MOST_BYTES}")
    magic, version, kind, joints, zero, length, seq, ticks = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise ProtocolError(f"datagram begins with {magic!r}; expected {MAGIC!r}: this is no fishmj datagram")
    if version != VERSION:
        raise ProtocolError(f"datagram of version {version}; expected {VERSION}: update the robot's firmware or fishmj")
    if len(data) != HEADER.size + length + CRC.size:
        raise ProtocolError(
            f"datagram of {len(data)} bytes says {length} of payload; expected {len(data) - HEADER.size - CRC.size}"
        )
    (said,), found = CRC.unpack_from(data, len(data) - CRC.size), zlib.crc32(data[: -CRC.size])
    if said != found:
        raise ProtocolError(f"checksum {said:08x}; expected {found:08x}: the datagram is damaged")
    if kind not in _READERS:
        raise ProtocolError(f"datagram of kind {kind}; expected {', '.join(f'{k.value} {k.name}' for k in Kind)}")
    if zero:
        raise ProtocolError(f"byte 5 is {zero}; expected 0")
    if ticks > MOST_TIME:
        raise ProtocolError(f"time {ticks} us; expected at most {MOST_TIME}")
    least, most = (1, MOST_JOINTS) if kind in _OF_JOINTS else (0, 0)
    if not least <= joints <= most:
        raise ProtocolError(f"{Kind(kind).name} of {joints} joints; expected {least} to {most}")
    payload = bytes(data[HEADER.size : -CRC.size])
    return Message(Kind(kind), seq, ticks / 1e6, _READERS[Kind(kind)](payload, joints, seq, ticks / 1e6))


def _nothing(payload: bytes, joints: int, seq: int, time: float) -> None:
    _size(payload, (0,), "HELLO or DISARM")


def _read_arm(payload: bytes, joints: int, seq: int, time: float) -> WatchdogTimes:
    _size(payload, (ARM.size,), "ARM")
    return _waits(*ARM.unpack(payload))


def _read_command(payload: bytes, joints: int, seq: int, time: float) -> CommandMessage:
    _size(payload, (4 * joints, 8 * joints), "COMMAND")
    values = struct.unpack(f"<{len(payload) // 4}f", payload)
    angles = tuple(_angle(value, f"joint {k}") for k, value in enumerate(values[:joints]))
    speeds = tuple(_within(value, 0.0, MOST_SPEED, f"speed {k}", "rad/s") for k, value in enumerate(values[joints:]))
    if speeds and min(speeds) <= 0.0:
        raise ProtocolError(f"speeds {speeds} rad/s; expected above 0")
    return CommandMessage(angles, speeds or None)


def _read_telemetry(payload: bytes, joints: int, seq: int, time: float) -> Telemetry:
    _size(payload, (TELEMETRY.size + JOINT.size * joints,), "TELEMETRY")
    state, bits, zero, echo, echo_ticks, voltage, current = TELEMETRY.unpack_from(payload)
    if state > max(RobotState) or bits > sum(FieldFlags) or zero:
        raise ProtocolError(f"telemetry with state {state}, parts {bits}, reserved {zero}; expected at most 3, 31 and 0")
    has = FieldFlags(bits)
    rows = [JOINT.unpack_from(payload, TELEMETRY.size + JOINT.size * k) for k in range(joints)]
    blank = {FieldFlags.ECHO: payload[4:16], FieldFlags.POWER: payload[16:24]}
    for part, bit in (
        (slice(4, 6), FieldFlags.SERVO_VOLTAGE),
        (slice(6, 7), FieldFlags.TEMPERATURE),
        (slice(7, 8), FieldFlags.FAULT),
    ):
        blank[bit] = b"".join(payload[TELEMETRY.size + JOINT.size * k :][part] for k in range(joints))
    if filled := [str(bit.name) for bit, part in blank.items() if bit not in has and any(part)]:
        raise ProtocolError(f"telemetry says that it has no {', '.join(filled)}, and its bytes are not zero")
    if echo_ticks > MOST_TIME:
        raise ProtocolError(f"echo_time {echo_ticks} us; expected at most {MOST_TIME}")
    if max(row[3] for row in rows) > _FAULTS:
        raise ProtocolError(f"faults {tuple(row[3] for row in rows)}; expected at most {_FAULTS}")
    volts, amperes = (
        _within(voltage, 0.0, MOST_VOLTAGE, "voltage", "V"),
        _within(current, -MOST_CURRENT, MOST_CURRENT, "current", "A"),
    )
    return Telemetry(
        joint=tuple(_angle(row[0], f"joint {k}") for k, row in enumerate(rows)),
        seq=seq,
        time=time,
        echo=echo if FieldFlags.ECHO in has else None,
        echo_time=echo_ticks / 1e6 if FieldFlags.ECHO in has else None,
        state=RobotState(state),
        voltage=volts if FieldFlags.POWER in has else None,
        current=amperes if FieldFlags.POWER in has else None,
        servo_voltage=tuple(row[1] / 1000 for row in rows) if FieldFlags.SERVO_VOLTAGE in has else None,
        temperature=tuple(float(row[2]) for row in rows) if FieldFlags.TEMPERATURE in has else None,
        fault=tuple(ServoFault(row[3]) for row in rows) if FieldFlags.FAULT in has else None,
    )


def _read_info(payload: bytes, joints: int, seq: int, time: float) -> RobotInfo:
    _size(payload, (INFO.size + (1 + NAME) * joints,), "INFO")
    hold, neutral, servo_range, firmware, firmware_hash, policy_hash = INFO.unpack_from(payload)
    ids, names = payload[INFO.size : INFO.size + joints], payload[INFO.size + joints :]
    joint_names = tuple(_read_text(names[NAME * k : NAME * (k + 1)], f"name of joint {k}") for k in range(joints))
    if len(set(ids)) != joints or max(ids) > 253 or len(set(joint_names)) != joints:
        raise ProtocolError(f"servo ids {tuple(ids)}, joints {joint_names}; expected each of them once, ids at most 253")
    return RobotInfo(
        firmware=_read_text(firmware, "firmware"),
        firmware_sha256=firmware_hash.hex() if any(firmware_hash) else "",
        servo_ids=tuple(ids),
        joints=joint_names,
        servo_range=_range(servo_range),
        hold=_waits(hold, neutral).hold,
        neutral=_waits(hold, neutral).neutral,
        policy_sha256=policy_hash.hex() if any(policy_hash) else "",
    )


_READERS = {
    Kind.HELLO: _nothing, Kind.ARM: _read_arm, Kind.DISARM: _nothing, Kind.COMMAND: _read_command,
    Kind.TELEMETRY: _read_telemetry, Kind.INFO: _read_info,
}  # fmt: skip
_OF_JOINTS = (Kind.COMMAND, Kind.TELEMETRY, Kind.INFO)
_FAULTS = int(sum(ServoFault))


def _frame(kind: Kind, seq: int, time: float, joints: int, payload: bytes) -> bytes:
    least, most = (1, MOST_JOINTS) if kind in _OF_JOINTS else (0, 0)
    if not least <= joints <= most:
        raise ProtocolError(f"{kind.name} of {joints} joints; expected {least} to {most}")
    number, ticks = _whole(seq, _SEQ - 1, "seq"), _ticks(time, "time")
    data = HEADER.pack(MAGIC, VERSION, kind, joints, 0, len(payload), number, ticks) + payload
    return data + CRC.pack(zlib.crc32(data))


def _size(payload: bytes, sizes: tuple[int, ...], what: str) -> None:
    if len(payload) not in sizes:
        raise ProtocolError(f"{what} with {len(payload)} bytes of payload; expected {' or '.join(str(size) for size in sizes)}")


def _within(value: float, low: float, high: float, what: str, unit: str) -> float:
    if not low <= value <= high:  # nan is not, either
        raise ProtocolError(f"{what} {value} {unit}; expected {low:g} to {high:g}")
    return float(value)


def _angle(value: float, what: str) -> float:
    return _within(value, -MOST_ANGLE, MOST_ANGLE, what, "rad")


def _range(value: float) -> float:
    if value <= 0.0:
        raise ProtocolError(f"servo_range {value} rad; expected above 0 to {MOST_ANGLE:g}")
    return _within(value, 0.0, MOST_ANGLE, "servo_range", "rad")


def _whole(value: int, most: int, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise ProtocolError(f"{what} {value!r}; expected a whole number, 0 to {most}")
    return int(value)


def _ticks(seconds: float, what: str) -> int:
    return round(_within(seconds, 0.0, MOST_TIME / 1e6, what, "s") * 1e6)


def _watch(hold: float, neutral: float) -> tuple[int, int]:
    _waits(round(_within(hold, 0.0, MOST_WAIT, "hold", "s") * 1e6), round(_within(neutral, 0.0, MOST_WAIT, "neutral", "s") * 1e6))
    return round(hold * 1e6), round(neutral * 1e6)


def _waits(hold: int, neutral: int) -> WatchdogTimes:
    if not 0 < hold < neutral <= MOST_WAIT * 1e6:
        raise ProtocolError(
            f"watchdog times hold {hold / 1e6:g} s, neutral {neutral / 1e6:g} s; expected 0 < hold < neutral <= {MOST_WAIT:g} s"
        )
    return WatchdogTimes(hold / 1e6, neutral / 1e6)


def _digest(text: str, what: str) -> bytes:
    if text == "":
        return bytes(32)
    if not isinstance(text, str) or not re.fullmatch(r"[0-9a-f]{64}", text) or text == "0" * 64:
        raise ProtocolError(f"{what} {text!r}; expected 64 hex digits, or '' for none")
    return bytes.fromhex(text)


def _text(text: str, size: int, what: str) -> bytes:
    if not is_name(text) or len(text) > size:
        raise ProtocolError(f"{what} {text!r}; expected 1 to {size} letters, digits, '_', '.' or '-', the first of them no '-'")
    return text.encode("ascii").ljust(size, b"\0")


def _read_text(raw: bytes, what: str) -> str:
    text, pad = raw.rstrip(b"\0"), raw[len(raw.rstrip(b"\0")) :]
    if any(pad) or not text.isascii() or not is_name(text.decode("ascii")):
        raise ProtocolError(f"{what} {raw!r}; expected letters, digits, '_', '.' or '-', then zeros")
    return text.decode("ascii")
