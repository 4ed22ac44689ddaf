"""Thresholds of the search, from `data/calib/gap.toml`: every constant that decides an answer, with its unit and its source.

    thresholds().stepwise.attempts        frozen() is thresholds().gates

They are read once a process and never change with the data. A table or key that a file of one's own leaves out is as shipped.
"""

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj import console
from fishmj.calib import calib_folder, read_toml, resolve, shown_path
from fishmj.errors import ConfigError

RENAMED = {
    "rest": "residual",
    "joint": "min_joint_gain",
    "again": "min_gain_per_sample",
    "clear": "uncontested_discount",
    "beside": "min_gain_fraction",
    "enough": "min_gain_cap",
    "ahead": "rival_margin_abs",
    "most": "max_effects",
}  # old key of [gates] -> its name now


@dataclass(frozen=True)
class Gates:
    """Of a verdict, and of what a round of the selection must gain (twice the log likelihood of records not seen).

    A first effect must gain `gain`, or `min_joint_gain` on all records at once and on each fold given the others. A further one

        max(gain + min_gain_per_sample m, min(min_gain_fraction (gain so far), min_gain_cap))

    where m is the length of z, and only the share `uncontested_discount` of the second summand where nothing else comes near.
    A rival is a candidate behind the best by less than `margin` of the gain and `rival_margin_abs`, or one that wins more than
    1 - `p_best` of the bootstrap draws. adequacy, closure, residual, form, size, transfer: see decide/decide.py.
    """

    adequacy: float
    gain: float
    min_joint_gain: float
    min_gain_per_sample: float
    uncontested_discount: float
    min_gain_fraction: float
    min_gain_cap: float
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


@dataclass(frozen=True)
class FitThresholds:
    """Of the fitter: probes, grid search, prior, Gauss-Newton."""

    probe_sizes: tuple[float, ...]
    grid_values: int
    grid_neighbours: int
    grid_kept: int
    difference_step: float
    prior_sd: float
    iterations: int


@dataclass(frozen=True)
class LikelihoodThresholds:
    """Of the likelihood and its linearisation."""

    model_error: float
    nonlinearity_draws: int
    bootstrap_draws: int
    relinearisations: int


@dataclass(frozen=True)
class ModelErrorThresholds:
    """Of the grid on which a model error is estimated, and of when it is too large."""

    form_grid: tuple[float, ...]
    gain_grid: tuple[float, ...]
    excess: float
    excess_fraction: float


@dataclass(frozen=True)
class CrossValidationThresholds:
    """Of the folds."""

    folds: int


@dataclass(frozen=True)
class StepwiseThresholds:
    """Of a round of the selection."""

    informative_records: int
    screen_fraction: float
    finalist_fraction: float
    attempts: int
    uncontested_lead: float


@dataclass(frozen=True)
class DecideThresholds:
    """Of single records and parameters."""

    transfer_sd: float
    transfer_fraction: float
    bound_tolerance: float


@dataclass(frozen=True)
class SecondaryThresholds:
    """Of an effect that is found beside others."""

    size_scatter: float
    implausible_size: float
    weak_size: float
    doubtful_gain: float
    confusable_gain: float
    implausible_gain: float


@dataclass(frozen=True)
class IntervalsThresholds:
    """Of the intervals of values."""

    formula_error: float
    jackknife_records: int
    jackknife_cap: float
    quantile: float


@dataclass(frozen=True)
class LibraryThresholds:
    """Usual sizes of the typed terms."""

    pull: float
    torque: float
    reading: float
    bound: float
    trailing_edge: float


@dataclass(frozen=True)
class EquivalenceThresholds:
    """Of when a term is the formula of an effect."""

    states: int
    cosine: float
    length: float
    step: float


@dataclass(frozen=True)
class TermsThresholds:
    """Of the doubts about a term."""

    probe: float
    finite_probes: tuple[float, ...]
    diverged: float
    free_gain: float
    finalists: int
    listed: int
    decoys: int
    half_samples: int
    whole_records: int
    pieces: int
    false_discovery: float
    stability: float
    closure: float
    one_sided_weight: float
    cosine: float


