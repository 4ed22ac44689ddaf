"""A robot over a transport: greet, arm, command, listen, disarm. One class a protocol, all with the same face.

What a protocol cannot say stays None, and `lacks` names it: the arming decides what that means.
"""

from typing import NamedTuple, Protocol

import numpy as np

from fishmj.deploy.link.transports import Transport
from fishmj.deploy.protocols import fishmj1, mish
from fishmj.deploy.protocols.errors import ProtocolError
from fishmj.deploy.protocols.messages import RobotInfo, Telemetry
from fishmj.deploy.protocols.sequence import SequenceGate

WHOLE = 2**32  # sequence numbers wrap here


class Sent(NamedTuple):
    """One command as it left: seq is None where the protocol has none; t s on the host's clock."""

    seq: int | None
    t: float
    data: bytes


class Received(NamedTuple):
    """One packet as it arrived, t s on the host's clock."""

    t: float
    value: Telemetry | RobotInfo


class RobotClock(NamedTuple):
    """What a question and its answer tell of the robot's clock.

        ahead = (t_asked + t_heard) / 2 - t_robot,    wrong by at most round_trip / 2

    Attributes:
        ahead: s, the host's clock minus the robot's. round_trip: s, from the question to the answer.
    """

    ahead: float
    round_trip: float


class Link(Protocol):
    """What the loop talks to.

    Attributes:
        name: of the protocol. lacks: what it cannot say or do, a phrase each. watched: whether the robot has a watchdog.
        greets: whether the robot says what it is.
        counts: bad (no message at all), old (late or repeated, dropped), packets.
        robot_clock: None where it is not told.
    """

    name: str
    lacks: tuple[str, ...]
    watched: bool
    greets: bool
    counts: dict[str, int]
    robot_clock: RobotClock | None

    def open(self) -> None: ...
    def hello(self, now: float) -> None: ...
    def arm(self, now: float, hold: float, neutral: float) -> None: ...
    def disarm(self, now: float) -> None: ...
    def send(self, joint: np.ndarray, now: float) -> Sent: ...
    def receive(self, now: float) -> list[Received]: ...
    def forget(self) -> None: ...
    def close(self) -> None: ...

    def silence(self) -> str:
        """Why nothing is heard, "" where nothing but the silence is known."""


class Fishmj1Link:
    """Protocol `fishmj-1`: sequence numbers, echo, the robot's clock, a watchdog of its own."""

    name, watched, greets = "fishmj-1", True, True
    lacks: tuple[str, ...] = ()

    def __init__(self, transport: Transport):
        self.transport, self.seq = transport, 0
        self.counts = {"packets": 0, "bad": 0, "old": 0}
        self.robot_clock: RobotClock | None = None  # of the quickest answer since `forget`
        self._gate = SequenceGate()
        self._asked: list[float] = []  # s, of the questions that wait for their answer

    def open(self) -> None:
        self.transport.open()

    def close(self) -> None:
        self.transport.close()

    def silence(self) -> str:
        return ""

    def forget(self) -> None:
        """The robot may have begun anew: whatever number comes next is believed."""
        self._gate.forget()
        self.robot_clock = None

    def hello(self, now: float) -> None:
        """Ask the robot what it is."""
        self._asked.append(now)
        self.transport.send(fishmj1.encode_hello(self._number(), now))

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Ask for torque, with the watchdog's times in s."""
        self._asked.append(now)
        self.transport.send(fishmj1.encode_arm(self._number(), now, hold, neutral))

    def disarm(self, now: float) -> None:
        """Ask for no torque."""
        self.transport.send(fishmj1.encode_disarm(self._number(), now))

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad."""
        seq = self._number()
        data = fishmj1.encode_command(seq, now, tuple(map(float, joint)))
        self.transport.send(data)
        return Sent(seq, now, data)

    def receive(self, now: float) -> list[Received]:
        """What arrived since the last call; old and repeated telemetry is dropped and counted."""
        found = []
        for t, data in self.transport.receive():
            try:
                message = fishmj1.decode(data)
            except ProtocolError:
                self.counts["bad"] += 1
                continue
            self.counts["packets"] += 1
            if isinstance(message.value, RobotInfo):
                self._answered(t, message.time)
                found.append(Received(t, message.value))
            elif isinstance(message.value, Telemetry):
                if not self._gate.accept(message.seq, message.time):
                    self.counts["old"] += 1
                    continue
                found.append(Received(t, message.value))
        return found

    def _answered(self, t: float, robot: float) -> None:
        """The robot's clock from an answer of its time `robot` that arrived at t; where two questions wait, one was lost."""
        asked, self._asked = self._asked, []
        if len(asked) == 1 and (self.robot_clock is None or t - asked[0] < self.robot_clock.round_trip):
            self.robot_clock = RobotClock((asked[0] + t) / 2 - robot, t - asked[0])

    def _number(self) -> int:
        self.seq = (self.seq + 1) % WHOLE
        return self.seq


class MishLink:
    """The open robot's own layout: six numbers down, twelve up; no sequence, no clock, no watchdog, no word for arming.

    Args:
        firmware: "mish-0.1.0" as published, or "fixed".
    """

    watched, greets = False, False
    robot_clock: RobotClock | None = None

    def __init__(self, transport: Transport, firmware: "mish.Firmware" = "fixed"):
        self.transport, self.firmware = transport, firmware
        self.lacks: tuple[str, ...] = (*mish.LACKS, "letting go", *(("joint angles",) if firmware == "mish-0.1.0" else ()))
        self.name = f"mish-{firmware.removeprefix('mish-')}"
        self.counts = {"packets": 0, "bad": 0, "old": 0}

    def open(self) -> None:
        self.transport.open()

    def close(self) -> None:
        self.transport.close()

    def silence(self) -> str:
        return ""

    def forget(self) -> None:
        """Nothing is remembered."""

    def hello(self, now: float) -> None:
        """The robot speaks unasked."""

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Its servos have torque from the first command on."""

    def disarm(self, now: float) -> None:
        """It cannot be told to let go: the last angles stay."""

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad, at once."""
        data = mish.encode_command(tuple(map(float, joint)))
        self.transport.send(data)
        return Sent(None, now, data)

    def receive(self, now: float) -> list[Received]:
        """What arrived since the last call; nothing tells an old packet from a new one."""
        found = []
        for t, data in self.transport.receive():
            try:
                found.append(Received(t, mish.decode_telemetry(data)))
                self.counts["packets"] += 1
            except ProtocolError:
                self.counts["bad"] += 1
        return found
