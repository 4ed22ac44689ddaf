"""Points of a force map: definition, duration, table, and several tanks that compute them side by side."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.cases.maps import average, planar_load
from fishmj.lbm_oracle.run.finished_rows import OK
from fishmj.lbm_oracle.run.run import Run, TankRun
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, never_stop, side_by_side

SETTLE = 5.0  # body lengths of water that pass before the average begins
WINDOW = 6.0  # m of water averaged over: ten periods of a wake of 0.1 m at a Strouhal number of 0.17
SHORTEST = 10  # ticks; fewer say nothing about their own scatter
KEYS = ("what", "joint_deg", "aoa_deg", "speed")
FIGURES = ("drag_N", "drag_sem_N", "lateral_N", "lateral_sem_N", "yaw_Nm", "yaw_sem_Nm", "drag_rms_N", "lateral_rms_N")
COLUMNS = (*KEYS, *FIGURES, "samples", "settle_s", "seconds", "refined_ticks", "status")


class Point(NamedTuple):
    """One held fish: map `joint` or `aoa`, angles deg, speed m/s."""

    what: str
    joint: float
    aoa: float
    speed: float

    def joints(self, number: int) -> np.ndarray:
        """Joint angles (number,) rad."""
        return np.full(number, np.radians(self.joint))

    @property
    def title(self) -> str:
        """Angles of the point, for people."""
        return f"joints {self.joint:g} deg, AoA {self.aoa:g} deg"


@dataclass(frozen=True, kw_only=True)
class AveragingTimes:
    """Seconds before the average and of the average; None: `SETTLE` body lengths and `WINDOW` metres of water."""

    settle: float | None
    seconds: float | None
    length: float  # m, of the fish

    def ticks(self, speed: float, tick: float) -> tuple[int, int]:
        """Numbers of bus ticks before the average and of the average, at a speed in m/s.

        Raises ConfigError: too short an average.
        """
        settle = SETTLE * self.length / speed if self.settle is None else self.settle
        seconds = WINDOW / speed if self.seconds is None else self.seconds
        if not (settle >= 0 and seconds >= SHORTEST * tick - 1e-9):
            short = f"expected 0 s or more and {SHORTEST * tick:g} s or more"
            raise ConfigError(f"forcemap: settle = {settle} s, seconds = {seconds} s; {short}")
        return round(settle / tick), round(seconds / tick)


def loads(run: Run, first: int = 0) -> np.ndarray:
    """(T, 3) drag N, lateral force N and yaw moment N m about the reference point, of the ticks from `first` on.

    The fish is held, so its links are at their present positions.
    """
    if len(run.rows) <= first:
        return np.zeros((0, 3))
    wrench = np.array([row[-1] for row in run.rows[first:]])  # (T, L, 6)
    return planar_load(run.coupled.body.data, run.pose[2], wrench) * [-1, -1, 1]


def row_of(point: Point, run: Run, settle: int) -> dict:
    """Row of the table: means over the ticks after `settle`, or over those that exist if the run stopped early.

    If the water failed, the ticks since the survey before are left out: only until then was it known to be sound.
    """
    record, tick = loads(run, settle), run.robot.timing.bus_dt
    if run.stopped and not run.stopped.startswith("left_domain"):
        record = record[: max(0, len(record) - ceil(run.watch.every / run.steps))]
    record = record[np.isfinite(record).all(1)]
    drag, lateral, yaw = (average(record[:, i]) for i in range(3))
    values = (drag.mean, drag.sem, lateral.mean, lateral.sem, yaw.mean, yaw.sem, drag.rms, lateral.rms)
    row = dict(zip(KEYS, point, strict=True)) | dict(zip(FIGURES, map(float, values), strict=True))
    samples = float(min(drag.samples, lateral.samples, yaw.samples))
    row |= {"samples": samples, "settle_s": settle * tick, "seconds": len(record) * tick}
    return row | {"refined_ticks": run.refined, "status": " ".join(run.stopped.split()) or OK}


def measure_points(
    waiting: Waiting, make: Callable[[Point], Run], plan: AveragingTimes, *, tick: float, tanks: int = 1, go_on: GoOn = never_stop
) -> Iterator[tuple[Point, dict, Run]]:
    """Yields points with their rows and runs as they finish, also early; arguments as `side_by_side`."""

    def start(point: Point) -> TankRun:
        settle, window = plan.ticks(point.speed, tick)
        return TankRun(make(point), settle + window, lambda run: (point, row_of(point, run, settle), run))

    return side_by_side(waiting, start, tanks=tanks, go_on=go_on)