@dataclass(frozen=True)
class StrongerThresholds:
    """Of a free force that leads what was found."""

    lead: float
    form_ratio: float
    screened: int
    fitted: int
    tried: int


@dataclass(frozen=True)
class WorkflowThresholds:
    """Of what is asked before and after a search."""

    replicate_gap: float
    chance_growth: float
    set_aside_from: int


class Thresholds(NamedTuple):
    """All of them, by table of the file."""

    gates: Gates
    fit: FitThresholds
    likelihood: LikelihoodThresholds
    model_error: ModelErrorThresholds
    cross_validation: CrossValidationThresholds
    stepwise: StepwiseThresholds
    decide: DecideThresholds
    secondary: SecondaryThresholds
    intervals: IntervalsThresholds
    library: LibraryThresholds
    equivalence: EquivalenceThresholds
    terms: TermsThresholds
    stronger: StrongerThresholds
    workflow: WorkflowThresholds


@cache
def thresholds(name: str | Path = "gap") -> Thresholds:
    """The thresholds of a shipped file by name, or of a TOML of one's own.

    Raises:
        ConfigError: an unknown table or key, or a value of another kind.
    """
    path = resolve(name)
    given, shipped = read_toml(path), read_toml(calib_folder() / "gap.toml")
    where = shown_path(path)
    if unknown := sorted(set(given) - set(Thresholds._fields)):
        raise ConfigError(f"{where}: [{unknown[0][:64]}] is no table of thresholds; expected {', '.join(Thresholds._fields)}")
    kinds = Thresholds.__annotations__
    return Thresholds(**{key: _table(kinds[key], given.get(key, {}), shipped[key], f"{where}: [{key}]") for key in kinds})


def _table(kind: Any, given: dict, shipped: dict, where: str) -> Any:
    """One table: what is given over what is shipped."""
    if not isinstance(given, dict):
        raise ConfigError(f"{where}: got {given!r:.40}, expected a table of thresholds")
    old = [key for key in given if kind is Gates and key in RENAMED]
    if old:
        console.warn(f"{where}: deprecated names: {', '.join(f'{key} is now {RENAMED[key]}' for key in old)}")
    entries = {(RENAMED[key] if key in old else key): entry for key, entry in given.items()}
    expected = {field.name: field.type for field in fields(kind)}
    if unknown := sorted(set(entries) - set(expected)):
        raise ConfigError(f"{where}: {unknown[0][:64]!r} is no threshold; expected {', '.join(expected)}")
    return kind(**{key: _value(entries.get(key, shipped[key]), kind, f"{where}: {key}") for key, kind in expected.items()})


def _value(entry: Any, kind: Any, where: str) -> Any:
    """A number or a list of numbers, written as it is or as { value, unit, source }."""
    value: Any = entry.get("value") if isinstance(entry, dict) else entry
    number = lambda x: isinstance(x, int | float) and not isinstance(x, bool)
    if kind is int and number(value) and value == int(value):
        return int(value)
    if kind is float and number(value):
        return float(value)
    if kind not in (int, float) and isinstance(value, list) and value and all(map(number, value)):
        return tuple(map(float, value))
    expected = {int: "a whole number", float: "a number"}.get(kind, "a list of numbers")
    raise ConfigError(f"{where}: got {value!r:.40}, expected {expected}")


def frozen() -> Gates:
    """The gates as shipped: how they were set stands beside each in the file."""
    return thresholds().gates


def residual_allowed(checks: dict, gates: Gates) -> float:
    """The |z|^2 / m of records predicted without their fold that may be left, by the gates of a verdict.

        residual <= R,   or, where form <= F,   residual - 1 <= F^2 (adequacy - 1)

    S holds the form error in steps of 1.4, and in a gap of a thousand times the floor a fiftieth of it shows. A formula that was
    found right to within F, what a formula may be wrong by, may leave F of what it explains.
    """
    if checks.get("form", np.inf) > gates.form:
        return gates.residual
    return max(gates.residual, 1.0 + gates.form**2 * (checks.get("adequacy", 1.0) - 1.0))
