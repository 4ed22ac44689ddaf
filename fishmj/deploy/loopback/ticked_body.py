"""Bodies that are simulated by bus ticks of 20 ms, and their state between the ends of a tick.

A tick is simulated when its beginning is reached, so the body is up to 20 ms ahead of the loopback's clock. That is causal,
because a command needs longer than a tick from the microcontroller to the servo; a faster one waits for the next tick. Between
the ends of a tick the state follows the cubic through both states and both rates:

    q(s) = q0 + s (h v0 + s (3 d - 2 h v0 - h v1 + s (h v0 + h v1 - 2 d))),   d = q1 - q0,  s in [0, 1],  h = 20 ms
"""

from bisect import insort
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from fishmj.deploy.loopback.loopback_body import MILLISECOND, BodyReadings, bus_delay, whole_milliseconds
from fishmj.mjcf.description import Robot
from fishmj.mjcf.servos import on_the_bus


class Moment(NamedTuple):
    """A state at the end of a tick: coordinates and rates (3 + J,) m, rad, m/s, rad/s; mean power of the servos in it, W."""

    q: np.ndarray
    v: np.ndarray
    watts: float = 0.0


class TickedBody:
    """Base of the bodies by ticks; see `body.Body`. A subclass simulates one tick.

    Args:
        zero: (J,) rad, hinge angles at which the servos read zero. start: x, y [m], yaw [rad].
        radio: s of the nominal command latency in the radio. late: s that effects of the description add to it.

    Attributes:
        on: True if the servos have torque. `supply` changes the measured voltage, not the motors.
    """

    def __init__(self, robot: Robot, zero, start: tuple[float, float, float], radio: float, late: float = 0.0):
        timing, self.robot, self.zero = robot.timing, robot, np.asarray(zero, float)
        self.on = True
        self._delay = bus_delay(robot, radio) + late
        self._tick, self._step = round(timing.bus_dt / MILLISECOND), round(timing.physics_dt / MILLISECOND)
        self._now = self._ticks = 0  # ms asked for, ticks done
        self._waiting: list[tuple[float, np.ndarray]] = []  # (s, (J,) rad) on their way to the servos
        self._goal = np.zeros(robot.n_joints)
        self._jams: dict[int, float] = {}
        self._volts: float | None = None
        self._begin = self._end = Moment(np.array([*start, *self.zero]), np.zeros(3 + robot.n_joints))

    def tick(self, goals: np.ndarray) -> Moment:
        """Simulates one tick; goals (S, J) rad are the servos' targets in each of its physics steps."""
        raise NotImplementedError

    @property
    def time(self) -> float:
        """Time since the body began, s."""
        return self._now * MILLISECOND

    def send(self, command: Sequence[float] | np.ndarray) -> None:
        """Puts joint angles (J,) [rad] on the servo bus now; they arrive after the bus's delay."""
        due = self.time + self._delay, on_the_bus(self.robot.servo, np.asarray(command, float))
        insort(self._waiting, due, key=itemgetter(0))

    def advance(self, seconds: float) -> None:
        """Advances by whole milliseconds; seconds: s."""
        self._now += whole_milliseconds(seconds)
        while self._ticks * self._tick < self._now:
            self._begin = self._end
            self._end = self.tick(self._goals())
            self._ticks += 1

    def sensors(self) -> BodyReadings:
        """Present readings."""
        servo = self.robot.servo
        volts = servo.voltage if self._volts is None else self._volts
        watts = servo.idle_power + (self._end.watts if self.on else 0.0)
        return BodyReadings(self.truth()[3:] - self.zero, volts, watts / max(volts, 1.0))

    def truth(self) -> np.ndarray:
        """(3 + J,): x, y [m], yaw [rad] of the reference point, hinge angles [rad]."""
        (q0, v0, _), (q1, v1, _) = self._begin, self._end
        h = self._tick * MILLISECOND
        s = 1.0 - (self._ticks * self._tick - self._now) / self._tick
        d, a, b = q1 - q0, h * v0, h * v1
        return q0 + s * (a + s * (3.0 * d - 2.0 * a - b + s * (a + b - 2.0 * d)))

    def seen(self) -> tuple[float, np.ndarray]:
        """Time [s] and true pose: this camera has no planted errors."""
        return self.time, self.truth()

    def torque(self, on: bool) -> None:
        """Switches the servos' torque."""
        self.on = on

    def supply(self, volts: float | None) -> None:
        """Sets the measured open-circuit voltage [V]; None: the battery's."""
        self._volts = volts

    def jam(self, joint: int, stuck: bool) -> None:
        """Jams the gears of a joint (0 at the head) at its present angle, or frees them."""
        if stuck and joint not in self._jams:
            self._jams[joint] = float(self.truth()[3 + joint] - self.zero[joint])
        elif not stuck:
            self._jams.pop(joint, None)

    def _goals(self) -> np.ndarray:
        """Targets of the servos in each physics step of the tick that begins now, (S, J) rad."""
        begin, goals = self._ticks * self._tick, []
        for step in range(begin, begin + self._tick, self._step):
            while self._waiting and self._waiting[0][0] <= (step + 0.5) * MILLISECOND:
                self._goal = self._waiting.pop(0)[1]
            goals.append(self._goal)
        out = np.array(goals)
        for joint, angle in self._jams.items():
            out[:, joint] = angle
        return out
