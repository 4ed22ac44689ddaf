"""Velocity from camera poses, the same code in simulation and beside the tank.

A straight line is fitted to the last W poses at t_k = k dt (least squares; a first-order Savitzky-Golay filter):
    v = sum_k (t_k - mean t) p_k / sum_k (t_k - mean t)^2
Its estimate is late by (W - 1) dt / 2; the newest pose itself is not smoothed.
"""

import numpy as np


def slope_weights(window: int, dt: float) -> np.ndarray:
    """(W,) weights, 1/s, oldest first, that turn W equally spaced samples into the slope of their line fit."""
    t = (np.arange(window) - (window - 1) / 2) * dt
    return t / np.sum(t * t)


def estimate(xp, poses, dt: float):
    """Pose and velocity from poses (..., W, 3) [m, m, rad; yaw unwrapped], oldest first, dt [s] apart.

    Returns:
        pose (..., 3) and velocity (..., 3), world frame, m, rad, m/s, rad/s.
    """
    weights = xp.asarray(slope_weights(poses.shape[-2], dt), dtype=poses.dtype)
    return poses[..., -1, :], xp.sum(poses * weights[:, None], -2)


def delayed(xp, history, frames, window: int):
    """The `window` newest poses of history (B, H, 3), newest last, that have arrived `frames` (B,) int ticks late."""
    rows = xp.arange(history.shape[0])[:, None]
    columns = history.shape[1] - window - frames[:, None] + xp.arange(window)[None, :]
    return history[rows, columns]
