"""Masses, balance point and yaw inertia from a page of weighings (`measurements.toml`).

    link        mean of its weighings
    balance     the head's centre of mass moves until the straight fish balances at the measured point
    pendulum    I = m g (T d/2 / 2 pi)^2 / l,   two threads of length l, d apart, turning about the vertical
    yaw_inertia I less that of the described fish, as an effect of the head

A bifilar pendulum about the other two axes would give the rest of the tensor; the fish moves in the plane, so only yaw is needed.
"""

from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError
from fishmj.gap.calibrate.parameter_fit import NORMAL, ParameterEstimate
from fishmj.gap.records.mass_properties import check_page
from fishmj.log import measurements
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of


class MassEstimates(NamedTuple):
    """Estimates: mass, com (from the nose), inertia, yaw_inertia; mass and com of every link, (m, back from its front)."""

    estimates: dict[str, ParameterEstimate]
    links: dict[str, tuple[float, float]]


def calibrate(folder: "str | Path", robot: Robot) -> MassEstimates:
    """Reads the page and computes the masses.

    Raises ConfigError: the page is missing, lacks a table or a link, a number is not positive, or is in another unit.
    """
    path = Path(folder) / measurements.FILE
    if not path.is_file():
        raise ConfigError(
            f"{path}: no such file; write there what was weighed:"
            " [scales] with every link, [balance], [pendulum] (docs/search/logs.md)"
        )
    page = read_toml(path)
    masses, mass_sd = measurements.masses(page, [link.name for link in robot.links], path)
    check_page(page, robot, path)
    total, (com, com_sd) = float(masses.sum()), measurements.balance(page, 0.0, path)
    inertia, scatter = measurements.inertia(page, total, path)
    inertia_sd = inertia * sqrt(scatter**2 + (mass_sd / total) ** 2)
    described = described_as(robot, masses, com)
    extra = inertia - _yaw_inertia(described)
    repeats = lambda table, key: len(measurements.numbers(page, table, key, path))
    found = {
        "mass": _estimate("mass", "kg", total, mass_sd, repeats("scales", robot.links[0].name)),
        "com": _estimate("com", "m", com, com_sd, repeats("balance", "at")),
        "inertia": _estimate("inertia", "kg m2", inertia, inertia_sd, repeats("pendulum", "period")),
        "yaw_inertia": _estimate("yaw_inertia", "kg m2", extra, inertia_sd, repeats("pendulum", "period")),
    }
    return MassEstimates(found, {link.name: (link.mass, link.com[0]) for link in described.links if link.com})


def described_as(robot: Robot, masses: np.ndarray, com: float) -> Robot:
    """The robot with these link masses, balanced at `com` from the nose (straight) by moving the head's centre of mass."""
    fronts = np.concatenate([[0.0], np.cumsum([link.length for link in robot.links])])[:-1]
    place = [link.com or (0.5 * link.length, 0.0, 0.0) for link in robot.links]
    behind = sum(float(m) * (f + c[0]) for m, f, c in list(zip(masses, fronts, place, strict=True))[1:])
    head = (float(masses.sum()) * com - behind) / float(masses[0])
    places = [(head, *place[0][1:]), *place[1:]]
    links = [replace(k, mass=float(m), com=c) for k, m, c in zip(robot.links, masses, places, strict=True)]
    return replace(robot, links=tuple(links))


def _yaw_inertia(robot: Robot) -> float:
    """Inertia about the balance point of the straight fish, kg m2, with every link's described shape."""
    g = geometry_of(robot)
    x = g.origin + g.com[:, 0]
    middle = float(g.mass @ x / g.mass.sum())
    return float(np.sum(g.inertia[:, 2] + g.mass * (x - middle) ** 2))


def _estimate(name: str, unit: str, value: float, sd: float, repeats: int) -> ParameterEstimate:
    half = (float(student.ppf(0.95, repeats - 1)) if repeats > 1 else NORMAL) * sd
    return ParameterEstimate(name, unit, value, value - half, value + half, sd, "repeats")
