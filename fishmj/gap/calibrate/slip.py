"""Estimates hull friction: the slip ratio s at which the flow solver's fish swims and coasts like the logged one.

    J(s, g) = sum_k ((m_k - p_k(s) sqrt(g)^[k is a swim]) / (e m_k))^2 + ((g - 1) / e_g)^2,       profile J(s) = min over g

m: speed at 1 Hz, speed at another beat, distance of a coast-down, each over the same seconds of every swim. g: thrust relative
to drag. A single swim cannot separate g from friction: for every s some g explains it. The coast has no thrust. Interval: J up to
2.71 above its minimum (90 %). The minimum of J tests that some s explains the swims: chi square with as many degrees of freedom
as metrics, less one for s.

p_k(s) is a table of solver swims. Between its entries 1 / speed^2 is taken as straight in 1 - s, as near s = 1 it is: the wall's
stress is rho c times the speed at which water slides along it, c = -ln(s) dx / dt, and drag over thrust is a + b c.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console, interrupt
from fishmj.base.errors import LogError, UnknownName
from fishmj.gap.calibrate.calibration_logs import PartialResults
from fishmj.gap.calibrate.parameter_fit import ParameterEstimate, calibration_table
from fishmj.log import Trial
from fishmj.log.trial import Table

SWIMS = {"gait": 1.0, "gait_slow": 0.5}  # excitation -> Hz
COAST = "tow_ahead"
WINDOW = {"gait": (5.9, 7.9), "gait_slow": (3.9, 7.9), COAST: (0.5, 4.5)}  # s, whole beats; a slow fish still gains speed there
SPARE = 0.3  # s of a swim after its window: the camera is late
EDGE = 0.05  # s at both ends, averaged against the camera's noise
DOUBTFUL = 0.05  # p-value of J below which the estimate is invalid
RISE = 2.71  # of chi square with one degree of freedom, 90 %
GRID = np.linspace(0.0, 1.0, 1001) ** 2  # 1 - s, dense where the speed changes most
SHOWN = (0.0, 0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.998, 1.0)


class Profile(NamedTuple):
    """s (S,), J(s) (S,), best thrust factor g (S,), predictions {metric: (S,)}, measured {metric: (mean, repeats)}."""

    s: np.ndarray
    cost: np.ndarray
    thrust: np.ndarray
    predicted: dict[str, np.ndarray]
    measured: dict[str, tuple[float, int]]
    estimate: ParameterEstimate
    grid: str

    @property
    def words(self) -> str:
        """Sentence on the fit, or on why the estimate is invalid."""
        return self.doubt or f"J = {self.cost.min():.2f} at its least, {len(self.predicted)} metrics"

    @property
    def doubt(self) -> str:
        """Reason that the estimate is invalid; "" if it is valid."""
        from scipy.stats import chi2

        e, least = self.estimate, float(self.cost.min())
        free = max(len(self.predicted) - 1, 1)  # one metric is met by some ratio, unless its fish is another
        if chi2.sf(least, free) < DOUBTFUL:
            return f"no slip ratio explains all of these swims: minimum J = {least:.1f}, {len(self.predicted)} metrics"
        if e.low <= self.s[0] and e.high >= self.s[-1]:
            return f"not identifiable: every slip ratio from {self.s[0]:g} up explains these swims with some thrust"
        return ""

    def rows(self) -> list[dict]:
        """The profile at a few ratios, for a table."""
        out = []
        for s in (s for s in SHOWN if s >= self.s[0] - 1e-9):
            i = int(np.argmin(np.abs(self.s - s)))
            swims = {k: v[i] * (1.0 if k == COAST else float(np.sqrt(self.thrust[i]))) for k, v in self.predicted.items()}
            more = float(self.cost[i] - self.cost.min())
            out.append(
                {"s": float(self.s[i]), **{k: float(v) for k, v in swims.items()}, "thrust": float(self.thrust[i]), "rise": more}
            )
        return out


def measured(trials: Iterable[Trial]) -> dict[str, tuple[float, int]]:
    """Mean over the repeats and their number: speed [m/s] of each swim, distance [m] of the coast.

    Raises LogError: no swim and no coast among them is long enough.
    """
    found: dict[str, list[float]] = {}
    for trial in trials:
        name = str(trial.value("excitation", ""))
        if (name in SWIMS or name == COAST) and trial.value("medium", "water") == "water" and "pose" in trial.tables:
            value = metric(name, trial.table("pose"))
            if value == 0.0:
                raise LogError(f"slip: trial {trial.name}: the fish does not move in a {name}; is the camera's pose recorded?")
            if np.isfinite(value):
                found.setdefault(name, []).append(value)
    if not found:
        needs = ", ".join([*SWIMS, COAST])
        raise LogError(
            f"slip: none of {needs} among the trials, or all too short; record a swim at 1 Hz, 30 deg and a coast-down"
        )
    return {name: (float(np.mean(values)), len(values)) for name, values in found.items()}


def metric(name: str, pose: Table) -> float:
    """Speed or distance over the metric's window; NaN if the trial is too short."""
    t, (first, last) = np.asarray(pose["t"], float), WINDOW[name]
    if t[0] > first - EDGE or t[-1] < last + EDGE:
        return float("nan")
    near = [np.abs(t - end) <= EDGE for end in (first, last)]
    ends = np.array([[np.mean(pose[axis][rows]) for axis in ("x", "y")] for rows in near])
    far = float(np.hypot(*(ends[1] - ends[0])))
    return far if name == COAST else far / (last - first)


