"""The weighing table: what scales, a knife edge and a bifilar pendulum say of a virtual robot, with their errors.

scales      every link alone, m (1 + e),                    e ~ 0.1 %, readable to 1 g
knife edge  balance point of the straight fish, from the nose, +- 1 mm
pendulum    two threads of length l, d apart, straight fish:   T = 2 pi / (d/2) sqrt(I l / (m g)),   timed over ten swings, 0.2 %
"""

import math

import numpy as np

from fishmj.units import G
from fishmj.virtual_robot.machine import Plant

REPEATS = 3
SCALE_STEP, SCALE_ERROR = 0.001, 0.001  # kg, relative
EDGE_ERROR = 0.001  # m
THREAD, APART, CLOCK_ERROR = 1.2, 0.30, 0.002  # m, m, relative


def weighings(made: Plant, truth: dict[str, float], rng: np.random.Generator) -> dict:
    """Table of the measurements, three of each."""

    def read(value: float, error: float) -> list[float]:
        return [round(float(value + error * e), 5) for e in rng.standard_normal(REPEATS)]

    def scaled(mass: float) -> list[float]:
        return [round(round(float(mass * (1 + SCALE_ERROR * e)) / SCALE_STEP) * SCALE_STEP, 4) for e in rng.standard_normal(3)]

    period = 2 * math.pi / (APART / 2) * math.sqrt(truth["inertia"] * THREAD / (truth["mass"] * G))
    links = [link.name for link in made.robot.links]
    return {
        "schema": "fishmj.measurements/1",
        "origin": "synthetic",
        "source": "fishmj.virtual_robot",
        "scales": {"unit": "kg", **{name: scaled(m) for name, m in zip(links, made.body.mass, strict=True)}},
        "balance": {"unit": "m from the nose, straight", "at": read(truth["com"], EDGE_ERROR), "error": EDGE_ERROR},
        "pendulum": {
            "unit": "s, turning about the vertical through the balance point, straight",
            "thread": THREAD,
            "apart": APART,
            "period": read(period, CLOCK_ERROR * period),
        },
    }
