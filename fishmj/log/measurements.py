"""Measurements of a robot by scales, a knife edge and a bifilar pendulum: `measurements.toml` beside its trials.

[scales]    head = [0.765, ..]      kg, every link alone; or whole = [..]
[balance]   at = [0.184, ..]        m from the nose, straight; error, of one reading
[pendulum]  period = [1.70, ..]     s; thread l and apart d, m: straight, turning about the vertical on two threads

I = m g (T d/2 / 2 pi)^2 / l
"""

from collections.abc import Iterable, Mapping
from math import pi, sqrt
from pathlib import Path

import numpy as np

from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text
from fishmj.base.units import G
from fishmj.log.toml import dumps

FILE = "measurements.toml"
RESOLUTION = 0.001 / sqrt(12)  # kg: scales read whole grams
HEAVY = 10.0  # times the described mass, or a tenth of it; beyond it is another unit
SLIM = 50.0  # lengths of a fish per least radius of gyration; that of a slender rod is a 3.5th of its length


def read(folder: "str | Path") -> dict:
    """The page of a folder; {} without one."""
    path = Path(folder) / FILE
    return read_toml(path) if path.is_file() else {}


def write(folder: "str | Path", page: Mapping) -> Path:
    """Writes the page of a folder, atomically."""
    path = Path(folder) / FILE
    write_text(path, dumps(dict(page)))
    return path


def numbers(page: dict, table: str, key: str, path: "str | Path" = FILE) -> np.ndarray:
    """Repeats of one measurement. Raises ConfigError: missing, no number, or not positive."""
    value = whole.get(key) if isinstance(whole := page.get(table, {}), dict) else None
    listed = value if isinstance(value, list | tuple | np.ndarray) else [value]
    number = lambda v: isinstance(v, int | float | np.number) and not isinstance(v, bool)
    found = np.array([v if number(v) else np.nan for v in listed], float)
    if not len(found) or not np.all(np.isfinite(found)) or np.any(found <= 0):
        got = "is missing" if value is None else f"= {value!r}"[:80]
        raise ConfigError(f"{path}: [{table}] {key} {got}; expected one or more positive numbers in SI units")
    return found


def check_units(page: dict, links: Iterable[str], mass: float, length: float, path: "str | Path" = FILE) -> None:
    """Raises ConfigError: a weighing in another unit, or an invalid one, of a fish described with `mass` kg and `length` m."""
    if "scales" in page:
        total = float(masses(page, weighed_parts(page, links), path)[0].sum())
        if not mass / HEAVY <= total <= HEAVY * mass:
            got, told = f"[scales] add up to {total:.4g} kg", f"expected about the {mass:.3g} kg of the description"
            raise ConfigError(f"{path}: {got}; {told}; are these {'g' if total > mass else 't'}? Write kg")
    if "balance" in page and (at := balance(page, 0.0, path)[0]) > length:
        expected = f"expected a place on the straight fish of {length:.3g} m"
        raise ConfigError(f"{path}: [balance] at is {at:.4g} m from the nose; {expected}; are these mm? Write m")
    if "pendulum" in page and not length / SLIM <= (radius := sqrt(inertia(page, 1.0, path)[0])) <= length / 2:
        got = f"[pendulum] gives a radius of gyration of {radius:.3g} m"
        expected = f"expected {length / SLIM:.3g} to {length / 2:.3g} m of a fish of {length:.3g} m"
        raise ConfigError(f"{path}: {got}; {expected}. Write period in s, thread and apart in m")


def weighed_parts(page: dict, links: Iterable[str]) -> list[str]:
    """Keys of [scales] that count: `whole`, where it is stated, or every one of `links`."""
    return ["whole"] if isinstance(page["scales"], dict) and "whole" in page["scales"] else list(links)


def deviation(values: np.ndarray, least: float = 0.0) -> float:
    """Standard deviation of the mean; least: smallest standard deviation of one reading."""
    scatter = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return max(scatter, least) / sqrt(len(values))


def masses(page: dict, links: Iterable[str], path: "str | Path" = FILE) -> tuple[np.ndarray, float]:
    """(kg of each of `links` of [scales], standard deviation of their sum)."""
    read = [numbers(page, "scales", name, path) for name in links]
    return np.array([r.mean() for r in read]), sqrt(sum(deviation(r, RESOLUTION) ** 2 for r in read))


def balance(page: dict, error: float, path: "str | Path" = FILE) -> tuple[float, float]:
    """(m from the nose, standard deviation); error: of one reading, unless the page states one."""
    at = numbers(page, "balance", "at", path)
    stated = "error" in page["balance"]
    return float(at.mean()), deviation(at, float(numbers(page, "balance", "error", path)[0]) if stated else error)


def inertia(page: dict, mass: float, path: "str | Path" = FILE) -> tuple[float, float]:
    """(kg m2 about the vertical through the balance point, relative standard deviation by the scatter of its periods)."""
    period = numbers(page, "pendulum", "period", path)
    thread, apart = (float(numbers(page, "pendulum", key, path)[0]) for key in ("thread", "apart"))
    value = mass * G * (float(period.mean()) * apart / 2 / (2 * pi)) ** 2 / thread
    return value, 2 * deviation(period) / float(period.mean())