def table_name(entry: Mapping) -> str:
    """Name of a table of solver swims: its grid, and its boundary unless plain, as `window_coarse, rims`."""
    boundary = entry.get("boundary", "plain")
    return entry["grid"] if boundary == "plain" else f"{entry['grid']}, {boundary}"


def least_slip(grid: str, metrics: Iterable[str]) -> float:
    """Least slip ratio at which the table of a grid has all of its metrics; below it nothing is known."""
    least = 0.0
    for entry in calibration_table()["solver"]:
        for name in metrics if table_name(entry) == grid else ():
            known = [s for s, value in zip(entry["slip"], entry.get(name, ()), strict=False) if np.isfinite(value)]
            least = max([least, *([min(known)] if known else [])])
    return least


def predictions(grid: str, s: np.ndarray) -> dict[str, np.ndarray]:
    """Metrics of the solver's fish on one grid at slip ratios s (S,); NaN outside its swims.

    Raises UnknownName: no table of that grid.
    """
    tables = {table_name(entry): entry for entry in calibration_table()["solver"]}
    if grid not in tables:
        raise UnknownName("grid of the slip table (made by: calibrate slip --recompute --grid NAME)", grid, tables)
    entry, out = tables[grid], {}
    for name in (*SWIMS, COAST):
        if name in entry:
            slip, value = np.array(entry["slip"], float), np.array(entry[name], float)
            known = np.isfinite(value)
            if name == COAST:
                out[name] = _between(np.sqrt(1.0 - slip[known]), value[known], np.sqrt(1.0 - s))
            else:
                out[name] = _between(1.0 - slip[known], value[known] ** -2.0, 1.0 - s) ** -0.5
    return out


