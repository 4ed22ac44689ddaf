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
    """Repeats of one measurement. Raises ConfigError: missing, or not positive."""
    value = page.get(table, {}).get(key)
    found = np.atleast_1d(np.array([np.nan] if value is None else value, float))
    if not np.all(np.isfinite(found)) or np.any(found <= 0):
        got = "is missing" if value is None else f"= {value!r}"
        raise ConfigError(f"{path}: [{table}] {key} {got}; expected one or more positive numbers in SI units")
    return found


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
    return float(at.mean()), deviation(at, float(page["balance"].get("error", error)))


def inertia(page: dict, mass: float, path: "str | Path" = FILE) -> tuple[float, float]:
    """(kg m2 about the vertical through the balance point, relative standard deviation by the scatter of its periods)."""
    period = numbers(page, "pendulum", "period", path)
    thread, apart = (float(numbers(page, "pendulum", key, path)[0]) for key in ("thread", "apart"))
    value = mass * G * (float(period.mean()) * apart / 2 / (2 * pi)) ** 2 / thread
    return value, 2 * deviation(period) / float(period.mean())
