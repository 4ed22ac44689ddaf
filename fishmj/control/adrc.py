"""Proportional navigation, alone (PNL) and with active disturbance rejection: the baselines ADRC-C1, C2, C3.

    psi_r' = N lambda' + k wrap(lambda - psi_r)                       lambda the line of sight [rad], N and k: navigation
    psi''  = f + b0 bias                                              f: everything else, estimated as z3
    bias   = (wc^2 (psi_r - z1) - 2 wc z2 - z3) / b0                  linear ADRC, poles at wc, observer poles at wo
    d'     = f_d + b_d s,   s = (-wd d - z_d) / b_d                   first-order linear ADRC on the distance; s: gait speed
    PNL    psi' = N lambda' + k wrap(lambda - psi), by the bias that gives this turning rate in still water;  s = cruise

Guelman 1971 (proportional navigation); Gao 2003 (bandwidth parametrisation). The observers are discrete current estimators
with poles exp(-wo T) (Miklosovic, Radke, Gao 2006): at T = 0.2 s an Euler step of wo = 8 rad/s would not be stable.
Differences from the sources: heading and target come from the `StateEstimator` that all baselines share, because head yaw at the
beat frequency saturates the loop. Inside `hover_radius` the gait idles at `hover_speed`, for PNL the slow end of the gait line.
"""

from collections.abc import Mapping

import numpy as np

from fishmj.base.units import wrap
from fishmj.control.cpg import Cpg, cpg_of
from fishmj.control.estimator import StateEstimator
from fishmj.control.gait_table import SpeedToGait, gait_of, throttle_of
from fishmj.mjcf.description import Robot


class ExtendedStateObserver:
    """Discrete extended state observer of order 2 or 3 for z1^(order - 1) = f + b u, all B at once."""

    def __init__(self, order: int, bandwidth: float, gain: float, dt: float):
        beta = np.exp(-bandwidth * dt)
        if order == 3:
            self.a = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1.0]])
            self.b = gain * np.array([dt * dt / 2, dt, 0])
            self.l = np.array([1 - beta**3, 1.5 * (1 - beta) ** 2 * (1 + beta) / dt, (1 - beta) ** 3 / dt**2])
        else:
            self.a = np.array([[1, dt], [0, 1.0]])
            self.b = gain * np.array([dt, 0])
            self.l = np.array([1 - beta**2, (1 - beta) ** 2 / dt])

    def start(self, first) -> None:
        """Sets the state to the measurement `first` (B,), with all derivatives zero."""
        self.z = np.zeros((len(first), len(self.b)))
        self.z[:, 0] = first

    def __call__(self, measured, u) -> np.ndarray:
        """Estimate (B, order) after a step with input u (B,) and then the measurement (B,)."""
        self.z = self.z @ self.a.T + np.asarray(u)[:, None] * self.b
        self.z = self.z + (measured - self.z[:, 0])[:, None] * self.l
        return self.z


def navigation(k: Mapping, sight, before, heading, distance, dt: float):
    """Turning rate (B,) rad/s of proportional navigation with pursuit.

    Args:
        k: gains navigation, pursuit, navigation_max [rad/s] and hover_radius [m], within which the sight's rate counts as zero.
        sight, before: (B,) rad, line of sight now and dt [s] ago. heading: (B,) rad. distance: (B,) m.
    """
    rate = np.where(distance > k["hover_radius"], wrap(np, sight - before) / dt, 0.0)
    turn = k["navigation"] * rate + k["pursuit"] * wrap(np, sight - heading)
    return np.clip(turn, -k["navigation_max"], k["navigation_max"])


class ProportionalNavigation:
    """Proportional navigation with the shared CPG; feedback is the line of sight only.

    Args:
        authority: yaw rate per bias and gait speed, (rad/s) / (rad m/s) = 1/m.
    """

    def __init__(self, name: str, cpg: Cpg, throttle: SpeedToGait, navigator: StateEstimator, authority: float, gains):
        self.name, self.cpg, self.throttle, self.navigator, self.k = name, cpg, throttle, navigator, gains
        self.authority = authority

    def reset(self, n: int) -> None:
        """Starts n fish."""
        self.cpg.reset(n)
        self.navigator.reset(n)
        self.sight: np.ndarray | None = None

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix = self.k, self.navigator(obs)
        sight = np.arctan2(fix.target[:, 1], fix.target[:, 0])
        d = np.linalg.norm(fix.target, axis=-1)
        turn = navigation(k, sight, sight if self.sight is None else self.sight, fix.heading, d, self.navigator.dt)
        self.sight = sight
        f, a = self.throttle(np.where(d > k["hover_radius"], k["cruise"], 0.0))
        most = np.radians(k["bias_deg"])
        return self.cpg(f, a, np.clip(turn / (self.authority * self.throttle.speed(f, a)), -most, most))


class Adrc:
    """Proportional navigation and ADRC over the shared CPG."""

    def __init__(self, name: str, cpg: Cpg, throttle: SpeedToGait, navigator: StateEstimator, gains):
        self.name, self.cpg, self.throttle, self.navigator, self.k = name, cpg, throttle, navigator, gains
        k, self.dt = gains, navigator.dt
        self.heading = ExtendedStateObserver(3, k["wo"], -k["b0"], self.dt)
        self.distance = ExtendedStateObserver(2, k["distance_wo"], -k["distance_b0"], self.dt)

    def reset(self, n: int) -> None:
        """Starts n fish; the first observation initialises the observers."""
        self.cpg.reset(n)
        self.navigator.reset(n)
        self.bias, self.speed = np.zeros(n), np.zeros(n)
        self.sight: np.ndarray | None = None

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        k, fix = self.k, self.navigator(obs)
        sight = np.arctan2(fix.target[:, 1], fix.target[:, 0])
        d = np.linalg.norm(fix.target, axis=-1)
        if self.sight is None:
            self.sight, self.reference = sight, fix.heading.copy()
            self.heading.start(fix.heading)
            self.distance.start(d)
        turn = navigation(k, sight, self.sight, self.reference, d, self.dt)
        self.sight, self.reference = sight, self.reference + self.dt * turn
        z = self.heading(fix.heading, self.bias)
        want = (k["wc"] ** 2 * (self.reference - z[:, 0]) - 2 * k["wc"] * z[:, 1] - z[:, 2]) / -k["b0"]
        limit = np.radians(k["bias_deg"])
        self.bias = np.clip(want, -limit, limit)
        zd = self.distance(d, self.speed)
        closing = (k["distance_wc"] * zd[:, 0] + zd[:, 1]) / k["distance_b0"]
        self.speed = np.clip(np.where(d > k["hover_radius"], closing, k["hover_speed"]), k["hover_speed"], self.throttle.top)
        f, a = self.throttle(self.speed)
        return self.cpg(f, a, self.bias)


def build(robot: Robot, name: str, gains: dict) -> Adrc | ProportionalNavigation:
    """Makes the controller for a robot, from its gains in controllers.toml."""
    gait = gait_of(robot)
    parts = name, cpg_of(robot, gait), throttle_of(gait, gains), StateEstimator(robot, gait["wobble"], gait["sway"])
    return Adrc(*parts, gains) if "wc" in gains else ProportionalNavigation(*parts, gait["turn"], gains)
