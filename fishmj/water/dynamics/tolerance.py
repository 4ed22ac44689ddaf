"""Tolerances of a swim: shares of the recorded movement, and floors for small movements."""

import numpy as np

TOLERANCE = {"speed": (0.03, 0.004), "yaw": (0.05, np.radians(1.0)), "power": (0.10, 0.03)}  # m/s, rad/s, W
WINDOW = 0.5  # s, over which the movement of a short stretch is compared


def of_movement(surge, sway, yaw_rate, floors: float = 1.0, xp=np) -> tuple:
    """Tolerances of a recorded velocity ahead and to the left, m/s, and of a yaw rate, rad/s; `floors` multiplies the floors."""
    (share, floor), (turn, still) = TOLERANCE["speed"], TOLERANCE["yaw"]
    return share * xp.hypot(surge, sway) + floors * floor, turn * xp.abs(yaw_rate) + floors * still


def body_rates(q, v, xp=np):
    """Velocity ahead, to the left, and yaw rate, (..., 3), of poses and their rates (..., 3 or more)."""
    c, s = xp.cos(q[..., 2]), xp.sin(q[..., 2])
    return xp.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], -1)
