"""Removes the first moments of a launch from a carriage, because the fish loses too much speed there on the solver's coarse grid.

    steadied(trial, bare)      the log from `KICK` on, with the fish's velocity at that time as its `push`

A fish that is let go at 0.4 m/s has 0.34 m/s left 0.3 s later, one that is let go broadside at 0.3 m/s has 0.18 m/s, most of it
lost in the first 0.1 s (docs/search/calibrate.md). No water does that; the campaign's segments leave the same time out
(`hydro_fit.record.SegmentRecord.steadied`).

The velocity is the slope at `KICK` of a parabola through the camera's poses of the next `SEEN` s. They are taken without noise if
a noise-free record of the swim exists, else as a laboratory would take them, with the error `push_sigma`
(`gap.search.likelihood.launch_factors`): of 14 robots' logs about 6 mm/s and 0.03 rad/s.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fishmj.base.store import write_text
from fishmj.gap.bench.solver_plan import PLAN, SETS, TRUTH, read
from fishmj.gap.records.records import MOVING
from fishmj.hydro_fit.record import KICK
from fishmj.log import Trial
from fishmj.log.dataset import read_bundle, write_bundle
from studies.solver_family.family_plan import MODELS

SEEN = 0.8  # s, of which the velocity is told
LEFT_OUT = "left_out"  # key of the meta data: s that are


def without_launches(folder: Path, out: Path) -> int:
    """Copies data sets and cuts their launches; returns the number of data sets. Plan, models and truth stay as they are."""
    for name in (PLAN, TRUTH, *(str(path.relative_to(folder)) for path in (folder / MODELS).glob("*.toml"))):
        write_text(out / name, (folder / name).read_text(encoding="utf-8"))
    plan, made = read(folder), 0
    for one in plan.robots:
        late = plan.descriptions[one.model].timing.camera_latency
        for path in sorted((folder / SETS).glob(f"{one.id}-*.npz")):
            write_bundle(out / SETS / path.name, [steadied(trial, late) for trial in read_bundle(path)])
            made += 1
    return made


def launched(trial: Trial) -> bool:
    """Returns True if the fish starts from a carriage and its launch was not cut yet."""
    return any(trial.value("push", (0.0, 0.0, 0.0))) and not trial.value(LEFT_OUT, 0.0)


def steadied(trial: Trial, camera_latency: float, bare: Trial | None = None) -> Trial:
    """The trial without its first `KICK` s if the fish was launched from a carriage; else unchanged.

    Args:
        camera_latency: s. bare: the same swim as measured without noise.

    A model takes the mean of the first `MOVING` s of the camera's rows as the pose at t = 0. For a moving fish, rows before
    `KICK` are left out until that mean is its pose at `KICK`.
    """
    if not launched(trial):
        return trial
    begin = float(trial.table("cmd")["t"][0]) + KICK
    first = {table: begin for table in trial.tables} | {"pose": begin + max(2.0 * camera_latency - MOVING, 0.0)}
    tables = {name: _from(table, first[name]) for name, table in trial.tables.items()}
    push, spread = velocity((bare or trial).table("pose"), begin + camera_latency)
    meta = trial.meta | {"push": push, LEFT_OUT: KICK}
    if bare is None:
        sigma = trial.value("sigma", {})
        meta["push_sigma"] = [spread * float(sigma.get(name, 0.0)) for name in ("x", "y", "yaw")]
    return replace(trial, meta=meta, tables=tables)


def velocity(pose: dict[str, np.ndarray], at: float) -> tuple[list[float], float]:
    """(surge, sway [m/s], yaw rate [rad/s] at the stamp `at` of the camera's clock [s]; their error over that of a pose, 1/s)."""
    rows = (pose["t"] >= at) & (pose["t"] <= at + SEEN)
    values = np.stack([pose["x"][rows], pose["y"][rows], np.unwrap(np.asarray(pose["yaw"], float))[rows]], 1)
    powers = np.vander(pose["t"][rows] - at, 3, increasing=True)
    (_, _, yaw), (vx, vy, rate), _ = np.linalg.lstsq(powers, values, rcond=None)[0]
    c, s = np.cos(yaw), np.sin(yaw)
    return [float(c * vx + s * vy), float(c * vy - s * vx), float(rate)], float(np.linalg.inv(powers.T @ powers)[1, 1] ** 0.5)


def _from(table: dict[str, np.ndarray], begin: float) -> dict[str, np.ndarray]:
    """The rows from `begin` on."""
    rows = np.asarray(table["t"]) >= begin - 1e-9
    return {name: values[rows] for name, values in table.items()}
