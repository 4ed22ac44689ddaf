"""Frames of LX-series bus servos (LX-16A, LX-224, LX-824): half-duplex UART, 115200 baud, 8N1.

    0x55 0x55 | id u8 | length u8 | code u8 | parameters | checksum u8
    length = 3 + number of parameter bytes,   checksum = ~(id + length + code + sum of parameters) mod 256

Words are little-endian. A read without parameters is the host's question; the same code with parameters is the servo's answer.
So the length alone gives the direction, and a reader can tell its own frames on the one wire from answers. An 8-bit sum misses
errors that keep the sum, such as two swapped bytes. So `TABLE` bounds lengths and values as well, and the host must compare id
and code. Byte table: docs/tank/protocols.md.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

from fishmj.deploy.protocols.frame_reader import FrameReader
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.servo_counts import MOST_OFFSET, MOST_TIME, SPAN, VOLTAGE
from fishmj.mjcf.servo_buses import BUSES

MOST_ID = BUSES["lx"].most_id
HEADER = b"\x55\x55"
BROADCAST = 254
MOST_BYTES = 10  # of a frame
MOST_POSITION = SPAN + MOST_OFFSET  # counts that a servo may report with its own offset


class Code(IntEnum):
    """Codes of frames, named as in the maker's table."""

    MOVE_TIME_WRITE = 1
    MOVE_TIME_READ = 2
    MOVE_TIME_WAIT_WRITE = 7
    MOVE_TIME_WAIT_READ = 8
    MOVE_START = 11
    MOVE_STOP = 12
    ID_WRITE = 13
    ID_READ = 14
    ANGLE_OFFSET_ADJUST = 17
    ANGLE_OFFSET_WRITE = 18
    ANGLE_OFFSET_READ = 19
    ANGLE_LIMIT_WRITE = 20
    ANGLE_LIMIT_READ = 21
    VIN_LIMIT_WRITE = 22
    VIN_LIMIT_READ = 23
    TEMP_MAX_LIMIT_WRITE = 24
    TEMP_MAX_LIMIT_READ = 25
    TEMP_READ = 26
    VIN_READ = 27
    POS_READ = 28
    OR_MOTOR_MODE_WRITE = 29
    OR_MOTOR_MODE_READ = 30
    LOAD_OR_UNLOAD_WRITE = 31
    LOAD_OR_UNLOAD_READ = 32
    LED_CTRL_WRITE = 33
    LED_CTRL_READ = 34
    LED_ERROR_WRITE = 35
    LED_ERROR_READ = 36


class LxField(NamedTuple):
    """A parameter. form: of `struct`, B u8, b i8, H u16, h i16. least, most: its range."""

    name: str
    form: str
    least: int
    most: int


class LxCode(NamedTuple):
    """The parameters of a code. asks: host -> servo. replies: servo -> host, () if the servo is silent."""

    asks: tuple[LxField, ...] = ()
    replies: tuple[LxField, ...] = ()


class LxFrame(NamedTuple):
    """A parsed frame. values: one for each field of `TABLE`, in counts, ms, mV, deg C. reply: a servo sent it."""

    servo: int
    code: Code
    values: tuple[int, ...]
    reply: bool


_POSITION, _TIME = LxField("position", "H", 0, SPAN), LxField("time_ms", "H", 0, MOST_TIME)
_ANGLES = (LxField("lowest", "H", 0, SPAN), LxField("highest", "H", 0, SPAN))
_VOLTS = (LxField("lowest_mv", "H", *VOLTAGE), LxField("highest_mv", "H", *VOLTAGE))
_ID, _OFFSET, _HOTTEST = (
    LxField("id", "B", 0, MOST_ID),
    LxField("offset", "b", -MOST_OFFSET, MOST_OFFSET),
    LxField("hottest", "B", 50, 100),
)
_MODE = (LxField("motor", "B", 0, 1), LxField("zero", "B", 0, 0), LxField("speed", "h", -1000, 1000))
_LOADED, _DARK, _FAULTS = LxField("loaded", "B", 0, 1), LxField("dark", "B", 0, 1), LxField("faults", "B", 0, 7)

