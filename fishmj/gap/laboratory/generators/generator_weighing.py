"""Weighing table of a generator's robot, and the masses of its MuJoCo model."""

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.gap.laboratory.generators.generator_trials import robot_of
from fishmj.gap.laboratory.generators.mujoco_robot import RobotSimulation
from fishmj.gap.laboratory.random_streams import generators_stream
from fishmj.gap.laboratory.weighing_readings import weighing_page
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of

THREAD, APART = 1.0, 0.25  # m


class Weight(NamedTuple):
    """True values of the straight fish."""

    links: np.ndarray  # (N,) kg
    balance: float  # m from the nose
    inertia: float  # kg m2 in yaw, about the balance point


def weight(run: RobotSimulation) -> Weight:
    """Weight from MuJoCo's model; added sliding or hinged bodies count to the link that holds them."""
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
    """Content of `measurements.toml` of a seed's robot, three readings per quantity. Raises as `generator_trials.robot_of`."""
    fish = robot_of(family, effects, seed, nuisance=nuisance, robot=robot)
    found, names = weight(RobotSimulation(fish)), [link.name for link in fish.robot.links]
    links, rng = dict(zip(names, found.links, strict=True)), generators_stream(seed, "weighing")
    return weighing_page(f"fishmj.generators, {family}", links, found.balance, found.inertia, THREAD, APART, rng)
