"""Tolerances for comparing swims: relative to the recorded motion, with floors for small motion."""

import numpy as np

TOLERANCE = {"speed": (0.03, 0.004), "yaw": (0.05, np.radians(1.0)), "power": (0.10, 0.03)}  # m/s, rad/s, W
WINDOW = 0.5  # s, averaging window of a comparison


def of_movement(surge, sway, yaw_rate, floors: float = 1.0, xp=np) -> tuple:
    """Tolerances of recorded forward and lateral velocity, m/s, and yaw rate, rad/s; floors: factor on the floors."""
    (share, floor), (turn, still) = TOLERANCE["speed"], TOLERANCE["yaw"]
    return share * xp.hypot(surge, sway) + floors * floor, turn * xp.abs(yaw_rate) + floors * still


def body_rates(q, v, xp=np):
    """Forward velocity, velocity to the left, and yaw rate (..., 3), from poses and their rates (..., 3 or more)."""
    c, s = xp.cos(q[..., 2]), xp.sin(q[..., 2])
    return xp.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], -1)
