"""Runs the same controllers on the same trials (targets, flows, fish, latencies, noise) in the flow solver and in a surrogate.

Trials are ordered so that any first part covers speeds and directions evenly. Groups of trials run with all controllers, so that
an early end leaves complete trials. Finished solver trials are saved in a folder named by the hash of the solver's code; the
surrogate takes seconds and always runs again.

    rmse_after_arrival   m, from first entry to 30 s, without arrival from 10 s on        of shorter trials: to the end, the
    rmse_holding         m, over 40 to 60 s                                               last two thirds, the last third
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import lcm
from pathlib import Path
from typing import Any

import numpy as np

from fishmj import engines
from fishmj.base.calib import constant
from fishmj.evaluate import metrics, run_trials
from fishmj.evaluate.metrics import Result, arrival_tick
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.run_trials import run
from fishmj.hydro_fit.campaign.data.solver_hash import solver_sha256
from fishmj.lbm_oracle.run.solver_water import SolverWater
from fishmj.mjcf.description import Robot

KEYS = ("rmse_after_arrival", "rmse_holding")
AGAIN = (
    run_trials.Variation("r1", (0.37, -0.21)),
    run_trials.Variation("r2", (-0.14, 0.46)),
    run_trials.Variation("half", finer=2),
)
OFTEN = 8  # repeats in the surrogate, each with the fish shifted by at most half a cell
STRIDE = 3  # index step between consecutive directions in the order

Report = Callable[[int], None]  # control steps done, summed over trials
Water = Callable[..., Result]  # (controller, trials, report) -> result
Figures = dict[str, np.ndarray]  # key -> (n,)
ByController = dict[str, Figures]
Said = Callable[[str, float], None]  # controller, seconds of water done


def silent(name: str, seconds: float) -> None:
    """Report function that does nothing."""


def in_solver(
    robot: Robot, folder: Path, water: SolverWater, *, device: str, tanks: int,
    variation: run_trials.Variation = run_trials.UNCHANGED,
) -> Water:  # fmt: skip
    """Function that runs trials in the flow solver; `folder` keeps finished ones under the solver's sha256; none is run again."""
    kept = kept_in(folder).parent

    def judge(brain, trials: Trials, report: Report) -> Result:
        how: dict[str, Any] = {"water": water, "device": device, "tanks": tanks, "variation": variation}
        return run_trials.judge_in_solver(brain, robot, trials, kept, progress=report, **how)

    return judge


def kept_in(folder: Path) -> Path:
    """Folder in which `in_solver` keeps finished trials."""
    return Path(folder) / f"solver-{solver_sha256()[:8]}" / run_trials.KEPT


def in_surrogate(robot: Robot, engine="batch", shift: tuple[float, float] = (0.0, 0.0)) -> Water:
    """Function that runs trials in the robot's own water, in an engine or one by name.

    Fish start `shift` m beside the trial's start.
    """
    body = engines.make(engine, robot) if isinstance(engine, str) else engine
    return lambda brain, trials, report: run(brain, robot, trials, body, shift=shift, progress=lambda k: report(k * len(trials)))


def shifts(seed: int, cell: float) -> list[tuple[float, float]]:
    """Offsets of the fish in the surrogate's repeats, m beside their trials' starts: uniform in the cell around them."""
    drawn = np.random.default_rng([seed, OFTEN]).uniform(-0.5, 0.5, (OFTEN, 2)) * cell
    return [(float(x), float(y)) for x, y in drawn]


def solve(
    brains: Sequence, trials: Trials, solver: Water, *, group: int = 1, budget: float | None = None, report: Said = silent
) -> tuple[Trials, ByController]:
    """Runs all controllers in the solver, trial by trial.

    Args:
        brains: controllers. trials: in the order in which they are run. group: number of trials that run side by side.
        budget: s of wall clock after which no further group starts; the first one always does.
    Returns:
        the trials that all controllers have finished, and their figures.
    """
    began, done, water = time.monotonic(), 0, 0.0
    rows: dict[str, list[Figures]] = {brain.name: [] for brain in brains}
    while done < len(trials) and not (done and budget is not None and time.monotonic() - began > budget):
        some = replace(trials, items=trials.items[done : done + group])
        for brain in brains:
            rows[brain.name].append(_one(brain, some, solver, water, report))
            water += len(some) * trials.duration
        done += len(some)
    joined = {name: {key: np.concatenate([row[key] for row in found]) for key in KEYS} for name, found in rows.items()}
    return replace(trials, items=trials.items[:done]), joined


def swim(brains: Sequence, trials: Trials, surrogate: Water, *, report: Said = silent) -> ByController:
    """Runs all controllers in the surrogate, all trials at once."""
    each = len(trials) * trials.duration
    return {brain.name: _one(brain, trials, surrogate, i * each, report) for i, brain in enumerate(brains)}


def _one(brain, trials: Trials, water: Water, before: float, report: Said) -> Figures:
    """Runs one controller; `before` simulated seconds were done when it started."""
    step = constant("timing", "control_dt")
    found = figures(water(brain, trials, lambda k: report(brain.name, before + k * step)))
    report(brain.name, before + len(trials) * trials.duration)
    return found


def figures(r: Result) -> Figures:
    """Both figures of every trial, (n,) m; for trials of 60 s they are the judge's own rmse_after_arrival and rmse_last20."""
    last, first = float(r.t[-1]), arrival_tick(r)
    end = min(constant("protocol", "arrival_time"), last)
    missed = constant("protocol", "missed_window")[0] * end / constant("protocol", "arrival_time")
    since = np.where(first >= 0, r.t[first], missed)
    steady = np.array(constant("protocol", "steady_window")) / constant("protocol", "duration")
    return {"rmse_after_arrival": metrics.rms(r, since, end), "rmse_holding": metrics.rms(r, *(steady * last))}


def spread(trials: Trials) -> Trials:
    """The same trials in an order of which every first part has all speeds and directions about equally often, repeats last."""
    speeds, angles = (sorted({getattr(t, name) for t in trials.items}) for name in ("speed", "los"))
    period = lcm(len(speeds), len(angles))
    stride = STRIDE if lcm(STRIDE, len(angles)) == STRIDE * len(angles) else 1

    def place(k: int) -> tuple[float, float]:
        """Order of condition k: both indices advance with k.

        After a period the speed advances once more, so that none comes twice.
        """
        return speeds[(k + k // period) % len(speeds)], angles[stride * k % len(angles)]

    order = {place(k): k for k in range(len(speeds) * len(angles))}
    return replace(trials, items=tuple(sorted(trials.items, key=lambda t: (t.repeat, order[t.speed, t.los]))))
