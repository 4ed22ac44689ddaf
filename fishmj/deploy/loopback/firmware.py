"""The microcontroller of the loopback robot: datagrams in, servo targets and telemetry out.

Times as arguments are the loopback's; each firmware counts its own from its boot, like a microcontroller. Both read servos
in their counts (0.24 deg of LX servos) and send them whole counts.
"""

from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from math import inf, isnan, nan
from operator import sub
from pathlib import Path
from typing import Protocol

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback.loopback_servos import LoopbackServos
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.protocols import PROTOCOLS, SERVO_BUS, fishmj1, mish, servo_counts
from fishmj.deploy.protocols.firmware_guard import Bounds, Guard
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.sequence import SequenceGate
from fishmj.deploy.protocols.servo_bus import BUSES
from fishmj.deploy.protocols.watchdog import Limits, Watchdog
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import structure_of

NAME = "fishmj-loopback-1"
PERIOD = 0.02  # s between two readings of the servos, and two packets of telemetry
HOLD, NEUTRAL = 0.1, 0.3  # s, what INFO says before a host asks for others


class Firmware(Protocol):
    """One life of a microcontroller, from boot to brown-out.

    Attributes:
        target: last targets of the servos, rad, (J,); None: they have no torque.
        bad: datagrams outside its protocol.
    """

    target: tuple[float, ...] | None
    bad: int

    def hear(self, data: bytes, now: float, measured: Sequence[float]) -> tuple[bool, list[bytes]]:
        """Handles a datagram that arrives now; returns True if it changes the targets, and the answers."""

    def act(self, now: float, measured: Sequence[float]) -> tuple[float, ...] | None:
        """Present targets of the servos, rad, (J,); None: no torque."""

    def report(self, now: float, readings: Readings) -> bytes:
        """One packet of telemetry."""


def firmware_of(protocol: str, robot: Robot, born: float, policy_sha256: str = "") -> Firmware:
    """The firmware that speaks this protocol, booted at `born` [s].

    Raises UnknownName: no such protocol; ConfigError: a robot that it cannot be on.
    """
    if protocol not in PROTOCOLS:
        raise UnknownName("protocol", protocol, PROTOCOLS)
    if protocol == SERVO_BUS:
        return LoopbackServos(robot)
    if protocol == PROTOCOLS[0]:
        return FishmjFirmware(robot, born, policy_sha256)
    if robot.n_joints != mish.JOINTS:
        raise ConfigError(f"loopback: {protocol} carries {mish.JOINTS} joints, {robot.name} has {robot.n_joints}; take fishmj-1")
    return MishFirmware(robot, protocol)


@cache
def own_sha256() -> str:
    """sha256 of this file, which is the firmware."""
    return sha256(Path(__file__).read_bytes()).hexdigest()


