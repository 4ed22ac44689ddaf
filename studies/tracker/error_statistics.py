"""Statistics of the errors of consecutive fixes: a white part and a correlated part.

The autocovariance of an error e_k, one frame apart from the next,

    c_m = mean(e_k e_{k+m}) = w^2 [m = 0] + s^2 exp(-m dt / tau)

w is the part that changes from frame to frame (pixel noise), s the correlated part (waves, the paint's shape), tau its time. A
line through log c_m over the lags that are well above zero gives s and tau, and w^2 = c_0 - s^2.
"""

from typing import Any

import numpy as np

LAGS = 6  # frames of the fit
LONG = 5.0  # s that a tau is at most told as


def autocovariance(error: np.ndarray) -> np.ndarray:
    """Autocovariance c_m (LAGS + 1,) of one channel (n,), NaN without a fix; about zero, so that a bias counts as correlated."""
    return np.array([float(np.nanmean(error[: len(error) - m] * error[m:])) for m in range(LAGS + 1)])


def parts(lags: np.ndarray, dt: float) -> dict[str, float]:
    """White part, correlated part and its time, of an autocovariance (LAGS + 1,)."""
    good = 1 + np.flatnonzero(np.cumprod(lags[1:] > 0.1 * lags[0]))
    if len(good) < 2:
        return {"white": float(np.sqrt(lags[0])), "lasting": 0.0, "tau": 0.0}
    slope, start = np.polyfit(good * dt, np.log(lags[good]), 1)
    lasting = min(float(np.exp(start)), float(lags[0]))
    tau = min(-1.0 / slope, LONG) if slope < 0 else LONG
    return {"white": float(np.sqrt(lags[0] - lasting)), "lasting": float(np.sqrt(lasting)), "tau": float(tau)}


def noise(error: np.ndarray, dt: float) -> dict[str, Any]:
    """Parts of position (m, the mean of x and y) and yaw (rad) of errors (n, 3), and the share of frames without a fix."""
    x, y, yaw = (parts(autocovariance(column), dt) for column in error.T)
    mean = lambda key: float(np.sqrt(0.5 * (x[key] ** 2 + y[key] ** 2)))
    position = {"white": mean("white"), "lasting": mean("lasting"), "tau": 0.5 * (x["tau"] + y["tau"])}
    return {"position": position, "yaw": yaw, "missed": float(np.mean(np.isnan(error[:, 0])))}
