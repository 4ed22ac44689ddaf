"""Servo buses behind one interface: questions, commands, and the meaning of answers. `lx_bus` and `dynamixel` make the bytes.

    bus = BUSES["dynamixel-x"]
    bus.ask("state", (1, 2))                bytes of a question
    bus.answer(frame)                       ServoReply(servo=1, position=2048, volts=5.0, degrees=31.0, ...)
    bus.move({1: 2048, 2: 1990}, 0)         bytes of a command
    bus.torque((1, 2), False)               bytes that switch the torque off

Control tables: ROBOTIS e-Manual, XL330-M288-T and XW540-T260-R (one table for the X series), AX-12A.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from fishmj.deploy.protocols import dynamixel, lx_bus
from fishmj.deploy.protocols.dynamixel import Protocol1, Protocol2
from fishmj.deploy.protocols.frame_reader import FrameReader
from fishmj.deploy.protocols.lx_bus import Code
from fishmj.deploy.protocols.messages import ServoFault
from fishmj.mjcf import servo_buses
from fishmj.mjcf.servo_buses import Scale


class ServoReply(NamedTuple):
    """Answer of a servo; None: not in this answer. position: counts. unfit: reason that it cannot be used, "" if it can."""

    servo: int
    question: str
    position: int | None = None
    volts: float | None = None
    degrees: float | None = None  # deg C
    fault: ServoFault | None = None
    unfit: str = ""


class ServoBus(Protocol):
    """One kind of servo bus.

    Attributes:
        name: as in `[rig] bus`. baud: the default. most_id: largest number of a servo. scale: of its counts.
        lowest: V, below it the servos report their voltage, as delivered. delay: s that a servo waits before it answers, as
            delivered. moves_in_time: MOVE takes a time.
        first: question that every servo must answer before it is used, "" for none. each: asked of every servo at every tick.
        turns: asked of one servo a tick, in turn. together: True if one question may go to several servos.
    """

    name: str
    baud: int
    most_id: int
    scale: Scale
    lowest: float
    delay: float
    moves_in_time: bool
    first: str
    each: str
    turns: tuple[str, ...]
    together: bool

    def reader(self) -> FrameReader[Any]:
        """Reader of the bus's frames."""

    def ask(self, question: str, servos: Sequence[int]) -> bytes:
        """Bytes of a question to one servo, or with `together` to several."""

    def size(self, question: str) -> int:
        """Number of bytes of one servo's answer."""

    def answer(self, frame: Any) -> ServoReply | None:
        """Meaning of a servo's frame; None if it answers none of these questions."""

    def move(self, goals: Mapping[int, int], milliseconds: int) -> bytes:
        """Bytes that move each servo to its count; milliseconds: time of the move if the bus has one, 0 at once."""

    def torque(self, servos: Sequence[int], on: bool) -> bytes:
        """Bytes that switch the torque on or off."""


class LxBus(ServoBus):
    """Servo bus of the LX series."""

    (name, baud, most_id, scale), lowest = servo_buses.BUSES["lx"], 4.5
    delay = 0.0
    moves_in_time, together, first, each, turns = True, False, "", "position", ("volts", "degrees")
    _codes = {"position": Code.POS_READ, "volts": Code.VIN_READ, "degrees": Code.TEMP_READ}
    _questions = {code: question for question, code in _codes.items()}

    def reader(self) -> FrameReader[Any]:
        """Reader of LX frames."""
        return lx_bus.LxFrameReader()

    def ask(self, question: str, servos: Sequence[int]) -> bytes:
        """Bytes of a question to the first of `servos`."""
        return lx_bus.encode(servos[0], self._codes[question])

    def size(self, question: str) -> int:
        """Number of bytes of an answer: 7 for a temperature, else 8."""
        return 7 if question == "degrees" else 8

    def answer(self, frame: lx_bus.LxFrame) -> ServoReply | None:
        """Meaning of a servo's frame: position in counts, volts or deg C; None for any other frame."""
        question = self._questions.get(frame.code)
        if question is None or not frame.reply:
            return None
        (value,) = frame.values
        values = {"position": value} if question == "position" else {question: value / (1000 if question == "volts" else 1)}
        return ServoReply(frame.servo, question, **values)

    def move(self, goals: Mapping[int, int], milliseconds: int) -> bytes:
        """Bytes of one MOVE_TIME_WRITE for each servo."""
        return b"".join(lx_bus.encode(servo, Code.MOVE_TIME_WRITE, goal, milliseconds) for servo, goal in goals.items())

    def torque(self, servos: Sequence[int], on: bool) -> bytes:
        """Bytes of one LOAD_OR_UNLOAD_WRITE for each servo."""
        return b"".join(lx_bus.encode(servo, Code.LOAD_OR_UNLOAD_WRITE, int(on)) for servo in servos)


