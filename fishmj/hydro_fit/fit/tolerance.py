"""How far a swim may be off: shares of the record, and floors where it is small."""

import numpy as np

TOLERANCE = {"speed": (0.03, 0.004), "yaw": (0.05, np.radians(1.0)), "power": (0.10, 0.03)}  # m/s, rad/s, W
WINDOW = 0.5  # s, over which the movement of a short stretch is compared


def of_movement(surge: np.ndarray, sway: np.ndarray, yaw_rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a velocity ahead and to the left, m/s, and of a yaw rate, rad/s, as recorded."""
    (share, floor), (turn, still) = TOLERANCE["speed"], TOLERANCE["yaw"]
    return share * np.hypot(surge, sway) + floor, turn * np.abs(yaw_rate) + still
