"""Interface of a water model: coefficients with tolerances and sources, and a compiled force law; the models by name."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import UnknownName
from fishmj.mjcf.description import Robot

NAMES = ("morison", "foil", "ellipsoid")  # each is imported and compiled at its first use


class Coefficient(NamedTuple):
    """Coefficient of a water model. tolerance: relative half width of its draw for healthy robots of the family."""

    value: float
    tolerance: float
    unit: str
    source: str


class RobotWater(NamedTuple):
    """Water of one robot. added: (N, 3, 3) at the links' origins; law: data of compiled code; memory: number of its states."""

    added: np.ndarray
    law: Any
    memory: int


class Family(NamedTuple):
    """A generator: build(robot, values) -> RobotWater, and a compiled step.

    step(chain, law, q, rate, flow, extra, tether, memory, h, generalised, sparse, work) writes the water's generalised force and
    adds its mass to MuJoCo's.
    """

    name: str
    about: str
    coefficients: Mapping[str, Coefficient]
    build: Callable[[Robot, Mapping[str, float]], RobotWater]
    step: Callable


def drawn(family: Family, nuisance: float, rng: np.random.Generator) -> dict[str, float]:
    """Draws the coefficients of one healthy robot. nuisance: 0.1 draws within the tolerances, 0 takes the nominal values."""
    size = nuisance / 0.1
    return {name: c.value * (1.0 + size * c.tolerance * rng.uniform(-1.0, 1.0)) for name, c in family.coefficients.items()}


def family_named(name: str) -> Family:
    """Returns a family. Raises UnknownName, which lists the families; MissingExtra: no numba."""
    if name not in NAMES:
        raise UnknownName("generator", name, NAMES)
    return import_module(f"fishmj.gap.laboratory.generators.{name}").FAMILY
