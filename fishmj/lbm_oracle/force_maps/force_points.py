"""Points of a force map: definition, duration, table, and several tanks that compute them side by side."""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import write_json, write_text
from fishmj.lbm_oracle.cases.maps import average
from fishmj.lbm_oracle.run.run import Run, TankRun
from fishmj.lbm_oracle.run.spread import GoOn, Waiting, never_stop, side_by_side

OK = "ok"
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

        Raises:
            ConfigError: too short an average.
        """
        settle = SETTLE * self.length / speed if self.settle is None else self.settle
        seconds = WINDOW / speed if self.seconds is None else self.seconds
        if not (settle >= 0 and seconds >= SHORTEST * tick - 1e-9):
            short = f"expected 0 s or more and {SHORTEST * tick:g} s or more"
            raise ConfigError(f"forcemap: settle = {settle} s, seconds = {seconds} s; {short}")
        return round(settle / tick), round(seconds / tick)


class Table:
    """Finished points in `folder/forcemap.csv`, replaced as a whole with every point, beside the set-up they share.

    Raises:
        ConfigError: the folder holds points of another set-up. StoreError: a file there is damaged.
    """

    def __init__(self, folder: Path, setup: dict, notes: dict | None = None):
        self.path, self.rows = folder / "forcemap.csv", {}
        self.about, self.notes = folder / "setup.json", (notes or {}) | {"setup": setup}
        if self.path.exists():
            self._check(self.about, setup)
            self.rows = {_point(row): row for row in _read(self.path)}

    @staticmethod
    def _check(about: Path, setup: dict) -> None:
        try:
            before = json.loads(about.read_text(encoding="utf-8"))["setup"]
        except (OSError, ValueError, KeyError) as error:
            raise StoreError(f"{about}: {error!r}; it says how the points beside it were made. Take another --out") from error
        other = [f"{key} = {before.get(key)} (now {value})" for key, value in setup.items() if before.get(key) != value]
        if other:
            raise ConfigError(f"{about.parent} holds points of another set-up: {', '.join(other)}. Take another --out")

    def __contains__(self, point: Point) -> bool:
        return point in self.rows

    def __getitem__(self, point: Point) -> dict:
        return self.rows[point]

    def add(self, point: Point, row: dict) -> None:
        """Keeps a point; it is on disk before this returns."""
        if not self.rows:
            write_json(self.about, self.notes)
        self.rows[point] = row
        text = StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows[p] for p in sorted(self.rows))
        write_text(self.path, text.getvalue())


def _read(path: Path) -> list[dict]:
    rows = []
    with path.open(encoding="utf-8", newline="") as file:
        for number, found in enumerate(csv.DictReader(file), 2):
            try:
                rows.append({name: found[name] if name in ("what", "status") else float(found[name]) for name in COLUMNS})
            except (KeyError, TypeError, ValueError) as error:
                raise StoreError(f"{path}:{number}: {error!r}; delete the line, its point is then run again") from error
    return rows


def _point(row: dict) -> Point:
    what, joint, aoa, speed = (row[key] for key in KEYS)
    return Point(what, joint, aoa, speed)


def loads(run: Run, first: int = 0) -> np.ndarray:
    """(T, 3) drag N, lateral force N and yaw moment N m about the reference point, of the ticks from `first` on.

    The fish is held, so its links are at their present positions.
    """
    if len(run.rows) <= first:
        return np.zeros((0, 3))
    x, y, yaw = run.pose[:3]
    arm = run.coupled.body.data.xpos[1:, :2] - (x, y)  # (L, 2)
    wrench = np.array([row[-1] for row in run.rows[first:]])  # (T, L, 6)
    fx, fy = wrench[:, :, 0], wrench[:, :, 1]
    turn = (wrench[:, :, 5] + arm[:, 0] * fy - arm[:, 1] * fx).sum(1)
    fx, fy = fx.sum(1), fy.sum(1)
    ahead, left = np.cos(yaw) * fx + np.sin(yaw) * fy, np.cos(yaw) * fy - np.sin(yaw) * fx
    return np.stack([-ahead, -left, turn], -1)


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


def with_progress(
    begin: Callable[[GoOn], Iterator[tuple]], points: Sequence[Point], plan: AveragingTimes, *, tick: float, quiet: bool
):
    """Yields the results of `begin(go_on)` for these points, with a line of progress in simulated seconds."""
    seconds = lambda point: sum(plan.ticks(point.speed, tick)) * tick
    done = 0.0
    with console.Progress(sum(map(seconds, points)), "forcemap", unit="s", every=1e9 if quiet else None) as bar:

        def told(under_way: float) -> bool:
            bar.update(done + under_way)
            return True

        for found in begin(told):
            done += seconds(found[0])
            yield found
