"""Weighings of a virtual robot: readings of scales, a knife edge and a bifilar pendulum, with their errors.

scales      every link alone, m (1 + e),                    e ~ 0.1 %, readable to 1 g
knife edge  balance point of the straight fish, from the nose, +- 1 mm
pendulum    two threads of length l, d apart, straight fish:   T = 2 pi / (d/2) sqrt(I l / (m g)),   timed over ten swings, 0.2 %
"""

import math
from collections.abc import Mapping

import numpy as np

from fishmj.base.units import G
from fishmj.gap.laboratory.virtual_robot import random_streams
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.mjcf.description import Robot

REPEATS = 3
SCALE_STEP, SCALE_ERROR = 0.001, 0.001  # kg, relative
EDGE_ERROR = 0.001  # m
THREAD, APART, CLOCK_ERROR = 1.2, 0.30, 0.002  # m, m, relative


def masses(made: RobotConstants) -> dict[str, float]:
    """Readings of perfect instruments: mass [kg], com, the balance point from the nose [m], yaw inertia about it [kg m2]."""
    body, origin = made.body, np.concatenate([[0.0], np.cumsum(made.body.hinge[:-1])])
    first = float(np.sum(body.first + body.mass * origin))
    second = float(np.sum(body.second + 2 * origin * body.first + body.mass * origin**2))
    middle = first / body.total
    nose = float(body.hinge[0] + made.robot.links[0].length)
    return {"mass": body.total, "com": nose - middle, "inertia": second - body.total * middle**2}


def page(effects: Mapping, seed: int, nuisance: float = 0.1, robot: "str | Robot" = "fish") -> dict:
    """Page of weighings of the robot of a seed with hidden effects."""
    return weighings(plant(effects, seed, nuisance=nuisance, robot=robot), random_streams.stream(seed, "weighing"))


def weighings(made: RobotConstants, rng: np.random.Generator) -> dict:
    """Tables of the measurements, three of each."""
    truth = masses(made)

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
