"""Courses: where a fish starts and where its target goes. Pure functions of (xp, draws), one small class a task.

    station_hold      paper, Initial State Distribution: fish, target, heading and flow drawn; the target stays
    figure_eight      x = sin p cos p, y = sin p, followed at a constant speed: p(s) by arc length s
    angle_of_attack   the fish starts on its target, turned by a given angle from upstream

The paper quotes the figure eight with "constant speed", which its own parameter p is not (0.66 to 1.41 per unit of p);
arc length makes it so.
"""

from dataclasses import dataclass
from functools import cache
from math import pi
from typing import Any, NamedTuple

import numpy as np

from fishmj.calib import constant
from fishmj.engines import Trace
from fishmj.errors import ConfigError
from fishmj.tasks.station_hold import N_START, Start, draw_start

POINTS = 4096  # of the arc-length table; its error is below 1e-6 m


class EpisodeStart(NamedTuple):
    """How B episodes begin."""

    start: Start
    phase: Any  # (B,) m, arc length of the target's path already behind it; 0 where the target stays


class StepTruth(NamedTuple):
    """What a reward may look at: one control step of B episodes, T bus ticks. The truth, which no policy sees."""

    trace: Trace  # pose (B, T, 3) m, rad; joint, rate (B, T, J) rad, rad/s; velocity (B, T, 3) over ground; power (B, T) W
    target: Any  # (B, 2) m, at the end of the step
    distance: Any  # (B,) m, to it
    action: Any  # (B, J) in [-1, 1]
    time: Any  # (B,) s since the episode began, at the end of the step


@dataclass(frozen=True, kw_only=True)
class StationHoldReference:
    """Swim to a target and keep it."""

    seconds: float = constant("task", "episode_time")

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7)."""
        return EpisodeStart(draw_start(xp, uniforms), xp.zeros_like(uniforms[:, 0]))

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return launch.start.target + 0.0 * t[:, None]


@dataclass(frozen=True, kw_only=True)
class AngleOfAttackReference:
    """Start on the target, turned from upstream. angle in rad; None draws one of the paper's four."""

    decides = ("pose", "target")  # what no caller may fix of a start
    heads_by_flow = True  # the start's heading is given against the flow

    angle: float | None = None
    seconds: float = constant("task", "episode_time")

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7): target and flow direction drawn, flow speed the paper's."""
        start = draw_start(xp, uniforms)
        angles = xp.asarray(np.radians(constant("experiments", "aoa_deg")), dtype=uniforms.dtype)
        picked = angles[xp.floor(4 * uniforms[:, 2]).astype("int32") % 4]
        angle = picked if self.angle is None else self.angle + 0.0 * picked
        heading = (start.direction + pi + angle + pi) % (2 * pi) - pi
        pose = xp.concatenate([start.target, heading[:, None]], -1)
        speed = constant("experiments", "aoa_speed") + 0.0 * heading
        return EpisodeStart(start._replace(pose=pose, speed=speed), xp.zeros_like(heading))

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return launch.start.target + 0.0 * t[:, None]


@dataclass(frozen=True, kw_only=True)
class FigureEightReference:
    """Follow a point on a figure eight. phase: m along the path at t = 0; None draws it."""

    decides = ("target",)

    speed: float = constant("experiments", "figure8_speed")  # m/s
    cycles: float = constant("experiments", "figure8_cycles")
    phase: float | None = None

    def __post_init__(self):
        if not (0 < self.speed < 5 and 0 < self.cycles <= 1000):
            raise ConfigError(
                f"figure_eight: speed = {self.speed} m/s (0 to 5) or cycles = {self.cycles} (0 to 1000) is out of range"
            )

    @property
    def seconds(self) -> float:
        """Time for all cycles, s."""
        return self.cycles * path_length() / self.speed

    def launch(self, xp, uniforms) -> EpisodeStart:
        """At rest on the path, heading along it; uniforms (B, 7) give phase and flow."""
        start = draw_start(xp, uniforms)
        phase = path_length() * uniforms[:, 2] if self.phase is None else self.phase + 0.0 * uniforms[:, 2]
        point, heading = eight(xp, phase)
        return EpisodeStart(start._replace(pose=xp.concatenate([point, heading[:, None]], -1), target=point), phase)

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return eight(xp, launch.phase + self.speed * t)[0]


@cache
def _arc_table() -> tuple[np.ndarray, np.ndarray]:
    """(p, s): parameter and arc length along one cycle; Simpson's rule between the points."""
    p = np.linspace(0, 2 * pi, POINTS)
    rate = lambda p: np.hypot(np.cos(2 * p), np.cos(p))  # ds/dp
    middle = (p[1:] + p[:-1]) / 2
    pieces = (rate(p[1:]) + 4 * rate(middle) + rate(p[:-1])) / 6 * np.diff(p)
    return p, np.concatenate([[0.0], np.cumsum(pieces)])


def path_length() -> float:
    """Length of one figure eight, m."""
    return float(_arc_table()[1][-1])


def eight(xp, s):
    """Point (B, 2) [m] and direction of travel (B,) [rad] at arc lengths s (B,) [m]."""
    p_table, s_table = _arc_table()
    p = xp.interp(s % path_length(), xp.asarray(s_table), xp.asarray(p_table))
    return xp.stack([xp.sin(p) * xp.cos(p), xp.sin(p)], -1), xp.arctan2(xp.cos(p), xp.cos(2 * p))


COURSES = {"station_hold": StationHoldReference, "figure_eight": FigureEightReference, "angle_of_attack": AngleOfAttackReference}

__all__ = [
    "COURSES",
    "N_START",
    "AngleOfAttackReference",
    "FigureEightReference",
    "EpisodeStart",
    "StationHoldReference",
    "StepTruth",
    "eight",
    "path_length",
]
