"""Speed and turning rate of a fish, from a camera's poses."""

import numpy as np

LEAD, PACE = 2.0, 1.0  # s skipped at the start, and between two positions that give a speed


def mean_speed_and_yaw_rate(t: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
    """(mean speed from positions one second apart, m/s; mean yaw rate, rad/s) after the first two seconds.

    Args:
        t: (K,) s. pose: (K, 3) m, m, rad unwrapped.
    """
    begin = min(LEAD, 0.5 * t[-1])
    marks = np.arange(begin, t[-1] + 1e-9, min(PACE, 0.5 * (t[-1] - begin)))
    x, y, yaw = (np.interp(marks, t, column) for column in pose.T)
    return float(np.hypot(np.diff(x), np.diff(y)).sum() / np.ptp(marks)), float((yaw[-1] - yaw[0]) / np.ptp(marks))