class ControlTable(NamedTuple):
    """Places of the needed numbers in a Dynamixel: address and form (of `struct`) of each.

    identity, state: first address and count of bytes that are read at once.
    """

    identity: tuple[int, int]
    torque: tuple[int, str]
    goal: tuple[int, str]
    state: tuple[int, int]
    position: tuple[int, str]
    volts: tuple[int, str]  # 0.1 V
    degrees: tuple[int, str]  # deg C
    error: int | None = None  # address of a hardware error of one byte

    def value(self, place: tuple[int, str], data: bytes, start: int) -> int:
        """The number at a place, from bytes that were read from address `start`."""
        return int(struct.unpack_from(f"<{place[1]}", data, place[0] - start)[0])


X_TABLE = ControlTable(
    identity=(0, 12), torque=(64, "B"), goal=(116, "i"), state=(132, 15), position=(132, "i"), volts=(144, "H"),
    degrees=(146, "B"), error=70,
)  # fmt: skip
AX_TABLE = ControlTable(
    identity=(0, 10), torque=(24, "B"), goal=(30, "H"), state=(36, 8), position=(36, "H"), volts=(42, "B"), degrees=(43, "B")
)
POSITION_MODE = 3
X_MODELS, X_OTHERS, AX_MODELS = range(1000, 2000), (30, 311, 321), (12, 18, 300)  # others: MX with protocol 2.0


class DynamixelBus(ServoBus):
    """Shared part of the X and AX series; all commands are SYNC_WRITE, which no servo answers."""

    moves_in_time, first, each, delay = False, "identity", "state", 0.0005
    name: str
    wire: Protocol1 | Protocol2
    table: ControlTable
    scale: Scale

    def reader(self) -> FrameReader[Any]:
        """Reader of the protocol's packets."""
        return dynamixel.PacketReader(self.wire)

    def ask(self, question: str, servos: Sequence[int]) -> bytes:
        """Bytes of a read of the question's registers."""
        return self.wire.read(servos, *self._span(question))

    def size(self, question: str) -> int:
        """Number of bytes of one servo's answer."""
        return len(self.wire.encode(1, dynamixel.Instruction.STATUS, bytes(self._span(question)[1])))

    def answer(self, frame: dynamixel.Packet) -> ServoReply | None:
        """Meaning of a status packet, whose length tells the question; None for any other packet."""
        question = next((q for q in (self.first, self.each, *self.turns) if self._span(q)[1] == len(frame.data)), None)
        if question is None or not frame.reply:
            return None
        start = self._span(question)[0]
        if question == "error":
            return ServoReply(frame.servo, question, fault=x_fault(frame.data[0]))
        if question == "identity":
            return ServoReply(frame.servo, question, unfit=self.unfit(frame.data))
        at = lambda place: self.table.value(place, frame.data, start)
        position, volts, degrees = at(self.table.position), at(self.table.volts) / 10, float(at(self.table.degrees))
        return ServoReply(frame.servo, question, position, volts, degrees, self.fault(frame.error))

    def move(self, goals: Mapping[int, int], milliseconds: int) -> bytes:
        """Bytes of one SYNC_WRITE of all goals; the time of the move is not used."""
        address, form = self.table.goal
        return self.wire.sync_write(address, {servo: struct.pack(f"<{form}", goal) for servo, goal in goals.items()})

    def torque(self, servos: Sequence[int], on: bool) -> bytes:
        """Bytes of one SYNC_WRITE that switches all torques."""
        return self.wire.sync_write(self.table.torque[0], {servo: bytes((on,)) for servo in servos})

    def fault(self, error: int) -> ServoFault | None:
        """Faults in the error byte of a status; None if the byte does not name them."""
        raise NotImplementedError

    def unfit(self, data: bytes) -> str:
        """Reason that a servo with these first bytes of its table cannot be used, "" if it can."""
        raise NotImplementedError

    turns: tuple[str, ...] = ()

    def _span(self, question: str) -> tuple[int, int]:
        if question == "error":
            return self.table.error or 0, 1
        return self.table.identity if question == "identity" else self.table.state


