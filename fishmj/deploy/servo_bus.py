"""The servo bus itself over a USB adapter, without any microcontroller: what firmware would do, done by the host.

Every tick asks each servo for its position, and one of them for voltage and temperature in turn; a servo that does not answer is
asked twice more, as long as the tick has time for it. Servos hold the last angle when the host is gone: nothing watches.

Question and answer take 1.2 ms on the wire.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fishmj.deploy.clock import Clock
from fishmj.deploy.links import Received, RobotClock, Sent
from fishmj.errors import ConfigError
from fishmj.protocols import lx_bus, servo_counts
from fishmj.protocols.lx_bus import Code
from fishmj.protocols.messages import ServoFault, Telemetry

RETRIES = 2
ANSWER = (
    0.003  # s that a servo has: USB adapters hold bytes back for 1 to 2 ms (an FTDI chip only with its latency timer at 1 ms)
)
BUDGET = 0.012  # s of a tick for questions; what is left is the policy's
FORGOTTEN = 3.0  # s after which a voltage or temperature that was not read again counts as none; each is read every 0.12 s
STALE = 0.1  # s after which a servo that nobody had time to ask counts as lost
SLOW = ((Code.VIN_READ, "volts"), (Code.TEMP_READ, "degrees"))


class ServoBusLink:
    """LX servos on one wire.

    Args:
        opened: makes the serial line, an object with read(n), write(data), in_waiting, close(); raises ConfigError.
        ids: of the servos, from the head to the tail. zeros: rad, where each stands when its joint is straight.
        signs: 1 or -1, where a servo turns the other way round. move_time: s that a servo takes over each command, 0: at once.
    """

    name, watched, greets = "lx-bus", False, False
    lacks: tuple[str, ...] = ("watchdog", "echo", "state", "robot time", "battery current", "info")
    robot_clock: RobotClock | None = None

    def __init__(
        self, opened: Callable[[], Any], clock: Clock, ids: Sequence[int], zeros: Sequence[float] | None = None,
        signs: Sequence[int] | None = None, move_time: float = 0.0,
    ):  # fmt: skip
        self.ids, self.zeros = tuple(ids), tuple(zeros or (0.0,) * len(ids))
        self.signs = tuple(signs or (1,) * len(ids))
        if len(set(self.ids)) != len(self.ids) or not len(self.ids) == len(self.zeros) == len(self.signs):
            raise ConfigError(f"servo bus: ids {self.ids}, zeros {self.zeros}, signs {self.signs}; expected one of each a joint")
        self._opened, self.clock, self.move_time = opened, clock, round(1000 * move_time)
        self.counts = {"packets": 0, "bad": 0, "old": 0, "asked_again": 0}
        self._port: Any = None
        self.forget()

    def open(self) -> None:
        """Take the line. Raises ConfigError."""
        self._port = self._opened()

    def close(self) -> None:
        """Give the line back."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def forget(self) -> None:
        """No servo has answered yet."""
        self._reader = lx_bus.Reader()
        self._turn = 0
        self._joint: dict[int, float] = {}
        self._heard: dict[int, float] = {}
        self._slow: dict[str, dict[int, tuple[float, float]]] = {"volts": {}, "degrees": {}}

    def hello(self, now: float) -> None:
        """Servos answer only what they are asked, at every tick."""

    def arm(self, now: float, hold: float, neutral: float) -> None:
        """Torque on."""
        self._tell(Code.LOAD_OR_UNLOAD_WRITE, 1)

    def disarm(self, now: float) -> None:
        """Torque off."""
        self._tell(Code.LOAD_OR_UNLOAD_WRITE, 0)

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Command joints (J,) rad."""
        frames = [
            lx_bus.encode(servo, Code.MOVE_TIME_WRITE, servo_counts.counts(sign * float(angle), zero), self.move_time)
            for servo, angle, zero, sign in zip(self.ids, joint, self.zeros, self.signs, strict=True)
        ]
        data = b"".join(frames)
        self._write(data)
        return Sent(None, now, data)

    def receive(self, now: float) -> list[Received]:
        """Ask every servo now; one packet, once each has answered at least once."""
        end, silent = now + BUDGET, set()
        for place, servo in enumerate(self.ids):
            values, tries = self._ask(servo, Code.POS_READ, end)
            if values is None:
                if tries > RETRIES or now - self._heard.get(servo, now) > STALE:
                    silent.add(servo)
                continue
            self._joint[servo] = self.signs[place] * servo_counts.angle(values[0], self.zeros[place])
            self._heard[servo] = now
        code, what = SLOW[self._turn % len(SLOW)]
        servo = self.ids[self._turn // len(SLOW) % len(self.ids)]
        values = self._ask(servo, code, end, most=1)[0] if servo not in silent else None
        if values is not None:
            self._slow[what][servo] = now, servo_counts.volts(values[0]) if what == "volts" else float(values[0])
        self._turn += 1
        if len(self._joint) < len(self.ids) or len(silent) == len(self.ids):
            return []
        self.counts["packets"] += 1
        return [Received(self.clock.now(), self._packet(silent, now))]

    def _packet(self, silent: set[int], now: float) -> Telemetry:
        volts, degrees = (
            {servo: value for servo, (t, value) in self._slow[what].items() if now - t <= FORGOTTEN}
            for what in ("volts", "degrees")
        )
        return Telemetry(
            joint=tuple(self._joint[servo] for servo in self.ids),
            servo_voltage=tuple(volts[servo] for servo in self.ids) if len(volts) == len(self.ids) else None,
            temperature=tuple(degrees[servo] for servo in self.ids) if len(degrees) == len(self.ids) else None,
            fault=tuple(ServoFault.NO_REPLY if servo in silent else ServoFault.NONE for servo in self.ids),
        )

    def _ask(self, servo: int, code: Code, end: float, most: int = 1 + RETRIES) -> tuple[tuple[int, ...] | None, int]:
        """What a servo answers, None where it does not by `end`, and how often it was asked."""
        for k in range(most):
            now = self.clock.now()
            if now >= end:
                return None, k
            self.counts["asked_again"] += k > 0
            self._write(lx_bus.encode(servo, code))
            if (found := self._answer(servo, code, min(now + ANSWER, end))) is not None:
                return found, k + 1
        return None, most

    def _answer(self, servo: int, code: Code, until: float) -> tuple[int, ...] | None:
        while self._port is not None and self.clock.now() < until:
            try:
                data = self._port.read(max(self._port.in_waiting, 1))
            except OSError:  # the adapter is unplugged: no answer
                break
            damaged = self._reader.damaged
            for frame in self._reader.feed(data):
                if lx_bus.answers(frame, servo, code):
                    return frame.values
            self.counts["bad"] += self._reader.damaged - damaged
        self._reader.silence()
        return None

    def _tell(self, code: Code, *values: int) -> None:
        for servo in self.ids:
            self._write(lx_bus.encode(servo, code, *values))

    def _write(self, data: bytes) -> None:
        if self._port is not None:
            try:
                self._port.write(data)
            except OSError:  # the adapter is unplugged: servos fall silent, and that is a condition
                self.counts["bad"] += 1
