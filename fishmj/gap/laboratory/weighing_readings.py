"""Weighing table of a robot: readings of scales, knife edge and bifilar pendulum, with their errors.

scales      every link alone, m (1 + e),                    e ~ 0.1 %, resolution 1 g
knife edge  balance point of the straight fish, from the nose, +- 1 mm
pendulum    straight fish on two threads of length l, d apart:   T = 4 pi sqrt(I l / (m g)) / d,   timed to 0.2 %
"""

from collections.abc import Mapping

import numpy as np

from fishmj.base.units import G

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
