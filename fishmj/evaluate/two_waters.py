"""The same controllers on the same trials in the flow solver and in a surrogate: targets, flows, fish, latencies and noise alike.

Trials are taken in an order of which every beginning is spread over speeds and directions, group by group with all controllers,
so that a run that ends early leaves complete trials. The solver keeps each finished trial in a folder named by its code; the
surrogate takes seconds and always runs anew.

    rmse_after_arrival   m, from first entry to 30 s, without arrival from 10 s on        of shorter trials: to the end, the
    rmse_holding         m, over 40 to 60 s                                               last two thirds, the last third
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import lcm
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj import engines
from fishmj.calib import constant
from fishmj.campaign.solver import solver_sha256
from fishmj.evaluate import metrics, tank
from fishmj.evaluate.driver import run
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.result import Result, arrival_tick
from fishmj.mjcf.description import Robot

KEYS = ("rmse_after_arrival", "rmse_holding")
STRIDE = 3  # between directions that follow each other in the order

Report = Callable[[int], None]  # control steps done, summed over trials
Water = Callable[..., Result]  # (controller, trials, report) -> result
Figures = dict[str, np.ndarray]  # key -> (n,)


class Measured(NamedTuple):
    """What was run: the trials that all controllers have finished, and their figures by water and controller."""

    trials: Trials
    solver: dict[str, Figures]
    surrogate: dict[str, Figures]

    def of(self, key: str) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """One figure, controller -> (n,), in solver and surrogate."""
        solver, surrogate = ({name: found[key] for name, found in water.items()} for water in (self.solver, self.surrogate))
        return solver, surrogate


def in_solver(robot: Robot, folder: Path, *, domain: str, slip: float, device: str, tanks: int) -> Water:
    """The flow solver; finished trials are kept in `folder` under the solver's own sha256 and not run again."""
    kept = Path(folder) / f"solver-{solver_sha256()[:8]}"

    def judge(brain, trials: Trials, report: Report) -> Result:
        box: dict[str, Any] = {"domain": domain, "slip": slip, "device": device, "tanks": tanks}
        return tank.judge(brain, robot, trials, kept, progress=report, **box)

    return judge


def in_surrogate(robot: Robot, engine: str = "batch") -> Water:
    """The robot's own water, fitted or not, on one of the engines."""
    body = engines.make(engine, robot)
    return lambda brain, trials, report: run(brain, robot, trials, body, progress=lambda k: report(k * len(trials)))


def both(
    brains: Sequence, trials: Trials, solver: Water, surrogate: Water, *, group: int = 1, budget: float | None = None,
    report: Callable[[str, float], None] = lambda name, seconds: None,
) -> Measured:  # fmt: skip
    """Run all controllers in both waters.

    Args:
        brains: controllers. trials: in the order in which they are run. group: trials that the solver runs side by side.
        budget: s of wall clock after which no further group is begun; the first one always is.
        report: called with a controller's name and the seconds of water done in the solver.
    """
    began, step = time.monotonic(), constant("timing", "control_dt")
    rows: dict[str, list[Figures]] = {brain.name: [] for brain in brains}
    done, water = 0, 0.0
    while done < len(trials) and not (done and budget is not None and time.monotonic() - began > budget):
        some = replace(trials, items=trials.items[done : done + group])
        for brain in brains:
            before = water
            told = lambda k: report(brain.name, before + k * step)  # noqa: B023, E731  called at once
            rows[brain.name].append(figures(solver(brain, some, told)))
            water += len(some) * trials.duration
            report(brain.name, water)
        done += len(some)
    finished = replace(trials, items=trials.items[:done])
    solved = {name: {key: np.concatenate([row[key] for row in found]) for key in KEYS} for name, found in rows.items()}
    swum = {brain.name: figures(surrogate(brain, finished, lambda k: None)) for brain in brains}
    return Measured(finished, solved, swum)


def figures(r: Result) -> Figures:
    """Both figures of every trial, (n,) m; of 60 s they are the judge's own rmse_after_arrival and rmse_last20."""
    last, first = float(r.t[-1]), arrival_tick(r)
    end = min(constant("protocol", "arrival_time"), last)
    missed = constant("protocol", "missed_window")[0] * end / constant("protocol", "arrival_time")
    since = np.where(first >= 0, r.t[first], missed)
    steady = np.array(constant("protocol", "steady_window")) / constant("protocol", "duration")
    return {"rmse_after_arrival": metrics.rms(r, since, end), "rmse_holding": metrics.rms(r, *(steady * last))}


def spread(trials: Trials) -> Trials:
    """The same trials in an order of which every beginning has all speeds and directions about equally often, repeats last."""
    speeds, angles = (sorted({getattr(t, name) for t in trials.items}) for name in ("speed", "los"))
    period = lcm(len(speeds), len(angles))
    stride = STRIDE if lcm(STRIDE, len(angles)) == STRIDE * len(angles) else 1

    def place(k: int) -> tuple[float, float]:
        """Condition k: both move on with k; after a period the speed moves on once more, so that none comes twice."""
        return speeds[(k + k // period) % len(speeds)], angles[stride * k % len(angles)]

    order = {place(k): k for k in range(len(speeds) * len(angles))}
    return replace(trials, items=tuple(sorted(trials.items, key=lambda t: (t.repeat, order[t.speed, t.los]))))