def _between(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Monotone interpolation between entries, NaN beyond the last."""
    from scipy.interpolate import PchipInterpolator

    order = np.argsort(x)
    inside = np.clip(at, x.min(), x.max())
    return np.where(np.abs(at - inside) < 1e-6, PchipInterpolator(x[order], y[order])(inside), np.nan)


def profile(found: dict[str, tuple[float, int]], grid: str) -> Profile:
    """The likelihood of the slip ratio, thrust left free within its tolerance."""
    tolerance, s = calibration_table()["slip"], 1.0 - GRID[::-1]
    s = s[s >= least_slip(grid, found) - 1e-9]
    predicted = {name: values for name, values in predictions(grid, s).items() if name in found}
    if not predicted:
        raise LogError(f"slip: the table of grid {grid!r} has none of {', '.join(found)}; remake it with --recompute")
    g = np.linspace(0.5, 1.5, 201)[:, None]
    cost = ((g - 1.0) / tolerance["thrust"]) ** 2 + np.zeros_like(s)
    for name, values in predicted.items():
        value = found[name][0]
        cost = cost + ((value - values * (1.0 if name == COAST else np.sqrt(g))) / (tolerance["form"] * value)) ** 2
    best = np.argmin(cost, 0)
    least = cost[best, np.arange(len(s))]
    at = int(np.argmin(least))
    inside = s[least <= least[at] + RISE]
    low, high = float(inside.min()), float(inside.max())
    estimate = ParameterEstimate("slip", "1", float(s[at]), low, high, (high - low) / 3.29, "model")
    return Profile(s, least, g[best, 0], predicted, found, estimate, grid)


def grid_of(trials: Iterable[Trial]) -> str:
    """The grid that a trial of the flow solver names; for other logs the finest table."""
    return next((str(name) for trial in trials if (name := trial.value("grid.domain", ""))), "window")


def recompute(grid: str, ratios: Iterable[float], device: str, tanks: int, folder: Path, boundary: str = "plain") -> dict:
    """Computes one entry of the table: the nominal fish in the solver, without noise, at every ratio.

    Args:
        device: one, or several (`devices_of`). tanks: swims side by side on each. folder: for finished swims, which are not
            repeated. boundary: of `BOUNDARIES`.
    """
    from dataclasses import replace
    from functools import partial

    from fishmj.gap.laboratory.hidden_lbm.hidden import jobs
    from fishmj.lbm_oracle.fluid.device import devices_of
    from fishmj.lbm_oracle.run.solver_water import BOUNDARIES, boundary_entry
    from fishmj.lbm_oracle.run.spread import spread
    from fishmj.log import excitation
    from fishmj.log.excitation import PERIOD

    devices = devices_of(device)

    whats = [excitation.get(name) for name in WINDOW]
    rows = [round((WINDOW[what.id][1] + SPARE) / PERIOD) for what in whats]
    whats = [replace(what, commands=what.commands[:n]) for what, n in zip(whats, rows, strict=True)]
    ratios, edge = sorted(float(s) for s in ratios), BOUNDARIES[boundary]
    at = (replace(job, slip=s, sharpness=edge) for s in ratios for job in jobs({}, whats, 0, 0.0, 0.0, grid))
    every = {_swim(job): job for job in at}
    named = {"grid": grid} | boundary_entry(edge)
    kept = PartialResults(folder, named)
    waiting = [job for name, job in every.items() if kept.find(name) is None]
    steps = sum(job.steps for job in waiting)
    domain = next(iter(every.values())).domain
    water, cells = steps * domain.dt, sum(np.prod(level.shape) for level in domain.levels) / 1e6
    there = f"; {len(every) - len(waiting)} more are kept in {folder}" if len(waiting) < len(every) else ""
    console.say(f"{len(waiting)} swims, {water:.0f} s of water, {steps} steps of {cells:.2f} million cells on {device}{there}")
    with interrupt.keeping(lambda: kept.words(list(every), "swims")):
        for job, found in spread(partial(_metrics, tanks=tanks), waiting, devices):
            kept.keep(_swim(job), [found])
            console.say(f"slip {job.slip:g}, {job.what.id}: {found:.4g}")
    entry: dict = {**named, "slip": ratios, **{name: [float("nan")] * len(ratios) for name in WINDOW}}
    for name, job in every.items():
        (value,) = kept.find(name)
        entry[job.what.id][ratios.index(job.slip)] = float("nan") if value is None else value
    return entry


def _metrics(waiting, device: str, go_on, *, tanks: int):
    """Yields jobs and their metrics as they are finished, `tanks` side by side on one device (`spread`)."""
    from fishmj.gap.laboratory.hidden_lbm.hidden import run_jobs, trial_of

    for run in run_jobs(waiting, device, tanks):
        yield run.job, metric(run.job.what.id, trial_of(run).table("pose"))


def _swim(job) -> str:
    """File name of a swim of `recompute`."""
    return f"{job.what.id}-{job.slip!r}"
