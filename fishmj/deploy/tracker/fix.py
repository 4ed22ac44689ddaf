"""A pose that a tracker found in one frame, and the interface of every tracker.

`PosePredictor` predicts the fish's place in the next frame. A frame without the fish there is searched as a whole.
"""

from typing import NamedTuple, Protocol

import numpy as np

FASTEST, SPINNING = 0.8, 6.0  # m/s, rad/s: what a fish of this size does at most, twice
FORGOTTEN = 0.5  # s without a fix after which the whole frame is searched at once
RECENT = 0.1  # s between two fixes that a velocity is taken from
NEW = 0.5  # share of the newest in the velocity
AHEAD = 0.05  # s that the velocity is trusted for: a swimming head turns back after a quarter of a second


class Fix(NamedTuple):
    """Pose of the fish's reference point in the tank, at the time of the frame's stamp less the camera's lag."""

    t: float  # s, middle of the exposure
    x: float  # m
    y: float  # m
    yaw: float  # rad, -pi..pi
    covariance: np.ndarray  # (3, 3) of x, y, yaw: what noise of the pixels makes; no error of the calibration
    quality: float  # 0..1: how well the marks look as they should, times the share of them that is seen
    outline: np.ndarray = np.zeros((0, 2))  # (n, 2) px, the marks as found, for an overlay

    @property
    def pose(self) -> np.ndarray:
        """(3,) x, y, yaw."""
        return np.array([self.x, self.y, self.yaw])


class Tracker(Protocol):
    """Finds one fish, frame after frame."""

    def locate(self, image: np.ndarray, t: float) -> Fix | None:
        """The fix in a frame (H, W, 3) uint8 BGR stamped t [s]; None if there is none, or if it is ambiguous."""

    def reset(self) -> None:
        """Forgets the last pose of the fish."""


class PosePredictor:
    """Predicts the fish's pose from its last two fixes."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forgets all fixes."""
        self.last: Fix | None = None
        self.velocity = np.zeros(3)

    def add(self, fix: Fix) -> None:
        """Adds a fix."""
        before = self.last
        if before is not None and 0 < fix.t - before.t <= RECENT:
            step = fix.pose - before.pose
            step[2] = wrapped(step[2])
            limit = np.array([FASTEST, FASTEST, SPINNING])
            now = np.clip(step / (fix.t - before.t), -limit, limit)
            self.velocity += NEW * (now - self.velocity)  # waves shift a fix by millimetres: alone, two of them tell little
        else:
            self.velocity = np.zeros(3)
        self.last = fix

    def expected(self, t: float) -> tuple[np.ndarray, float, float] | None:
        """Predicted pose (3,), and the largest distance of the fish from it, m and rad; None without a fix."""
        if self.last is None or not 0 <= t - self.last.t <= FORGOTTEN:
            return None
        ahead = t - self.last.t
        pose = self.last.pose + self.velocity * min(ahead, AHEAD)
        return pose, 0.01 + FASTEST * ahead, 0.05 + SPINNING * ahead


def wrapped(angle: float) -> float:
    """An angle in -pi..pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def widened(covariance: np.ndarray, unseen: tuple[float, float]) -> np.ndarray:
    """A covariance (3, 3) of x, y, yaw with independent standard deviations, m and rad, added."""
    return covariance + np.diag(np.array([unseen[0], unseen[0], unseen[1]]) ** 2)


def rigid(body: np.ndarray, tank: np.ndarray) -> tuple[np.ndarray, float, float]:
    """The pose (3,) that best maps body points (n, 2) to tank points (n, 2); ratio of their spreads; rms distance left, m."""
    mean_b, mean_t = body.mean(0), tank.mean(0)
    b, s = body - mean_b, tank - mean_t
    yaw = np.arctan2(np.sum(b[:, 0] * s[:, 1] - b[:, 1] * s[:, 0]), np.sum(b * s))
    turned = b @ _turn(yaw).T
    left = float(np.sqrt(np.mean(np.sum((turned - s) ** 2, 1))))
    ratio = float(np.sqrt(np.sum(s * s) / np.sum(b * b)))
    return np.array([*(mean_t - _turn(yaw) @ mean_b), yaw]), ratio, left


def placed(body: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Body points (n, 2) in the tank."""
    return body @ _turn(pose[2]).T + pose[:2]


def _turn(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
