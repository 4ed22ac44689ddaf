"""The policy's observation from fixes and telemetry: the same vector as in training (`fishmj.tasks.station_hold.observe`).

    poses     fixes of the camera at bus ticks back from the newest one: t_k = t_newest - k dt, linear between fixes
    velocity  the slope of a line through the last `velocity_window` of them, the filter that training simulates
    rates     the slope of a line through the last RATE_WINDOW joint readings, by the robot's own stamps if it has a clock

A fix at a place that the fish cannot have reached is refused and reported as a jump; the pose then just ages.
"""

from collections import deque
from math import pi
from typing import NamedTuple

import numpy as np

from fishmj.deploy.protocols.messages import Telemetry
from fishmj.deploy.tracker.fix import Fix
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold

RATE_WINDOW = 3  # readings: 20 ms late, sigma / (28 ms): 0.18 rad/s for readings of 0.3 degrees
FASTEST, TURNS = 1.5, 8.0  # m/s, rad/s: beyond any swimming of a fish of half a metre
SLACK, TWIST = 0.05, 0.35  # m, rad: noise of two fixes
MEMORY = 0.2  # s; after a longer pause a fix may be no further away than after this one
KEPT = 100  # fixes and readings


class Pose(NamedTuple):
    """An accepted fix; yaw is unwrapped. `heard`: time at which it reached the loop, s."""

    t: float
    x: float
    y: float
    yaw: float
    heard: float


class JointReading(NamedTuple):
    """Joint angles (J,) rad; t s on the even clock (the robot's, else arrival); heard: s, arrival on the host's clock."""

    t: float
    joint: tuple[float, ...]
    heard: float


class ObservationBuilder:
    """Collects fixes and readings, and computes the observation.

    Args:
        robot: gives timing and joint count. target: (x, y) m in the tank.

    Attributes:
        jumped: True if the newest fix was refused. jumps, late: numbers of refused fixes and of fixes older than an earlier one.
        changed: time of the newest fix that differs from the one before, s: a camera that hangs repeats one picture.
    """

    def __init__(self, robot: Robot, target: tuple[float, float]):
        self.robot, self.target = robot, target
        self.jumped, self.jumps, self.late = False, 0, 0
        self.changed: float | None = None
        self._poses: deque[Pose] = deque(maxlen=KEPT)
        self._readings: deque[JointReading] = deque(maxlen=RATE_WINDOW)

    def forget_poses(self) -> None:
        """Accepts the next fix at any place."""
        self._poses.clear()
        self.jumped, self.changed = False, None

    def fix(self, seen: Fix, now: float) -> Pose | None:
        """Adds one fix; returns its pose, or None if it is refused or older than the newest."""
        yaw = seen.yaw
        if not np.isfinite((seen.t, seen.x, seen.y, yaw)).all():
            self.jumped, self.jumps = True, self.jumps + 1
            return None
        if self._poses and seen.t <= self._poses[-1].t:
            self.late += 1
            return None
        if self._poses:
            last = self._poses[-1]
            turn = (yaw - last.yaw + pi) % (2 * pi) - pi
            span = min(seen.t - last.t, MEMORY)
            far = np.hypot(seen.x - last.x, seen.y - last.y)
            self.jumped = bool(far > FASTEST * span + SLACK or abs(turn) > TURNS * span + TWIST)
            if self.jumped:
                self.jumps += 1
                return None
            yaw = last.yaw + turn
        found = Pose(seen.t, seen.x, seen.y, yaw, now)
        if self.changed is None or found[1:4] != self._poses[-1][1:4]:
            self.changed = found.t
        self._poses.append(found)
        return found

    def telemetry(self, heard: float, packet: Telemetry) -> None:
        """Adds the joints of one packet."""
        t = heard if packet.time is None else packet.time
        if self._readings and t <= self._readings[-1].t:
            self._readings.clear()  # the robot's clock began anew
        self._readings.append(JointReading(t, tuple(packet.joint), heard))

    @property
    def pose(self) -> Pose | None:
        """The newest pose."""
        return self._poses[-1] if self._poses else None

    @property
    def reading(self) -> JointReading | None:
        """The newest reading."""
        return self._readings[-1] if self._readings else None

    def joints(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Joint angles and rates (J,), rad and rad/s; None until there are RATE_WINDOW readings."""
        if len(self._readings) < RATE_WINDOW:
            return None
        t = np.array([reading.t for reading in self._readings])
        angle = np.array([reading.joint for reading in self._readings])
        away = t - t.mean()
        return angle[-1], away @ angle / (away @ away)

    def poses(self) -> np.ndarray | None:
        """(W, 3) poses on bus ticks, oldest first, ending at the newest fix; None until they reach back far enough."""
        if not self._poses:
            return None
        window, dt = self.robot.timing.velocity_window, self.robot.timing.bus_dt
        t, x, y, yaw = np.array([pose[:4] for pose in self._poses]).T
        ticks = t[-1] + np.arange(1 - window, 1) * dt
        if ticks[0] < t[0] - 1e-6:
            return None
        return np.stack([np.interp(ticks, t, column) for column in (x, y, yaw)], 1)

    def vector(self) -> np.ndarray | None:
        """The observation (5 + 2 J,): target and velocity in the body frame, yaw rate, joints, rates; None if incomplete."""
        poses, joints = self.poses(), self.joints()
        if poses is None or joints is None:
            return None
        angle, rate = joints
        still = np.zeros((1, 5 + 2 * len(angle)))
        target, now = np.array([self.target], float), np.zeros(1, int)
        return station_hold.observe(np, self.robot, poses[None], now, angle[None], rate[None], target, still)[0]
