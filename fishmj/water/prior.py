"""Strip coefficients as one named vector, and their prior distributions: data/calib/hydro_fit.toml."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import ConfigError
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import strip_forces

FILE = "hydro_fit.toml"
FIXED = ("stall_width", "residual")  # never fitted: the first keeps gradients finite, the second scales the fitted residual

STEEPEST = 40.0  # upper bound of lift_a and lift_b in the file


@cache
def table() -> dict:
    """Prior of every coefficient: {sd, low, high, unit, source}."""
    return read_toml(calib_folder() / FILE)["prior"]


@dataclass(frozen=True, eq=False)
class Prior:
    """Mean, standard deviation and bounds of P named coefficients, (P,) each."""

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def only(self, names) -> "Prior":
        """Prior of some of the coefficients, in the given order."""
        at = [self.names.index(name) for name in names]
        return Prior(tuple(names), *(value[at] for value in (self.mean, self.sd, self.low, self.high)))


def names_of(links: int) -> tuple[str, ...]:
    """Names k1.. cn1.. cf ca_forward .. in the order of `flat`."""
    each = tuple(f"{key}{i + 1}" for key in ("k", "cn") for i in range(links))
    return each + tuple(key for key in strip_forces.Coefficients._fields[2:])


def flat(c: strip_forces.Coefficients) -> np.ndarray:
    """Coefficients as a vector (2 N + 11,) in the order of `names_of`."""
    return np.array([*c.k, *c.cn, *c[2:]], float)


def unflat(values) -> strip_forces.Coefficients:
    """Inverse of `flat`; components may be arrays."""
    links = (len(values) - len(strip_forces.Coefficients._fields) + 2) // 2
    return strip_forces.Coefficients(list(values[:links]), list(values[links : 2 * links]), *values[2 * links :])


def prior_of(robot: Robot) -> Prior:
    """Prior of this robot's coefficients: its water table gives the mean, the calibration file the rest.

    Raises ConfigError: a coefficient of the robot is outside the bounds, or the robot has one that a fit does not support.
    """
    links = len(robot.links)
    if any(robot.water.get(key, unset) != unset for key, unset in strip_forces.SHAPE.items()):
        text = f"{robot.name} [water] {', '.join(strip_forces.SHAPE)}: hydro_fit does not support these keys"
        raise ConfigError(f"{text}; leave them out of the description")
    c = strip_forces.coefficients(robot.water, links)
    names, mean = names_of(links), flat(c)
    kinds = [name.rstrip("0123456789") for name in names]
    rows = [table().get(kind, {"sd": 1e-6, "low": -np.inf, "high": np.inf}) for kind in kinds]
    low, high = (np.array([float(row[key]) for row in rows]) for key in ("low", "high"))
    for name, value, least, most in zip(names, mean, low, high, strict=True):
        if not least <= value <= most:
            raise ConfigError(f"{robot.name} [water] {name} = {value:g}; {FILE} allows {least:g} to {most:g}")
    sd = np.array([row["sd"] for row in rows]) * np.maximum(np.abs(mean), 1e-3)
    return Prior(names, mean, sd, low, high)
