"""PD on the line of sight, and PI on the position vector. Neither knows of the flow; the PI's integral learns it.

    pd   W = k_p r - k_d v                      r to the target, v over ground, all in axes fixed at reset
    pi   W = k_p r - k_d v + I,   I' = k_i r    |I| <= integral_max; near the target it can only be minus the flow
Course = direction of W, speed through the water = |W|, the proportional part capped at `approach`.
"""

import numpy as np

from fishmj.controllers.cpg import cpg_of
from fishmj.controllers.estimator import StateEstimator
from fishmj.controllers.gains import gait_of
from fishmj.controllers.heading_speed import HeadingSpeedController
from fishmj.mjcf.description import Robot


def capped(vectors, most):
    """Vectors (B, 2) shortened to at most `most`."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-9))


class LineOfSight:
    """CPG with line-of-sight PD; with `integral` > 0 vector PI."""

    def __init__(self, name: str, steering: HeadingSpeedController, navigator: StateEstimator, gains):
        self.name, self.steering, self.navigator, self.k = name, steering, navigator, gains
        self.dt = navigator.dt

    def reset(self, n: int) -> None:
        """n fish, integral empty."""
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
    gait = gait_of(robot, name)
    steering = HeadingSpeedController(robot, gait, cpg_of(robot, gait), gains)
    return LineOfSight(name, steering, StateEstimator(robot, gait["wobble"], gait["sway"]), gains)
