"""Thresholds of the search, from `data/calib/gap.toml`: every constant that decides an answer, with its unit and its source.

    thresholds().stepwise.attempts        frozen() is thresholds().gates

They are read once per process and never depend on the data. Tables and keys that a user's file leaves out are as shipped.
"""

from collections import namedtuple
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.calib import calib_folder, read_toml, resolve, shown_path
from fishmj.base.errors import ConfigError


@dataclass(frozen=True)
class Gates:
    """Gates of a verdict, and the required gain of a selection round (twice the log likelihood of held-out records).

    A first effect must gain `gain` (`calibrated_gain` for a calibrated model), or `min_joint_gain` on all records at once and on
    each fold given the others. A further effect must gain

        max(gain + min_gain_per_sample m, min_gain_fraction (gain so far))

    where m is the length of z. If no other candidate comes near, only the share `uncontested_discount` of the second term is
    required. A gain above `certain_gain` rules out chance.
    A rival is a candidate behind the best by less than `margin` of the gain and less than `rival_margin_abs`, or one that wins
    more than 1 - `p_best` of the bootstrap draws. adequacy, closure, residual, form, size, transfer: see decide/decide.py.
    """

    adequacy: float
    gain: float
    calibrated_gain: float
    min_joint_gain: float
    min_gain_per_sample: float
    uncontested_discount: float
    min_gain_fraction: float
    certain_gain: float
    closure: float
    margin: float
    rival_margin_abs: float
    p_best: float
    residual: float
    form: float
    size: float
    transfer: float
    max_effects: int
    shortlist: int
    finalists: int


# All thresholds, by table of the file. Except for the gates, the shipped file defines the names and types of a table.
Thresholds = namedtuple(
    "Thresholds",
    "gates fit likelihood model_error cross_validation stepwise decide secondary intervals library equivalence terms stronger"
    " torques same workflow",
)


@cache
def thresholds(name: str | Path = "gap") -> Thresholds:
    """The thresholds of a shipped file by name, or of the user's own TOML.

    Raises ConfigError: an unknown table or key, or a value of another type.
    """
    path = resolve(name)
    given = read_toml(path)
    shipped = read_toml(calib_folder() / "gap.toml")
    where = shown_path(path)
    if unknown := sorted(set(given) - set(shipped)):
        raise ConfigError(f"{where}: [{unknown[0][:64]}] is not a table of thresholds; expected {', '.join(shipped)}")
    tables = {key: _table(given.get(key, {}), shipped[key], f"{where}: [{key}]") for key in shipped}
    frozen_tables = {key: namedtuple(key, table)(**table) for key, table in tables.items() if key != "gates"}
    return Thresholds(Gates(**tables["gates"]), **frozen_tables)


def _table(given: Any, shipped: dict, where: str) -> dict:
    """One table: given values over the shipped ones."""
    if not isinstance(given, dict):
        raise ConfigError(f"{where}: got {given!r:.40}, expected a table of thresholds")
    if unknown := sorted(set(given) - set(shipped)):
        raise ConfigError(f"{where}: {unknown[0][:64]!r} is not a threshold; expected {', '.join(shipped)}")
    return {key: _value(given.get(key, entry), entry["value"], f"{where}: {key}") for key, entry in shipped.items()}


def _value(entry: Any, shipped: Any, where: str) -> Any:
    """A number or a list of numbers, plain or as { value, unit, source }, of the shipped type."""
    value: Any = entry.get("value") if isinstance(entry, dict) else entry
    number = lambda x: isinstance(x, int | float) and not isinstance(x, bool)
    if isinstance(shipped, list):
        if isinstance(value, list) and value and all(map(number, value)):
            return tuple(map(float, value))
        raise ConfigError(f"{where}: got {value!r:.40}, expected a list of numbers")
    if not number(value) or (isinstance(shipped, int) and value != int(value)):
        raise ConfigError(f"{where}: got {value!r:.40}, expected {'a whole number' if isinstance(shipped, int) else 'a number'}")
    return type(shipped)(value)


def frozen() -> Gates:
    """The gates as shipped; the file states the origin of each."""
    return thresholds().gates


def residual_allowed(checks: dict, gates: Gates) -> float:
    """Largest allowed |z|^2 / m of records predicted without their fold, by the gates of a verdict.

        residual <= R,   or, if form <= F,   residual - 1 <= F^2 (adequacy - 1)

    S includes the form error only in steps of a factor 1.4. In a gap of a thousand times the floor, even a fiftieth of the form
    error is visible. So a formula with a form error of at most F may leave a residual of F^2 of its gain.
    """
    if checks.get("form", np.inf) > gates.form:
        return gates.residual
    return max(gates.residual, 1.0 + gates.form**2 * (checks.get("adequacy", 1.0) - 1.0))
