"""The servo bus itself over a USB adapter, without a microcontroller: the host does the work of the firmware.

Every tick asks each servo for its position, and one of them in turn for a slow measurement if the bus has one. A servo that
does not answer is asked twice more, as long as the tick has time. There is no watchdog: servos hold the last angle when the host
is gone. The differences between LX and Dynamixel servos are in `protocols.servo_bus`.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.link.links import Received, RobotClock, Sent
from fishmj.deploy.loop.clock import Clock
from fishmj.deploy.protocols import servo_counts
from fishmj.deploy.protocols.messages import ServoFault, Telemetry
from fishmj.deploy.protocols.servo_bus import BUSES, ServoBus, ServoReply

RETRIES = 2
# s that a servo has: USB adapters hold bytes back for 1 to 2 ms (an FTDI chip only with its latency timer at 1 ms)
ANSWER = 0.003
SHARE = 0.6  # of a tick for questions; what is left is the policy's
FORGOTTEN = 3.0  # s after which a voltage or temperature that was not read again counts as none; each is read every 0.12 s
STALE = 0.1  # s after which a servo that nobody had time to ask counts as lost


class ServoBusLink:
    """Servos on one wire.

    Args:
        opened: makes the serial line, an object with read(n), write(data), in_waiting, close(); raises ConfigError.
        ids: of the servos, from the head to the tail. zeros: angle of each servo for a straight joint, rad.
        signs: 1, or -1 for a servo that turns the other way. move_time: duration of each move, s, 0: at once.
        bus: kind of servos (`protocols.servo_bus.BUSES`). baud: of the line; None: the bus's own. tick: s.
        patience: s after its last answer in which a servo does not count as silent while others answer, for simulated servos.

    Raises ConfigError: a repeated id, or one outside the bus's range; a move time on a bus without one; a line too slow for so
    many servos.
    """

    watched, greets = False, False
    lacks: tuple[str, ...] = ("watchdog", "echo", "state", "robot time", "battery current", "info")
    robot_clock: RobotClock | None = None

    def __init__(
        self, opened: Callable[[], Any], clock: Clock, ids: Sequence[int], zeros: Sequence[float] | None = None,
        signs: Sequence[int] | None = None, move_time: float = 0.0, *, bus: ServoBus = BUSES["lx"], baud: int | None = None,
        tick: float = 0.02, patience: float = 0.0,
    ):  # fmt: skip
        self.ids, self.zeros = tuple(ids), tuple(zeros or (0.0,) * len(ids))
        self.signs = tuple(signs or (1,) * len(ids))
        self.bus, self.name, self.baud, self.budget = bus, f"{bus.name}-bus", baud or bus.baud, SHARE * tick
        if len(set(self.ids)) != len(self.ids):
            raise ConfigError(f"servo bus: ids {_listed(self.ids)}; two servos of one number answer at the same time")
        if not len(self.ids) == len(self.zeros) == len(self.signs):
            raise ConfigError(f"servo bus: ids {self.ids}, zeros {self.zeros}, signs {self.signs}; expected one of each a joint")
        if not all(0 <= servo <= bus.most_id for servo in self.ids):
            raise ConfigError(f"servo bus: ids {_listed(self.ids)}; {bus.name} has 0 to {bus.most_id}")
        if not set(self.signs) <= {1, -1}:
            raise ConfigError(f"servo bus: signs {_listed(self.signs)}; expected 1 or -1 for each joint")
        if move_time and not bus.moves_in_time:
            raise ConfigError(f"servo bus: command_path 'move_time', which {bus.name} does not have; take linear or hold")
        self.patience = patience
        self._opened, self.clock, self.move_time = opened, clock, round(1000 * move_time)
        if (asked := self._wire_time()) > self.budget:
            raise ConfigError(
                f"servo bus: at {self.baud} baud {len(self.ids)} servos need {1e3 * asked:.1f} ms of each tick for their answers,"
                f" {1e3 * self.budget:.1f} ms are there; set the servos and [rig] baud to a faster one, such as 1000000"
            )
        self.counts = {"packets": 0, "bad": 0, "old": 0, "asked_again": 0}
        self._port: Any = None
        self.forget()

    def open(self) -> None:
        """Opens the line. Raises ConfigError."""
        self._port = self._opened()

    def close(self) -> None:
        """Closes the line."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def forget(self) -> None:
        """Forgets all answers of the servos."""
        self._reader = self.bus.reader()
        self._turn = 0
        self._known: set[int] = set()  # servos that said what they are
        self._unfit: dict[int, str] = {}
        self._position: dict[int, int] = {}
        self._heard: dict[int, float] = {}
        self._volts: dict[int, tuple[float, float]] = {}
        self._degrees: dict[int, tuple[float, float]] = {}
        self._fault: dict[int, ServoFault] = {}

    def hello(self, now: float) -> None:
        """Does nothing: servos only answer the questions of each tick."""

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Switches torque on, at the present angles."""
        if not self.bus.moves_in_time and len(self._position) == len(self.ids):  # a goal of an earlier swim would be a jump
            self._write(self.bus.move(self._position, 0))
        self._write(self.bus.torque(self.ids, True))

    def disarm(self, now: float) -> None:
        """Switches torque off."""
        self._write(self.bus.torque(self.ids, False))

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad."""
        rows = zip(self.ids, joint, self.zeros, self.signs, strict=True)
        goals = {servo: servo_counts.counts(sign * float(q), zero, self.bus.scale) for servo, q, zero, sign in rows}
        data = self.bus.move(goals, self.move_time)
        self._write(data)
        return Sent(None, now, data)

    def receive(self, now: float) -> list[Received]:
        """Asks every servo now; returns one packet once each has answered at least once."""
        end = now + self.budget
        if len(self._known) < len(self.ids) and not self._identified(now, end):
            return []
        silent = self._ask(self.bus.each, self.ids, now, end)
        if self.bus.turns:
            question = self.bus.turns[self._turn % len(self.bus.turns)]
            servo = self.ids[self._turn // len(self.bus.turns) % len(self.ids)]
            if servo not in silent:
                self._ask(question, (servo,), now, end, retries=0)
            self._turn += 1
        if len(self._position) < len(self.ids) or len(silent) == len(self.ids):
            return []
        self.counts["packets"] += 1
        lost = {servo for servo in silent if now - self._heard.get(servo, -inf) >= self.patience}
        return [Received(self.clock.now(), self._packet(lost, now))]

    def silence(self) -> str:
        """Reason for a missing packet: the servos that did not answer, and those that did."""
        asked = f"asked {self.bus.name} servos {_listed(self.ids)} at {self.baud} baud"
        if self._unfit:
            return "; ".join(f"servo {servo} {why}" for servo, why in self._unfit.items())
        there = [servo for servo in self.ids if servo in self._heard]
        missing = [servo for servo in self.ids if servo not in self._heard]
        if not there:
            return (
                f"no servo answers ({asked}): look at the servos' power and the adapter, then at bus, baud and servo_ids in [rig]"
            )
        if not missing:
            return "no servo answers any more, though each did: look at the servos' power and the adapter"
        joints = ", ".join(str(self.ids.index(servo) + 1) for servo in missing)
        several = len(missing) > 1
        return (
            f"servo{'s' if several else ''} {_listed(missing)} (joint{'s' if several else ''} {joints} from the head)"
            f" {'do' if several else 'does'} not answer, {_listed(there)} {'do' if len(there) > 1 else 'does'};"
            " look at the plug, or give the servo's own number (servo_ids in [rig], --servo-ids)"
        )

    def _identified(self, now: float, end: float) -> bool:
        """Asks each servo for its model; returns True once all have answered that they are of this bus."""
        if not self.bus.first:
            return True
        self._ask(self.bus.first, [servo for servo in self.ids if servo not in self._known], now, end, retries=1)
        return len(self._known) == len(self.ids)

    def _packet(self, silent: set[int], now: float) -> Telemetry:
        recent = lambda said: tuple(said[s][1] for s in self.ids if s in said and now - said[s][0] <= FORGOTTEN)
        volts, degrees, rows = recent(self._volts), recent(self._degrees), zip(self.ids, self.zeros, self.signs, strict=True)
        return Telemetry(
            joint=tuple(sign * servo_counts.angle(self._position[s], zero, self.bus.scale) for s, zero, sign in rows),
            servo_voltage=volts if len(volts) == len(self.ids) else None,
            temperature=degrees if len(degrees) == len(self.ids) else None,
            fault=tuple(
                self._fault.get(s, ServoFault.NONE) | (ServoFault.NO_REPLY if s in silent else ServoFault.NONE) for s in self.ids
            ),
        )

    def _ask(self, question: str, servos: Sequence[int], now: float, end: float, retries: int = RETRIES) -> set[int]:
        """Asks a question and stores the answers. Returns the servos that count as silent.

        Silent ones of a group are asked again one by one: on some buses a missing servo silences those behind it.
        """
        silent: set[int] = set()
        for group in (tuple(servos),) if self.bus.together else [(servo,) for servo in servos]:
            found, tries = self._asked_once(question, group, end)
            for servo in (servo for servo in group if servo not in found):
                asked = int(tries)
                while servo not in found and asked and asked <= retries and self.clock.now() < end:
                    self.counts["asked_again"] += 1
                    found |= self._asked_once(question, (servo,), end)[0]
                    asked += 1
                if servo not in found and (asked > retries or now - self._heard.get(servo, now) > STALE):
                    silent.add(servo)
            for answer in found.values():
                self._keep(answer, now)
        return silent

    def _asked_once(self, question: str, servos: Sequence[int], end: float) -> tuple[dict[int, ServoReply], bool]:
        """Answers of the servos by `end`, and True if there was time to ask."""
        now, found = self.clock.now(), {}
        if now >= end or not servos:
            return {}, False
        self._write(self.bus.ask(question, servos))
        until = min(now + ANSWER + (len(servos) - 1) * (10 * self.bus.size(question) / self.baud + self.bus.delay), end)
        late = False  # the line is read once more after the time is up: a computer that was busy elsewhere finds answers there
        while self._port is not None and not late and len(found) < len(servos):
            late = self.clock.now() >= until
            try:
                data = self._port.read(max(self._port.in_waiting, 1)) if not late or self._port.in_waiting else b""
            except OSError:  # the adapter is unplugged: no answer
                break
            damaged = self._reader.damaged
            for frame in self._reader.feed(data):
                answer = self.bus.answer(frame)
                if answer is not None and answer.question == question and answer.servo in servos:
                    found[answer.servo] = answer
            self.counts["bad"] += self._reader.damaged - damaged
        if len(found) < len(servos):
            self._reader.silence()
        return found, True

    def _keep(self, answer: ServoReply, now: float) -> None:
        servo = answer.servo
        self._heard[servo] = now
        if answer.question == self.bus.first:
            self._unfit.pop(servo, None)
            if answer.unfit:
                self._unfit[servo] = answer.unfit
            else:
                self._known.add(servo)
        if answer.position is not None:
            self._position[servo] = answer.position
        if answer.volts is not None:
            self._volts[servo] = now, answer.volts
        if answer.degrees is not None:
            self._degrees[servo] = now, answer.degrees
        if answer.fault is not None:
            self._fault[servo] = answer.fault

    def _wire_time(self) -> float:
        """Time that the questions and answers of a tick take on the wire, s."""
        bus, one = self.bus, self.ids[:1]
        asked = [self.ids] if bus.together else [(servo,) for servo in self.ids]
        size = sum(len(bus.ask(bus.each, group)) for group in asked) + len(self.ids) * bus.size(bus.each)
        size += max((len(bus.ask(question, one)) + bus.size(question) for question in bus.turns), default=0)
        return 10 * size / self.baud + (len(self.ids) + bool(bus.turns)) * bus.delay

    def _write(self, data: bytes) -> None:
        if self._port is not None:
            try:
                self._port.write(data)
            except OSError:  # the adapter is unplugged: servos fall silent, and that is a condition
                self.counts["bad"] += 1


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))
