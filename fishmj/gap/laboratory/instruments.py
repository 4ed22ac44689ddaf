"""Instruments of the laboratory: packet order of the radio, joint encoders, noise of each channel; and those that weigh a robot.

scales      every link alone, m (1 + e),                    e ~ 0.1 %, resolution 1 g
knife edge  balance point of the straight fish, from the nose, +- 1 mm
pendulum    straight fish on two threads of length l, d apart:   T = 4 pi sqrt(I l / (m g)) / d,   timed to 0.2 %
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fishmj.base.units import G


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


REPEATS = 3
SCALE_STEP, SCALE_ERROR = 0.001, 0.001  # kg, relative
EDGE_ERROR, CLOCK_ERROR = 0.001, 0.002  # m, relative


def weighing_page(
    source: str, links: Mapping[str, float], balance: float, inertia: float, thread: float, apart: float, rng: np.random.Generator
) -> dict:
    """Content of `measurements.toml`: three readings of each quantity.

    Args:
        links: kg of each. balance: m from the nose. inertia: kg m2 in yaw, about the balance point. thread, apart: m.
    """

    def read(value: float, error: float, step: float = 1e-5) -> list[float]:
        return [round(round((value + error * e) / step) * step, 5) for e in rng.standard_normal(REPEATS).tolist()]

    period = float(4.0 * np.pi * np.sqrt(inertia * thread / (sum(links.values()) * G)) / apart)
    return {
        "schema": "fishmj.measurements/1",
        "origin": "synthetic",
        "source": source,
        "scales": {"unit": "kg", **{name: read(float(m), SCALE_ERROR * m, SCALE_STEP) for name, m in links.items()}},
        "balance": {"unit": "m from the nose, straight", "at": read(balance, EDGE_ERROR), "error": EDGE_ERROR},
        "pendulum": {
            "unit": "s, turning about the vertical through the balance point, straight",
            "thread": thread,
            "apart": apart,
            "period": read(period, CLOCK_ERROR * period),
        },
    }
