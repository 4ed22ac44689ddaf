"""Links to a robot over a transport: greet, arm, command, listen, disarm. One class a protocol, all with one interface.

Values that a protocol lacks are None, and `lacks` names them; the arming rules decide the consequences.
"""

from typing import NamedTuple, Protocol

import numpy as np

from fishmj.deploy.link.transports import Transport
from fishmj.deploy.protocols import PROTOCOLS, fishmj1, mish
from fishmj.deploy.protocols.messages import RobotInfo, Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.sequence import SequenceGate

WHOLE = 2**32  # sequence numbers wrap here


class Sent(NamedTuple):
    """One command as sent: seq is None if the protocol has none; t s on the host's clock."""

    seq: int | None
    t: float
    data: bytes


class Received(NamedTuple):
    """One packet as received, t s on the host's clock."""

    t: float
    value: Telemetry | RobotInfo


class RobotClock(NamedTuple):
    """Estimate of the robot's clock from a question and its answer.

        ahead = (t_asked + t_heard) / 2 - t_robot,    wrong by at most round_trip / 2

    Attributes:
        ahead: s, the host's clock minus the robot's. round_trip: s, from the question to the answer.
    """

    ahead: float
    round_trip: float


class RobotLink(Protocol):
    """Interface of a link, used by the loop.

    Attributes:
        name: of the protocol. lacks: missing messages and functions, a phrase each. watched: True if the robot has a watchdog.
        greets: True if the robot identifies itself.
        counts: bad (no message at all), old (late or repeated, dropped), packets.
        robot_clock: None if the robot does not report it.
    """

    name: str
    lacks: tuple[str, ...]
    watched: bool
    greets: bool
    counts: dict[str, int]
    robot_clock: RobotClock | None

    def open(self) -> None:
        """Opens the transport."""

    def hello(self, now: float) -> None:
        """Asks the robot to identify itself."""

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Requests torque; hold, neutral: the watchdog's times, s."""

    def disarm(self, now: float) -> None:
        """Requests torque off."""

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Commands joints (J,) rad."""

    def receive(self, now: float) -> list[Received]:
        """Packets that arrived since the last call."""

    def forget(self) -> None:
        """Resets the memory of earlier packets, for a robot that may have restarted."""

    def close(self) -> None:
        """Closes the transport."""

    def silence(self) -> str:
        """Reason for the silence of the robot, "" if no other is known."""


class TransportLink:
    """Common part of the links whose transport carries whole packets."""

    robot_clock: RobotClock | None = None

    def __init__(self, transport: Transport):
        self.transport = transport
        self.counts = {"packets": 0, "bad": 0, "old": 0}

    def open(self) -> None:
        """Opens the transport."""
        self.transport.open()

    def close(self) -> None:
        """Closes the transport."""
        self.transport.close()

    def silence(self) -> str:
        """Returns "": this protocol gives no reason for silence."""
        return ""


class Fishmj1Link(TransportLink):
    """Protocol `fishmj-1`: sequence numbers, echo, the robot's clock, a watchdog of its own."""

    name, watched, greets = "fishmj-1", True, True
    lacks: tuple[str, ...] = ()

    def __init__(self, transport: Transport):
        super().__init__(transport)
        self.seq = 0
        self.robot_clock = None  # of the quickest answer since `forget`
        self._gate = SequenceGate()
        self._asked: list[float] = []  # s, of the questions that wait for their answer

    def forget(self) -> None:
        """Accepts any next sequence number, since the robot may have restarted."""
        self._gate.forget()
        self.robot_clock = None

    def hello(self, now: float) -> None:
        """Asks the robot to identify itself."""
        self._asked.append(now)
        self.transport.send(fishmj1.encode_hello(self._number(), now))

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Requests torque, with the watchdog's times in s."""
        self._asked.append(now)
        self.transport.send(fishmj1.encode_arm(self._number(), now, hold, neutral))

    def disarm(self, now: float) -> None:
        """Requests torque off."""
        self.transport.send(fishmj1.encode_disarm(self._number(), now))

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad."""
        seq = self._number()
        data = fishmj1.encode_command(seq, now, tuple(map(float, joint)))
        self.transport.send(data)
        return Sent(seq, now, data)

    def receive(self, now: float) -> list[Received]:
        """Packets that arrived since the last call; old and repeated telemetry is dropped and counted."""
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
        """Updates the robot's clock from an answer with its time `robot`, received at t; one of two open questions was lost."""
        asked, self._asked = self._asked, []
        if len(asked) == 1 and (self.robot_clock is None or t - asked[0] < self.robot_clock.round_trip):
            self.robot_clock = RobotClock((asked[0] + t) / 2 - robot, t - asked[0])

    def _number(self) -> int:
        self.seq = (self.seq + 1) % WHOLE
        return self.seq


class MishLink(TransportLink):
    """The open robot's own layout: six numbers down, twelve up; no sequence number, clock, watchdog or arming message.

    Args:
        firmware: "mish-0.1.0" as published, or "fixed".
    """

    watched, greets = False, False

    def __init__(self, transport: Transport, firmware: "mish.Firmware" = "fixed"):
        super().__init__(transport)
        self.firmware = firmware
        self.lacks: tuple[str, ...] = (*mish.LACKS, "letting go", *(("joint angles",) if firmware == "mish-0.1.0" else ()))
        self.name = f"mish-{firmware.removeprefix('mish-')}"

    def forget(self) -> None:
        """Does nothing: this link keeps no memory."""

    def hello(self, now: float) -> None:
        """Does nothing: the robot sends without a request."""

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Does nothing: the servos have torque from the first command on."""

    def disarm(self, now: float) -> None:
        """Does nothing: the protocol has no such message, and the last angles stay."""

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad, at once."""
        data = mish.encode_command(tuple(map(float, joint)))
        self.transport.send(data)
        return Sent(None, now, data)

    def receive(self, now: float) -> list[Received]:
        """Packets that arrived since the last call; old packets cannot be told from new ones."""
        found = []
        for t, data in self.transport.receive():
            try:
                found.append(Received(t, mish.decode_telemetry(data)))
                self.counts["packets"] += 1
            except ProtocolError:
                self.counts["bad"] += 1
        return found


def datagram_link(protocol: str, transport: Transport) -> RobotLink:
    """The link, not opened yet, that speaks one of `PROTOCOLS` in datagrams."""
    if protocol == PROTOCOLS[0]:
        return Fishmj1Link(transport)
    return MishLink(transport, "fixed" if protocol == "mish-fixed" else "mish-0.1.0")
