"""Servos on a bus without a microcontroller: the loopback robot as a host on a serial line sees it.

They answer the frames of the description's `[rig] bus` from the body's joints, and hold their last goal when the host falls
silent.
"""

from collections.abc import Sequence
from struct import error as StructError
from struct import pack, pack_into, unpack
from typing import Any

from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.protocols import lx_bus, servo_counts
from fishmj.deploy.protocols.dynamixel import BROADCAST, Instruction, Packet
from fishmj.deploy.protocols.lx_bus import Code
from fishmj.deploy.protocols.messages import ServoFault
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.servo_bus import BUSES, POSITION_MODE, DynamixelBus
from fishmj.mjcf.description import Robot

HOTTEST = 70.0  # deg C, the temperature limit of Dynamixel servos as delivered: they let go and keep the error
MODELS = {"dynamixel-x": 1200, "dynamixel-ax": 12}  # model numbers of XL330-M288 and AX-12A
VERSION = 52  # of their firmware


class LoopbackServos:
    """The servos of a robot, from the moment of power. See `firmware.Firmware`.

    Attributes:
        readings: present ones; the robot sets them before each question.
    """

    bad = 0
    readings: "Readings"

    def __init__(self, robot: Robot):
        self.bus, self.ids, count = BUSES[robot.rig.bus], robot.servo_ids, robot.n_joints
        self.zeros, self.signs = robot.rig.zeros or (0.0,) * count, robot.rig.signs or (1,) * count
        self.target: tuple[float, ...] | None = None
        self._on, self._goal = [False] * count, [self.bus.scale.centre] * count
        self._error = [ServoFault.NONE] * count
        self._reader = self.bus.reader()

    def hear(self, data: bytes, now: float, measured: Sequence[float]) -> tuple[bool, list[bytes]]:
        """Handles the frames in `data`; returns True if one changed a servo, and the answers."""
        told, answers, damaged = False, [], self._reader.damaged
        for frame in self._reader.frames(data):
            if not frame.reply:
                moved, said = self._heard(frame)
                told, answers = told or moved, answers + said
        self.bad += self._reader.damaged - damaged
        return told, answers

    def act(self, now: float, measured: Sequence[float]) -> tuple[float, ...] | None:
        """Targets of the servos, rad, (J,); a servo without torque keeps its angle; None if all are without."""
        self._check()
        if not any(self._on):
            self.target = None
        else:
            at = self.readings.joint
            rows = zip(self._goal, self.zeros, self.signs, self._on, at, strict=True)
            scale = self.bus.scale
            self.target = tuple(s * servo_counts.angle(g, zero, scale) if on else q for g, zero, s, on, q in rows)
        return self.target

    def report(self, now: float, readings: "Readings") -> bytes:
        """Returns b"": servos only answer questions."""
        return b""

    def _check(self) -> None:
        """Switches off the torque of Dynamixel servos that are too hot, until they are switched off."""
        for k, degrees in enumerate(self.readings.temperature):
            if isinstance(self.bus, DynamixelBus) and degrees >= HOTTEST:
                self._error[k] |= ServoFault.HOT
                self._on[k] = False

    def _heard(self, frame: Any) -> tuple[bool, list[bytes]]:
        """Handles a frame; returns True if it changed a servo, and the answers."""
        listening = [k for k, fault in enumerate(self.readings.fault) if ServoFault.NO_REPLY not in fault]
        if isinstance(self.bus, DynamixelBus):
            return self._dynamixel(self.bus, frame, listening)
        mine = [k for k, servo in enumerate(self.ids) if frame.servo in (servo, lx_bus.BROADCAST)]
        if frame.code is Code.MOVE_TIME_WRITE:
            for k in mine:
                self._goal[k], self._on[k] = frame.values[0], True
        elif frame.code is Code.LOAD_OR_UNLOAD_WRITE:
            self._switch({k: bool(frame.values[0]) for k in mine})
        else:
            values = {
                Code.POS_READ: lambda k: self._position(k),
                Code.VIN_READ: lambda k: round(1000 * self.readings.servo_voltage[k]),
                Code.TEMP_READ: lambda k: round(self.readings.temperature[k]),
            }
            if frame.code not in values:
                return False, []
            value = values[frame.code]
            return False, [lx_bus.encode_reply(self.ids[k], frame.code, value(k)) for k in mine if k in listening]
        return True, []

    def _dynamixel(self, bus: DynamixelBus, packet: Packet, listening: Sequence[int]) -> tuple[bool, list[bytes]]:
        places = {servo: k for k, servo in enumerate(self.ids)}
        try:
            if packet.instruction is Instruction.PING:
                data = pack("<HB", MODELS[bus.name], VERSION)
                return False, [self._status(bus, k, data) for k in listening if packet.servo in (self.ids[k], BROADCAST)]
            (address, count), listed = bus.wire.span_of(packet), bus.wire.listed(packet)
            if packet.instruction in (Instruction.READ, Instruction.SYNC_READ):
                asked = [packet.servo] if packet.instruction is Instruction.READ else list(listed)
                there = [places[servo] for servo in asked if places.get(servo) in listening]
                return False, [self._status(bus, k, self._table(bus, k)[address : address + count]) for k in there]
            if packet.instruction is Instruction.SYNC_WRITE:
                size = count + 1
                rows = {listed[n]: listed[n + 1 : n + size] for n in range(0, len(listed) - count, size)}
                self._write(bus, address, {places[servo]: data for servo, data in rows.items() if servo in places})
                return True, []
        except (ProtocolError, StructError):
            self.bad += 1
        return False, []

    def _write(self, bus: DynamixelBus, address: int, rows: dict[int, bytes]) -> None:
        table = bus.table
        if address == table.torque[0]:
            self._switch({k: bool(data[0]) for k, data in rows.items()})
        if address == table.goal[0]:
            for k, data in rows.items():
                self._goal[k] = unpack(f"<{table.goal[1]}", data)[0]

    def _switch(self, on: dict[int, bool]) -> None:
        for k, wanted in on.items():
            if wanted and not self._on[k]:  # no jump to the goal of before
                self._goal[k] = self._position(k)
            self._on[k] = wanted and not self._error[k]

    def _position(self, k: int) -> int:
        return servo_counts.counts(self.signs[k] * self.readings.joint[k], self.zeros[k], self.bus.scale)

    def _table(self, bus: DynamixelBus, k: int) -> bytes:
        """The control table of a servo."""
        table, data, fault = bus.table, bytearray(160), self.readings.fault[k] | self._error[k]
        pack_into("<H", data, 0, MODELS[bus.name])
        for place, value in (
            (table.torque, self._on[k]), (table.goal, self._goal[k]), (table.position, self._position(k)),
            (table.volts, round(10 * self.readings.servo_voltage[k])), (table.degrees, round(self.readings.temperature[k])),
        ):  # fmt: skip
            pack_into(f"<{place[1]}", data, place[0], value)
        if table.error is not None:
            data[11], data[table.error] = POSITION_MODE, _error_bits(fault)
        else:
            pack_into("<HH", data, 6, 0, bus.scale.span)
        return bytes(data)

    def _status(self, bus: DynamixelBus, k: int, data: bytes) -> bytes:
        bits = _error_bits(self.readings.fault[k] | self._error[k])
        error = bits if bus.table.error is None else 0x80 * bool(bits)
        return bus.wire.encode(self.ids[k], Instruction.STATUS, data, error)


def _error_bits(fault: ServoFault) -> int:
    """Input voltage, overheating: the same bits in the X series' table and in the AX series' status."""
    return 0x01 * (ServoFault.VOLTAGE in fault) | 0x04 * (ServoFault.HOT in fault)
