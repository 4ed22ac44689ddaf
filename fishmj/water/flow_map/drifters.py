"""Mean speed and turbulence intensity from drifts of a floating marker under the overhead camera.

    v_k    slope of the line through the fixes of window k, 1 s long                    (x and y)
    U      mean of the tracks' mean velocities, with Student's t interval over tracks
    u_rms^2 = mean of |v_k - mean|^2 / 2 - variance of the slope due to scatter of the fixes,   TI = u_rms / max(U, 0.1 m/s)

A marker moves with its eddy, so windows of one track are correlated, and there is no length scale. Tracks are independent.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.water.flow_map.turbulence_statistics import FLOOR, STUDENT, Turbulence, ValueInterval, jackknifed

WINDOW = 1.0  # s
FEWEST = 5  # minimal number of tracks
LEAST = 8  # minimal number of fixes in a window
NO_LENGTH = "a drifter moves with its eddy: a length scale needs a fixed probe"


def turbulence_of_drifts(tracks: Sequence[np.ndarray]) -> Turbulence:
    """Turbulence from drifts of one marker, or of several.

    Args:
        tracks: each (T, 3): t s, x m, y m in the tank frame.

    Raises ConfigError: fewer than five tracks last a window or more.
    """
    found = [slopes for track in tracks if len(slopes := _slopes(track))]
    if len(found) < FEWEST:
        raise ConfigError(
            f"flow-map: got {len(found)} drifts of {WINDOW:g} s or more with {LEAST} fixes per second; expected {FEWEST} or more,"
            " started at different times"
        )
    means = np.array([slopes[:, :2].mean(0) for slopes in found])
    middle = means.mean(0)
    speed, direction = float(np.hypot(*middle)), float(np.arctan2(middle[1], middle[0]))
    along = means @ (middle / max(speed, 1e-12))
    n = len(found)
    error = STUDENT[min(n, len(STUDENT) + 4) - 5] * float(along.std(ddof=1)) / sqrt(n)
    everybody = range(n)
    without = [_intensity([found[i] for i in everybody if i != k]) for k in everybody]
    intensity = jackknifed(_intensity(found), without, positive=True)
    noise = float(np.sqrt(np.mean(np.concatenate(found)[:, 2])))
    seconds = float(sum(track[-1, 0] - track[0, 0] for track in tracks))
    return Turbulence(
        ValueInterval(speed, speed - error, speed + error), direction, intensity, None, NO_LENGTH, noise, seconds, n
    )


def _slopes(track: np.ndarray) -> np.ndarray:
    """Velocity x, y m/s of each window, and the variance of each component due to scatter of the fixes, (K, 3)."""
    t, rows = track[:, 0] - track[0, 0], []
    for k in range(int(t[-1] / WINDOW + 1e-9) if len(t) else 0):
        part = track[(t >= k * WINDOW) & (t < (k + 1) * WINDOW)]
        if len(part) < LEAST:
            continue
        s = part[:, 0] - part[:, 0].mean()
        spread = float(s @ s)
        slope = s @ part[:, 1:] / spread
        left = part[:, 1:] - part[:, 1:].mean(0) - s[:, None] * slope
        rows.append((*slope, float(np.mean(left**2)) * len(part) / (len(part) - 2) / spread))
    return np.array(rows).reshape(-1, 3)


def _intensity(found: Sequence[np.ndarray]) -> float:
    """TI of the tracks; their common mean costs one degree of freedom."""
    means = np.array([slopes[:, :2].mean(0) for slopes in found])
    middle = means.mean(0)
    every = np.concatenate(found)
    between = float(np.mean(np.sum((means - middle) ** 2, 1))) / (len(found) - 1)  # variance of the mean
    variance = float(np.mean(np.sum((every[:, :2] - middle) ** 2, 1) / 2 - every[:, 2])) + between / 2
    return sqrt(max(variance, 0.0)) / max(float(np.hypot(*middle)), FLOOR)
