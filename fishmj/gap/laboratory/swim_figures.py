"""Figures of a swim: speed, turning rate and power of a steady gait; the time in which a gliding fish slows down."""

import numpy as np

from fishmj.log.excitation import LEAD

SETTLE = 8.0  # s, of a gait until it is steady


def gait_figures(t: np.ndarray, pose: np.ndarray, watts: np.ndarray, frequency: float) -> dict[str, float]:
    """Speed from beat to beat m/s, turning rate rad/s, mean power W of a gait, Hz. t (T,); pose (T, 3) m, m, rad; watts (T,)."""
    begin = LEAD + SETTLE
    beats = begin + np.arange(int((t[-1] - begin) * frequency) + 1) / frequency
    x, y, yaw = (np.interp(beats, t, column) for column in pose.T)
    span, whole = float(beats[-1] - beats[0]), (t >= beats[0]) & (t < beats[-1])
    speed, turn = float(np.hypot(np.diff(x), np.diff(y)).sum()) / span, float(yaw[-1] - yaw[0]) / span
    return {"speed": speed, "turn": turn, "power": float(watts[whole].mean())}


def gait_row(frequency: float, lag: float, bias: float, found: dict[str, float]) -> dict[str, float]:
    """Row of a table: a gait (Hz, deg, deg) and its figures."""
    speed, turn, power = round(found["speed"], 3), round(float(np.degrees(found["turn"])), 1), round(found["power"], 2)
    gait = {"Hz": frequency, "lag deg": lag, "bias deg": bias}
    return gait | {"speed m/s": speed, "turn deg/s": turn, "servo power W": power}


def time_to_slow(t: np.ndarray, along: np.ndarray, speed: float) -> float:
    """Seconds until the velocity `along` (T,) is below `speed`, m/s; nan if it stays above."""
    slow = np.flatnonzero(along < speed)
    return float(t[slow[0]]) if len(slow) else float("nan")
