"""Weighing table of a virtual robot, and its true masses."""

from collections.abc import Mapping

import numpy as np

from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants
from fishmj.gap.laboratory.virtual_robot.trials import plant
from fishmj.gap.laboratory.weighing_readings import weighing_page
from fishmj.mjcf.description import Robot

THREAD, APART = 1.2, 0.30  # m


def masses(made: RobotConstants) -> dict[str, float]:
    """True values: mass [kg], com (balance point from the nose) [m], inertia (yaw, about the balance point) [kg m2]."""
    body, origin = made.body, np.concatenate([[0.0], np.cumsum(made.body.hinge[:-1])])
    first = float(np.sum(body.first + body.mass * origin))
    second = float(np.sum(body.second + 2 * origin * body.first + body.mass * origin**2))
    middle = first / body.total
    nose = float(body.hinge[0] + made.robot.links[0].length)
    return {"mass": body.total, "com": nose - middle, "inertia": second - body.total * middle**2}


def page(effects: Mapping, seed: int, nuisance: float = 0.1, robot: "str | Robot" = "fish") -> dict:
    """Weighing table of a seed's robot with hidden effects."""
    return weighings(plant(effects, seed, nuisance=nuisance, robot=robot), random_streams.stream(seed, "weighing"))


def weighings(made: RobotConstants, rng: np.random.Generator) -> dict:
    """Weighing table of a robot: three readings of each quantity."""
    truth, names = masses(made), [link.name for link in made.robot.links]
    links = dict(zip(names, made.body.mass, strict=True))
    return weighing_page("fishmj.virtual_robot", links, truth["com"], truth["inertia"], THREAD, APART, rng)
