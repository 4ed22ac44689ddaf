"""Friction of the hull: which slip ratio s of the flow solver makes its fish swim and coast as the logged one does.

    J(s, g) = sum_k ((m_k - p_k(s) sqrt(g)^[k is a swim]) / (e m_k))^2 + ((g - 1) / e_g)^2,       profile J(s) = min over g

m: speed at 1 Hz, speed at another beat, distance of a coast-down. g: thrust against drag, which no single swim can tell from
friction: for every s some g explains it. The coast has no thrust. p_k(s) is a table of solver swims, monotone between its entries
in sqrt(1 - s), where the speed is nearly straight. Interval: J up to 2.71 above its least (90 %).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fishmj import console
from fishmj.calibrate.least_squares import Estimate
from fishmj.calibrate.systematic import table
from fishmj.errors import LogError, UnknownName
from fishmj.log import Trial
from fishmj.log.trial import Table

SWIMS = {"gait": 1.0, "gait_slow": 0.5}  # excitation -> Hz
COAST = "tow_ahead"
COASTING = (0.5, 4.5)  # s
BEATS = 2
START = 1.0  # s before a swim has faded in, and one beat to get going
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
    estimate: Estimate
    grid: str

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

    Raises:
        LogError: no swim and no coast among them that is long enough.
    """
    found: dict[str, list[float]] = {}
    for trial in trials:
        name = str(trial.value("excitation", ""))
        if (name in SWIMS or name == COAST) and trial.value("medium", "water") == "water" and "pose" in trial.tables:
            value = metric(name, trial.table("pose"))
            if np.isfinite(value):
                found.setdefault(name, []).append(value)
    if not found:
        needs = ", ".join([*SWIMS, COAST])
        raise LogError(
            f"slip: none of {needs} among the trials, or all too short; record a swim at 1 Hz, 30 deg and a coast-down"
        )
    return {name: (float(np.mean(values)), len(values)) for name, values in found.items()}


def metric(name: str, pose: Table) -> float:
    """Speed over the last two beats, or distance of the coast; NaN where the trial is too short."""
    t = np.asarray(pose["t"], float)
    first, last = COASTING if name == COAST else (t[-1] - 0.05 - BEATS / SWIMS[name], t[-1] - 0.05)
    if last > t[-1] or first < (0.0 if name == COAST else START + 1.0 / SWIMS[name]):
        return float("nan")
    near = [np.abs(t - end) <= 0.05 for end in (first, last)]
    ends = np.array([[np.mean(pose[axis][rows]) for axis in ("x", "y")] for rows in near])
    far = float(np.hypot(*(ends[1] - ends[0])))
    return far if name == COAST else far / (last - first)


def least_slip(grid: str, metrics: Iterable[str]) -> float:
    """Roughest hull for which the table of a grid has all of the metrics that it has; beyond it nothing is known."""
    least = 0.0
    for entry in table()["solver"]:
        for name in metrics if entry["grid"] == grid else ():
            known = [s for s, value in zip(entry["slip"], entry.get(name, ()), strict=False) if np.isfinite(value)]
            least = max([least, *([min(known)] if known else [])])
    return least


def predictions(grid: str, s: np.ndarray) -> dict[str, np.ndarray]:
    """Metrics of the solver's fish on one grid at slip ratios s (S,).

    Raises:
        UnknownName: no table of that grid.
    """
    from scipy.interpolate import PchipInterpolator

    tables = {entry["grid"]: entry for entry in table()["solver"]}
    if grid not in tables:
        raise UnknownName("grid of the slip table", grid, tables)
    entry = tables[grid]
    out = {}
    for name in (*SWIMS, COAST):
        if name in entry:
            x, y = np.sqrt(1.0 - np.array(entry["slip"], float)), np.array(entry[name], float)
            known = np.isfinite(y)
            order = np.argsort(x[known])
            out[name] = PchipInterpolator(x[known][order], y[known][order])(np.sqrt(1.0 - s))
    return out


def profile(found: dict[str, tuple[float, int]], grid: str) -> Profile:
    """The likelihood of the slip ratio, thrust left free within its tolerance."""
    tolerance, s = table()["slip"], 1.0 - GRID[::-1]
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
    estimate = Estimate("slip", "1", float(s[at]), low, high, (high - low) / 3.29, "model")
    return Profile(s, least, g[best, 0], predicted, found, estimate, grid)


def grid_of(trials: Iterable[Trial]) -> str:
    """The grid that a trial of the flow solver names; the finest table for logs of anything else."""
    for trial in trials:
        name = trial.value("grid.domain", "")
        if name:
            return str(name)
    return "window"


def recompute(grid: str, ratios: Iterable[float], device: str, tanks: int, seconds: float | None = None) -> dict:
    """One entry of the table: the nominal fish in the solver, without noise, at every ratio."""
    from dataclasses import replace

    from fishmj import excitation
    from fishmj.campaign.hidden import jobs, swum, trial_of
    from fishmj.excitation import PERIOD

    longest = {COAST: COASTING[1] + 0.5}
    whats = [excitation.get(name) for name in (*SWIMS, COAST)]
    rows = [round(min(longest.get(what.id, what.seconds), seconds or what.seconds) / PERIOD) for what in whats]
    whats = [replace(what, commands=what.commands[:n]) for what, n in zip(whats, rows, strict=True)]
    ratios = sorted(float(s) for s in ratios)
    waiting = [replace(job, slip=s) for s in ratios for job in jobs({}, whats, 0, 0.0, 0.0, grid)]
    entry: dict = {"grid": grid, "slip": ratios, **{name: [float("nan")] * len(ratios) for name in (*SWIMS, COAST)}}
    for run in swum(waiting, device, tanks):
        found = metric(run.job.what.id, trial_of(run).table("pose"))
        entry[run.job.what.id][ratios.index(run.job.slip)] = found
        console.say(f"slip {run.job.slip:g}, {run.job.what.id}: {found:.4g}")
    return entry
