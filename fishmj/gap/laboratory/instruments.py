"""Instruments of the laboratory: packet order of the radio, joint encoders, noise of each channel."""

from typing import Any

import numpy as np


def order_of_arrival(times: np.ndarray) -> np.ndarray:
    """Indices (K,) of the received packets in order of arrival. times (T,): s, nan for a lost packet."""
    return np.argsort(times, kind="stable")[: np.count_nonzero(~np.isnan(times))]


def read_encoders(network: Any, angles: np.ndarray, rng: np.random.Generator, noise: float) -> dict[str, np.ndarray]:
    """Columns j1, j2, .. of angles (K, J) [rad] with noise, rounded to encoder counts."""
    angles = angles + noise * network.angle_noise * rng.standard_normal(angles.shape)
    angles = np.round(angles / network.angle_step) * network.angle_step
    return {f"j{j + 1}": column for j, column in enumerate(angles.T)}


def noise_sigmas(network: Any, camera: Any, meter: Any, joints: int, noise: float) -> dict[str, float]:
    """Standard deviation of each channel's noise, quantisation included, in the channel's unit."""
    angle = float(np.hypot(noise * network.angle_noise, network.angle_step / np.sqrt(12)))
    return {
        "x": noise * camera.position_noise,
        "y": noise * camera.position_noise,
        "yaw": noise * camera.heading_noise,
        **{f"j{j + 1}": angle for j in range(joints)},
        "V": noise * meter.voltage_noise,
        "I": noise * meter.current_noise,
    }