TABLE: dict[Code, LxCode] = {
    Code.MOVE_TIME_WRITE: LxCode(asks=(_POSITION, _TIME)),
    Code.MOVE_TIME_READ: LxCode(replies=(_POSITION, _TIME)),
    Code.MOVE_TIME_WAIT_WRITE: LxCode(asks=(_POSITION, _TIME)),
    Code.MOVE_TIME_WAIT_READ: LxCode(replies=(_POSITION, _TIME)),
    Code.MOVE_START: LxCode(),
    Code.MOVE_STOP: LxCode(),
    Code.ID_WRITE: LxCode(asks=(_ID,)),
    Code.ID_READ: LxCode(replies=(_ID,)),
    Code.ANGLE_OFFSET_ADJUST: LxCode(asks=(_OFFSET,)),
    Code.ANGLE_OFFSET_WRITE: LxCode(),
    Code.ANGLE_OFFSET_READ: LxCode(replies=(_OFFSET,)),
    Code.ANGLE_LIMIT_WRITE: LxCode(asks=_ANGLES),
    Code.ANGLE_LIMIT_READ: LxCode(replies=_ANGLES),
    Code.VIN_LIMIT_WRITE: LxCode(asks=_VOLTS),
    Code.VIN_LIMIT_READ: LxCode(replies=_VOLTS),
    Code.TEMP_MAX_LIMIT_WRITE: LxCode(asks=(_HOTTEST,)),
    Code.TEMP_MAX_LIMIT_READ: LxCode(replies=(_HOTTEST,)),
    Code.TEMP_READ: LxCode(replies=(LxField("temperature", "B", 0, 255),)),
    Code.VIN_READ: LxCode(replies=(LxField("voltage_mv", "H", 0, 20_000),)),
    Code.POS_READ: LxCode(replies=(LxField("position", "h", -MOST_OFFSET, MOST_POSITION),)),
    Code.OR_MOTOR_MODE_WRITE: LxCode(asks=_MODE),
    Code.OR_MOTOR_MODE_READ: LxCode(replies=_MODE),
    Code.LOAD_OR_UNLOAD_WRITE: LxCode(asks=(_LOADED,)),
    Code.LOAD_OR_UNLOAD_READ: LxCode(replies=(_LOADED,)),
    Code.LED_CTRL_WRITE: LxCode(asks=(_DARK,)),
    Code.LED_CTRL_READ: LxCode(replies=(_DARK,)),
    Code.LED_ERROR_WRITE: LxCode(asks=(_FAULTS,)),
    Code.LED_ERROR_READ: LxCode(replies=(_FAULTS,)),
}
_FORMS = {
    (code, reply): struct.Struct("<" + "".join(field.form for field in (row.replies if reply else row.asks)))
    for code, row in TABLE.items()
    for reply in ((False, True) if row.replies else (False,))
}
_KINDS = {(code.value, 3 + form.size): (code, reply, form) for (code, reply), form in _FORMS.items()}


def checksum(body: bytes) -> int:
    """Checksum of id, length, code and parameters."""
    return ~sum(body) & 0xFF


def encode(servo: int, code: Code, *values: int) -> bytes:
    """The host's frame: a write with its values, or a question.

    Args:
        servo: 0 to 253, 254 for all of them. values: as in `TABLE`, in counts, ms, mV, deg C (`servo_counts`).

    Raises ProtocolError: another number of values, or one out of its range.
    """
    return _encoded(servo, code, values, False, BROADCAST)


def encode_reply(servo: int, code: Code, *values: int) -> bytes:
    """The servo's answer to a question. Raises ProtocolError as `encode`, and for a code without answer."""
    if not TABLE[code].replies:
        raise ProtocolError(f"reply to {code.name}; servos answer none")
    return _encoded(servo, code, values, True, MOST_ID)


def decode(data: bytes) -> LxFrame:
    """The frame in `data`, which must be exactly one. Raises ProtocolError for any other bytes, and no other error."""
    if not 6 <= len(data) <= MOST_BYTES or data[:2] != HEADER or data[3] != len(data) - 3:
        raise ProtocolError(
            f"{bytes(data[:MOST_BYTES]).hex(' ')}; expected 55 55, id, length, code, parameters, checksum: 6 to 10 bytes"
        )
    if data[-1] != checksum(data[2:-1]):
        raise ProtocolError(f"checksum {data[-1]:02x}; expected {checksum(data[2:-1]):02x}: the frame is damaged")
    known = _KINDS.get((data[4], data[3]))
    if known is None:
        raise ProtocolError(f"code {data[4]} with length {data[3]}; the table of codes has no such frame")
    code, reply, form = known
    values = form.unpack(data[5:-1])
    _check(data[2], code, values, reply, MOST_ID if reply else BROADCAST)
    return LxFrame(data[2], code, values, reply)


class LxFrameReader(FrameReader[LxFrame]):
    """Finds frames in a byte stream; at most nine bytes wait for the rest of their frame. See `FrameReader`."""

    def __init__(self) -> None:
        super().__init__(_size, decode)


def _size(buffer: bytearray, at: int) -> int | None:
    """Length of the frame that may begin here; 0: none can; None: too few bytes to decide, or to have all of it."""
    there = len(buffer) - at
    if any(buffer[at + k] != 0x55 for k in range(min(2, there))):
        return 0
    if there > 3 and not 3 <= buffer[at + 3] <= MOST_BYTES - 3:
        return 0
    if there < 5:
        return None
    length = buffer[at + 3]
    if (buffer[at + 4], length) not in _KINDS:
        return 0
    return length + 3 if there >= length + 3 else None


def _encoded(servo: int, code: Code, values: tuple[int, ...], reply: bool, most_id: int) -> bytes:
    _check(servo, code, values, reply, most_id)
    parameters = _FORMS[code, reply].pack(*values)
    body = bytes((servo, 3 + len(parameters), code)) + parameters
    return HEADER + body + bytes((checksum(body),))


def _check(servo: int, code: Code, values: tuple[int, ...], reply: bool, most_id: int) -> None:
    if not 0 <= servo <= most_id:
        raise ProtocolError(f"{code.name} with servo id {servo}; expected 0 to {most_id}")
    fields = TABLE[code].replies if reply else TABLE[code].asks
    if len(values) != len(fields):
        raise ProtocolError(f"{code.name} with {len(values)} values; expected {', '.join(f.name for f in fields) or 'none'}")
    for field, value in zip(fields, values, strict=True):
        if not field.least <= value <= field.most:
            raise ProtocolError(f"{code.name} of servo {servo}: {field.name} {value}; expected {field.least} to {field.most}")
    if fields in (_ANGLES, _VOLTS) and values[0] >= values[1]:
        raise ProtocolError(f"{code.name} of servo {servo}: limits {values}; expected the lower one first")
