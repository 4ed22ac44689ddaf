"""Course and speed to commands: what the controllers PD, PI and DOB share.

    bias = -(k_heading wrap(psi_d - psi) - k_turn psi') / (g max(s, s_floor)),   |bias| <= bias_max
    s_d  = speed max(cos(psi_d - psi), 0)                                         no thrust into a wrong direction

A bias turns the fish in proportion to the steady speed s of its gait (g, measured), so the bias is scheduled with it.
A slow gait cannot turn: with a large error the amplitude rises towards `turn_amplitude`.
"""

from collections.abc import Mapping

import numpy as np

from fishmj.controllers.cpg import Cpg
from fishmj.controllers.estimator import StateEstimate
from fishmj.controllers.gait_table import throttle_of
from fishmj.mjcf.description import Robot
from fishmj.units import wrap


class HeadingSpeedController:
    """Steers B fish by bias and throttle. Gains are named in controllers.toml."""

    def __init__(self, robot: Robot, gait: Mapping, cpg: Cpg, gains: Mapping):
        self.cpg, self.k = cpg, gains
        self.throttle = throttle_of(gait, gains)
        self.authority = -gait["turn"]

    def reset(self, n: int) -> None:
        self.cpg.reset(n)

    @property
    def steady(self):
        """Speed (B,) m/s that the present gait would settle at in still water."""
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
