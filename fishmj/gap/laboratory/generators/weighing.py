"""Weighings of a generator's robot: readings of scales, a knife edge and two threads, with their errors.

scales    every link by itself, m (1 + e), e of 0.1 %, read to 1 g;   knife edge  balance point from the nose, 1 mm
pendulum  the straight fish on two threads of length l, d apart:  T = 4 pi sqrt(I l / (m g d^2)), 0.2 %      bifilar suspension
"""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.base.units import G
from fishmj.gap.laboratory.generators import random_numbers
from fishmj.gap.laboratory.generators.swim import Run
from fishmj.gap.laboratory.generators.trials import robot_of
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of

THREAD, APART = 1.0, 0.25  # m
SCALE, READ, EDGE, CLOCK = 0.001, 0.001, 0.001, 0.002  # relative, kg, m, relative


class Weight(NamedTuple):
    """Readings of perfect instruments on the straight fish."""

    links: np.ndarray  # (N,) kg
    balance: float  # m from the nose
    inertia: float  # kg m2 in yaw, about the balance point


def weight(run: Run) -> Weight:
    """Weight from MuJoCo's model; parts that slide or hang in a link count as its own."""
    model, data = run.model, run.data
    mujoco.mj_resetData(model, data)
    mujoco.mj_kinematics(model, data)
    mass, x = model.body_mass, data.xipos[:, 0]
    turned = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", turned[:, 2] ** 2, model.body_inertia)
    names = [link.name for link in run.fish.robot.links]
    links = np.zeros(len(names))
    for body in range(1, model.nbody):
        holder = body if model.body(body).name in names else int(model.body_parentid[body])
        links[names.index(model.body(holder).name)] += mass[body]
    middle = float(mass @ x / mass.sum())
    inertia = float(np.sum(own + mass * (x - middle) ** 2))
    return Weight(links, float(geometry_of(run.fish.robot).span[0, 1]) - middle, inertia)


def page(family: str, effects: Mapping, seed: int, nuisance: float = 0.1, robot: "str | Robot" = "fish") -> dict:
    """The page `measurements.toml` of the robot of a seed, three readings of each. Raises as `trials.robot_of`."""
    fish = robot_of(family, effects, seed, nuisance=nuisance, robot=robot)
    found, rng = weight(Run(fish)), random_numbers.stream(seed, "weighing")
    total = float(found.links.sum())
    period = 4.0 * np.pi * np.sqrt(found.inertia * THREAD / (total * G)) / APART

    def read(value: float, error: float, step: float = 1e-5) -> list[float]:
        return [round(round((value + error * e) / step) * step, 5) for e in rng.standard_normal(3).tolist()]

    scales = {link.name: read(float(m), SCALE * m, READ) for link, m in zip(fish.robot.links, found.links, strict=True)}
    return {
        "schema": "fishmj.measurements/1",
        "origin": "synthetic",
        "source": f"fishmj.generators, {family}",
        "scales": {"unit": "kg", **scales},
        "balance": {"unit": "m from the nose, straight", "at": read(found.balance, EDGE), "error": EDGE},
        "pendulum": {
            "unit": "s, turning about the vertical through the balance point, straight",
            "thread": THREAD,
            "apart": APART,
            "period": read(float(period), CLOCK * float(period)),
        },
    }