class DynamixelX(DynamixelBus):
    """X series, protocol 2.0; one SYNC_READ asks all servos. The factory setting of 57600 baud is too slow for 50 Hz."""

    (name, baud, most_id, scale), lowest = servo_buses.BUSES["dynamixel-x"], 3.5
    together, turns, wire, table = True, ("error",), Protocol2(), X_TABLE

    def fault(self, error: int) -> ServoFault | None:
        """Returns None: the alert bit only shows that there is a fault, and the question "error" tells which."""
        return None  # its alert bit says that there is one, and "error" which

    def unfit(self, data: bytes) -> str:
        """Reason that a servo cannot be used: another series or operating mode; else ""."""
        model, mode = struct.unpack_from("<H", data)[0], data[11]
        if model not in X_MODELS and model not in X_OTHERS:
            return f"is of model number {model}; expected an X series (1000 to 1999), whose control table {self.name} has"
        if mode != POSITION_MODE:
            return f"is in operating mode {mode}; expected {POSITION_MODE}, position control (set it with DYNAMIXEL Wizard)"
        return ""


class DynamixelAx(DynamixelBus):
    """AX series, protocol 1.0."""

    (name, baud, most_id, scale), lowest = servo_buses.BUSES["dynamixel-ax"], 6.0
    together, wire, table = False, Protocol1(), AX_TABLE

    def fault(self, error: int) -> ServoFault | None:
        """Faults in the error byte of a status."""
        pairs = ((0x01, ServoFault.VOLTAGE), (0x04, ServoFault.HOT), (0x20, ServoFault.LOCKED))
        return _faults(error, pairs)

    def unfit(self, data: bytes) -> str:
        """Reason that a servo cannot be used: another series, or wheel mode; else ""."""
        model, lowest, highest = struct.unpack_from("<H", data)[0], *struct.unpack_from("<HH", data, 6)
        if model not in AX_MODELS:
            return f"is of model number {model}; expected an AX series (12, 18 or 300), whose control table {self.name} has"
        if lowest == highest == 0:
            return "is in wheel mode (both angle limits are 0); expected joint mode (set 0 and 1023 with DYNAMIXEL Wizard)"
        return ""


def x_fault(bits: int) -> ServoFault:
    """Faults of the X series' Hardware Error Status; motor encoder, electrical shock and overload lock it."""
    return _faults(bits, ((0x01, ServoFault.VOLTAGE), (0x04, ServoFault.HOT), (0x38, ServoFault.LOCKED)))


def _faults(bits: int, pairs: Sequence[tuple[int, ServoFault]]) -> ServoFault:
    found = ServoFault.NONE
    for mask, fault in pairs:
        found |= fault if bits & mask else ServoFault.NONE
    return found


BUSES: dict[str, ServoBus] = {bus.name: bus for bus in (LxBus(), DynamixelX(), DynamixelAx())}
