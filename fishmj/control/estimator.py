"""Estimate of target, velocity and heading from the 11 observations, in axes that do not turn with the fish.

In each beat the head yaws by up to 40 deg and the reference point sways by up to 4 cm. The joint angles explain nine tenths of
both (`gait_table.measure`), so the beat is subtracted by them, without the delay of a filter:

    omega = w + c . K,     psi = integral of omega           heading of the swimming direction and its rate
    r + n s . J,           v - n s . K                       target from, and velocity of, the path's centre; n = left of psi

The pose is late by the camera's latency, and velocities by half the tracker's window more. Joint angles have no latency, so they
are interpolated back to those times (cubic Hermite between the last two control steps). The axes are those of the fish at reset;
they drift with the noise of w, by some 0.2 rad in a minute, which is slow enough.
"""

from typing import NamedTuple

import numpy as np

from fishmj.mjcf.description import Robot


class StateEstimate(NamedTuple):
    """Target, velocity and heading of the fish, in axes fixed at reset."""

    target: np.ndarray  # (B, 2) m, from the centre of the fish's path to the target
    velocity: np.ndarray  # (B, 2) m/s over ground, without the beat
    heading: np.ndarray  # (B,) rad, of the swimming direction, not wrapped, extrapolated to now
    turn: np.ndarray  # (B,) rad/s, its rate
    head: np.ndarray  # (B,) rad, of the body axes now: heading with the beat


class StateEstimator:
    """Turns observations (B, 5 + 2 J) into state estimates, one call in each control step.

    Args:
        robot: gives the nominal latencies and the control step.
        wobble: (J,) c, head yaw per joint angle, rad/rad.
        sway: (J,) s, displacement to the left per joint angle, m/rad.
    """

    def __init__(self, robot: Robot, wobble, sway):
        t = robot.timing
        self.wobble, self.sway, self.dt = np.asarray(wobble, float), np.asarray(sway, float), t.control_dt
        self.pose_age = t.camera_latency
        self.rate_age = t.camera_latency + (t.velocity_window - 1) * t.bus_dt / 2
        self.reset(0)

    def reset(self, n: int) -> None:
        """Clears the memory; the next observation defines the axes."""
        self.heading = np.zeros(n)  # at the time of the rates
        self.turn: np.ndarray | None = None
        self.before: tuple | None = None

    def __call__(self, obs) -> StateEstimate:
        """State estimate from an observation."""
        j = len(self.wobble)
        target, velocity, rate, joint, joint_rate = obs[:, :2], obs[:, 2:4], obs[:, 4], obs[:, 5 : 5 + j], obs[:, 5 + j :]
        old, old_rate = self.before or (joint, joint_rate)
        then = lambda age: hermite(old, old_rate, joint, joint_rate, self.dt, 1 - age / self.dt)
        (bend, _), (bend_rates, speed) = (
            then(self.pose_age),
            then(self.rate_age),
        )  # when the picture was taken, and at the middle of the velocity window
        turn = rate + speed @ self.wobble
        if self.turn is not None:
            self.heading = self.heading + self.dt * 0.5 * (turn + self.turn)
        self.turn, self.before = turn, (joint, joint_rate)
        seen, met = self.heading + (self.rate_age - self.pose_age) * turn, self.heading
        place = turned(target, seen - bend @ self.wobble) + across(seen, bend @ self.sway)
        motion = turned(velocity, met - bend_rates @ self.wobble) - across(met, speed @ self.sway)
        heading = self.heading + self.rate_age * turn
        return StateEstimate(place, motion, heading, turn, heading - joint @ self.wobble)


def hermite(a, da, b, db, h: float, s: float):
    """Value and rate at a + s h of the cubic through (a, da) and (b, db), h apart."""
    value = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * h * da + s * s * (3 - 2 * s) * b + s * s * (s - 1) * h * db
    rate = 6 * s * (1 - s) * (b - a) / h + (1 - s) * (1 - 3 * s) * da + s * (3 * s - 2) * db
    return value, rate


def across(heading, amount):
    """Vectors (B, 2) of length `amount` (B,) to the left of `heading` (B,)."""
    return amount[:, None] * np.stack([-np.sin(heading), np.cos(heading)], -1)


def turned(vectors, angle):
    """Vectors (B, 2) turned by angle (B,) counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]], -1)