class FishmjFirmware:
    """`fishmj-1`: numbered datagrams, arming, a watchdog, a guard that reports."""

    def __init__(self, robot: Robot, born: float, policy_sha256: str = ""):
        names = tuple(structure_of(robot)["joints"])
        self.watchdog = Watchdog(len(names), Limits(servo_range=robot.servo.range), hold=HOLD, neutral=NEUTRAL)
        self.gate, self.bad = SequenceGate(), 0
        self.target: tuple[float, ...] | None = None
        self._born, self._sent, self._range = born, 0, robot.servo.range
        self._echo: tuple[int, float] | None = None
        self._asked: tuple[float, ...] | None = None  # rad, of the newest command, until the target is there
        self._taken = -inf  # s of its clock
        self._fresh = False  # the newest command has not been stepped to
        told = (robot.servo_ids, names, robot.servo.range, HOLD, NEUTRAL, policy_sha256)
        self._told = RobotInfo(NAME, own_sha256(), *told)
        self.guard, self._scale = Guard(len(names), Bounds(low=robot.low_voltage)), BUSES[robot.rig.bus].scale
        self._last = (0.0,) * len(names)  # rad, where each joint was when its servo last answered

    def hear(self, data: bytes, now: float, measured: Sequence[float]) -> tuple[bool, list[bytes]]:
        """Handles a datagram; returns True for an accepted command, and the answers."""
        clock = now - self._born
        try:
            message = fishmj1.decode(data)
        except ProtocolError:
            self.bad += 1
            return False, []
        if message.kind in (fishmj1.Kind.TELEMETRY, fishmj1.Kind.INFO):  # those only a robot sends
            self.bad += 1
            return False, []
        if not self.gate.accept(message.seq, message.time):
            return False, []
        if message.kind is fishmj1.Kind.COMMAND:
            taken = self.watchdog.command(clock, message.value.joint, message.value.speed)
            if taken:
                self._echo, self._taken, self._fresh = (message.seq, message.time), clock, True
                self._asked = tuple(max(-self._range, min(self._range, angle)) for angle in message.value.joint)
            return taken, []
        if message.kind is fishmj1.Kind.DISARM:
            self.watchdog.disarm()
            return True, []
        if message.kind is fishmj1.Kind.ARM:
            self.watchdog.arm(clock, message.value.hold, message.value.neutral, measured)
        info = self._told._replace(hold=self.watchdog.hold, neutral=self.watchdog.neutral)
        return message.kind is fishmj1.Kind.ARM, [fishmj1.encode_info(self._number(), clock, info)]

    def act(self, now: float, measured: Sequence[float]) -> tuple[float, ...] | None:
        """Targets of the servos from the watchdog, rad, (J,); None: no torque."""
        clock = now - self._born
        # A step between two commands would use up the time in which the next one may move: its motion would be split from then on
        since, there = clock - self._taken, self._asked is None
        waits = not self._fresh and (since < PERIOD or there and since < self.watchdog.hold)
        if not (waits and self.watchdog.state is RobotState.ARMED):
            self._fresh = False
            self.target = self.watchdog.step(clock, measured)
            if self.target and self._asked and max(map(abs, map(sub, self.target, self._asked))) < 1e-9:
                self._asked = None
        return None if self.target is None else tuple(in_counts(angle, self._scale) for angle in self.target)

    def report(self, now: float, readings: Readings) -> bytes:
        """One packet of telemetry, with the guard's faults."""
        clock, measured = now - self._born, tuple(a if abs(a) <= fishmj1.MOST_ANGLE else nan for a in readings.measured)
        found = self.guard.check(clock, self.target, measured, readings.temperature, readings.voltage)
        echo, echo_time = self._echo or (None, None)
        telemetry = Telemetry(
            joint=readings.joint, seq=self._number(), time=clock, echo=echo, echo_time=echo_time,
            state=self.watchdog.state, voltage=readings.voltage, current=readings.current,
            servo_voltage=readings.servo_voltage, temperature=readings.temperature,
            fault=tuple(f | s for f, s in zip(readings.fault, found, strict=True)),
        )  # fmt: skip
        telemetry = fishmj1.clamped_to_wire_range(telemetry, self._last)
        self._last = telemetry.joint
        return fishmj1.encode_telemetry(telemetry)

    def _number(self) -> int:
        """Number of the next datagram."""
        self._sent = (self._sent + 1) % 2**32
        return self._sent


class MishFirmware:
    """The open robot's firmware: commands act at once, without a watchdog. Its servos have torque from the first command on."""

    bad = 0

    def __init__(self, robot: Robot, protocol: str):
        self._ids, self._scale = robot.servo_ids, BUSES[robot.rig.bus].scale
        self._firmware: mish.Firmware = "mish-0.1.0" if protocol == "mish-0.1.0" else "fixed"
        self.bad = 0
        self.target: tuple[float, ...] | None = None
        self._goal: tuple[float, ...] | None = None
        self._speed: tuple[float | None, ...] = (None,) * mish.JOINTS
        self._stepped = 0.0

    def hear(self, data: bytes, now: float, measured: Sequence[float]) -> tuple[bool, list[bytes]]:
        """Handles a datagram; returns True for a command, and no answer."""
        try:
            asked = mish.decode_command(data)
        except ProtocolError:
            self.bad += 1
            return False, []
        self._goal = tuple(mish.commanded(angle, self._firmware) for angle in asked.joint)
        if self.target is None:  # a servo that does not say where it is goes there at once
            self.target = tuple(goal if isnan(at) else at for at, goal in zip(measured, self._goal, strict=True))
            self._stepped = now
        self._speed = tuple(map(mish.moved_at, asked.speed))
        return True, []

    def act(self, now: float, measured: Sequence[float]) -> tuple[float, ...] | None:
        """Targets of the servos, rad, (J,), on the way to the command at its speed; None before the first."""
        if self.target is None or self._goal is None:
            return None
        dt, self._stepped = now - self._stepped, now
        moved = zip(self.target, self._goal, self._speed, strict=True)
        self.target = tuple(goal if v is None else at + max(-v * dt, min(v * dt, goal - at)) for at, goal, v in moved)
        return tuple(in_counts(angle, self._scale) for angle in self.target)

    def report(self, now: float, readings: Readings) -> bytes:
        """One packet of telemetry in the robot's layout."""
        telemetry = Telemetry(readings.joint, servo_voltage=readings.servo_voltage, temperature=readings.temperature)
        return mish.encode_telemetry(telemetry, self._ids, self._firmware)


def in_counts(angle: float, scale: servo_counts.Scale = servo_counts.LX) -> float:
    """Angle [rad] rounded to whole counts of a servo."""
    return servo_counts.angle(servo_counts.counts(angle, 0.0, scale), 0.0, scale)
