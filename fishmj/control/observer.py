"""CPG with a flow observer ("dob"), the classical baseline for learned policies.

    v_w' = (s(f, A)^2 - v_w^2) / l               speed through the water; l the glide length, s the steady gait
    U^  <- U^ + dt / tau (v - v_w e(psi) - U^)   flow = velocity over ground - through the water; tau grows from 0
    W    = v_d + I - U^,   v_d = k (r - v t_a),  I' = k_i r

r - v t_a is the position of the target when a present command acts; |v_d| <= approach. Within `hold` of the target the fish holds
station, until it is farther than `release`. k then differs along and across the stream, the small I corrects errors of the gait
map, and W stays within `cone` of upstream, so that the fish drifts back instead of turning downstream. The course is the
direction of W, the speed its component along the course.
"""

import numpy as np

from fishmj.base.units import wrap
from fishmj.control.cpg import cpg_of
from fishmj.control.estimator import StateEstimator, turned
from fishmj.control.gait_table import gait_of
from fishmj.control.line_of_sight import HeadingSpeedController, capped
from fishmj.mjcf.description import Robot


def forward(speed, heading):
    """Vectors (B, 2) of length `speed` (B,) along `heading` (B,)."""
    return speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)


def glided(surge, steady, glide: float, dt: float):
    """Speed through the water (B,) m/s after dt [s], with a gait of steady speed (B,) m/s and a glide length [m]."""
    for _ in range(10):
        surge = surge + dt / 10 * (steady**2 - surge**2) / glide
    return surge


class FlowEstimate:
    """Estimate of the flow (B, 2) m/s, velocity over ground minus through the water, by a first-order filter.

    Args:
        time: s, final time constant, to which that of the filter grows from 0. dt: control step, s.
    """

    def __init__(self, time: float, dt: float):
        self.time, self.dt = time, dt

    def reset(self, n: int) -> None:
        """Starts n estimates of zero."""
        self.flow, self.age = np.zeros((n, 2)), 0.0

    def __call__(self, velocity, through) -> np.ndarray:
        """Flow after a step with velocities (B, 2) over ground and through the water, in axes that do not turn."""
        self.age = min(self.age + self.dt, self.time)
        self.flow = self.flow + self.dt / self.age * (velocity - through - self.flow)
        return self.flow


class FlowObserver:
    """Flow (disturbance) observer over the CPG; flow and target are in axes fixed at reset."""

    def __init__(self, name: str, steering: HeadingSpeedController, navigator: StateEstimator, gains, glide: float):
        self.name, self.steering, self.navigator, self.k, self.glide = name, steering, navigator, gains, glide
        self.dt = navigator.dt
        self.estimate = FlowEstimate(gains["observer_time"], self.dt)

    def reset(self, n: int) -> None:
        """Starts n fish with a flow estimate of zero."""
        self.steering.reset(n)
        self.navigator.reset(n)
        self.estimate.reset(n)
        self.surge = np.zeros(n)  # v_w, m/s
        self.flow = np.zeros((n, 2))  # U^, m/s
        self.offset = np.zeros((n, 2))  # m/s
        self.holding = np.zeros(n, bool)

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix = self.k, self.navigator(obs)
        self._observe(fix)
        distance = np.linalg.norm(fix.target, axis=-1)
        self.holding = np.where(self.holding, distance < k["release"], distance < k["hold"])
        gain = self.dt * k["integral"] * self.holding
        self.offset = capped(self.offset * self.holding[:, None] + gain[:, None] * fix.target, k["integral_max"])
        upstream = np.arctan2(-self.flow[:, 1], -self.flow[:, 0])
        ahead = fix.target - k["ahead"] * fix.velocity
        stream = turned(ahead, -upstream) * np.array([k["hold_along"], k["hold_across"]])
        toward = np.where(self.holding[:, None], turned(stream, upstream), k["position"] * ahead)
        want = capped(toward, k["approach"]) + self.offset - self.flow
        course = np.arctan2(want[:, 1], want[:, 0])
        cone = np.radians(k["cone_deg"])
        kept = upstream + np.clip(wrap(np, course - upstream), -cone, cone)
        course = np.where(self.holding, kept, course)
        speed = np.maximum(np.cos(course) * want[:, 0] + np.sin(course) * want[:, 1], 0.0)
        return self.steering(fix, course, speed)

    def _observe(self, fix) -> None:
        """Updates the glide model and the flow estimate by one step."""
        self.surge = glided(self.surge, self.steering.steady, self.glide, self.dt)
        self.flow = self.estimate(fix.velocity, forward(self.surge, fix.heading))


def build(robot: Robot, name: str, gains: dict) -> FlowObserver:
    """Makes the controller for a robot, from its gains in controllers.toml."""
    gait = gait_of(robot)
    steering = HeadingSpeedController(robot, gait, cpg_of(robot, gait), gains)
    return FlowObserver(name, steering, StateEstimator(robot, gait["wobble"], gait["sway"]), gains, gait["glide"])
