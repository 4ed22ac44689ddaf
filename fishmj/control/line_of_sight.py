"""Line-of-sight PD and position PI controllers. Neither estimates the flow; the integral of the PI compensates for it.

    pd   W = k_p r - k_d v                      r to the target, v over ground, all in axes fixed at reset
    pi   W = k_p r - k_d v + I,   I' = k_i r    |I| <= integral_max; near the target it converges to minus the flow
The course is the direction of W, the speed through the water |W|; the proportional part is limited to `approach`.
"""

from collections.abc import Mapping

import numpy as np

from fishmj.base.units import wrap
from fishmj.control.cpg import Cpg, cpg_of
from fishmj.control.estimator import StateEstimate, StateEstimator
from fishmj.control.gait_table import gait_of, throttle_of
from fishmj.mjcf.description import Robot


class HeadingSpeedController:
    """Converts course and speed of B fish to bias and throttle, for PD, PI and DOB. Gains are named in controllers.toml.

        bias = -(k_heading wrap(psi_d - psi) - k_turn psi') / (g max(s, s_floor)),   |bias| <= bias_max
        s_d  = speed max(cos(psi_d - psi), 0)                                         no thrust in a wrong direction

    The turning rate is proportional to bias and steady speed s of the gait (factor g, measured), so the gain is scheduled by s.
    A slow gait cannot turn, so a large heading error raises the amplitude towards `turn_amplitude`.
    """

    def __init__(self, robot: Robot, gait: Mapping, cpg: Cpg, gains: Mapping):
        self.cpg, self.k = cpg, gains
        self.throttle = throttle_of(gait, gains)
        self.authority = -gait["turn"]

    def reset(self, n: int) -> None:
        """Starts n oscillators at rest."""
        self.cpg.reset(n)

    @property
    def steady(self):
        """Steady speed (B,) m/s of the present gait in still water."""
        return self.throttle.speed(self.cpg.frequency, self.cpg.amplitude)

    def __call__(self, fix: StateEstimate, course, speed) -> np.ndarray:
        """Commands (B, T, J) rad for a course [rad] and a speed through the water [m/s], (B,)."""
        k = self.k
        error = wrap(np, course - fix.heading)
        f, a = self.throttle(speed * np.maximum(np.cos(error), 0.0))
        eager = np.clip(np.abs(error) / np.radians(k["turn_error_deg"]), 0, 1) ** 2
        a = np.maximum(a, eager * np.radians(k["turn_amplitude_deg"]))
        f = np.maximum(f, eager * k["turn_frequency"])
        want = k["heading"] * error - k["turn_rate"] * fix.turn
        bias = -want / (self.authority * np.maximum(self.throttle.speed(f, a), k["speed_floor"]))
        most = np.radians(k["bias_deg"])
        return self.cpg(f, a, np.clip(bias, -most, most))


def capped(vectors, most):
    """Vectors (B, 2) with their length limited to `most`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-9))


class LineOfSight:
    """Line-of-sight PD over the CPG; with the gain `integral` > 0 the vector PI."""

    def __init__(self, name: str, steering: HeadingSpeedController, navigator: StateEstimator, gains):
        self.name, self.steering, self.navigator, self.k = name, steering, navigator, gains
        self.dt = navigator.dt

    def reset(self, n: int) -> None:
        """Starts n fish, integral empty."""
        self.steering.reset(n)
        self.navigator.reset(n)
        self.integral = np.zeros((n, 2))

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix = self.k, self.navigator(obs)
        if k["integral"]:
            near = np.linalg.norm(fix.target, axis=-1, keepdims=True) < k["integral_within"]
            self.integral = capped(self.integral + self.dt * k["integral"] * fix.target * near, k["integral_max"])
        want = capped(k["position"] * fix.target, k["approach"]) - k["velocity"] * fix.velocity + self.integral
        return self.steering(fix, np.arctan2(want[:, 1], want[:, 0]), np.linalg.norm(want, axis=-1))


def build(robot: Robot, name: str, gains: dict) -> LineOfSight:
    """Makes the controller for a robot, from its gains in controllers.toml."""
    gait = gait_of(robot)
    steering = HeadingSpeedController(robot, gait, cpg_of(robot, gait), gains)
    return LineOfSight(name, steering, StateEstimator(robot, gait["wobble"], gait["sway"]), gains)
