"""Readers of flow records: tables of a velocity probe, and drifts of a marker recorded by `deploy track`."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log import read_trial
from fishmj.log.importers.delimited import read
from fishmj.log.trial_folder import META_FILE

UNITS = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
PAUSE = 5.0  # a gap of this many sample intervals begins a new record
LOST = 0.2  # largest share of missing rows within a record
SPIKE, SPIKES = 6.0, 0.05  # robust deviations from the median that make a spike; largest share of spikes
SHORTEST = 64  # minimal number of samples of a record


class Probe(NamedTuple):
    """Evenly sampled records (T, C) m/s of one file, their sample interval s, and the share of spikes."""

    records: list[np.ndarray]
    dt: float
    spikes: float


def read_probe(path: Path, time: str, components: Sequence[str], factor: float, rate: float | None = None) -> Probe:
    """Reads a table of velocities.

    Args:
        time: name of the time column, s; "" for rows evenly spaced at `rate` Hz.
        components: names of the velocity columns, x and, if measured, y and z.
        factor: factor from their unit to m/s.

    Raises LogError: not a table, no such column, times that do not rise, too few rows, or too many spikes.
    """
    sheet = read(path)
    for name in (*([time] if time else []), *components):
        if name not in sheet.columns:
            known = ", ".join(repr(column) for column in list(sheet.columns)[:12])
            raise LogError(f"{path}: no column {name!r}; its columns are {known}")
    values = np.stack([sheet.columns[name] for name in components], 1) * factor
    t = sheet.columns[time] if time else np.arange(len(values)) / (rate or 1.0)
    there = np.isfinite(values).all(1) & np.isfinite(t)
    t, values = t[there], values[there]
    if len(t) < SHORTEST:
        raise LogError(f"{path}: {len(t)} complete rows of time and velocity; expected {SHORTEST} at least")
    steps = np.diff(t)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        raise LogError(
            f"{path}: the time does not rise after {t[row]:g} s ({t[row + 1]:g} s follows); sort the rows, or give --rate"
        )
    dt = float(np.median(steps))
    clean, spikes = _despiked(t, values, path)
    parts = np.split(np.arange(len(t)), np.flatnonzero(steps > PAUSE * dt) + 1)
    parts = [p for p in parts if len(p) >= SHORTEST]
    records = [_even(t[p], clean[p], dt) for p in parts]
    lost = 1.0 - sum(map(len, parts)) / max(sum(map(len, records)), 1)
    if not records or lost > LOST:
        raise LogError(
            f"{path}: sampled too unevenly for statistics (median interval {dt:.3g} s, {100 * max(lost, 0):.0f} % missing)"
        )
    return Probe(records, dt, spikes)


def read_drifts(path: Path) -> list[np.ndarray]:
    """Tracks (T, 3), s, m, m, of a trial folder, or of every trial folder in it.

    Raises LogError: no trial there, or one without poses.
    """
    folders = [path] if (path / META_FILE).is_file() else sorted(p.parent for p in path.glob(f"*/{META_FILE}"))
    if not folders:
        raise LogError(f"{path}: no trial folder; fishmj deploy track VIDEO --out FOLDER makes one of a marker's drift")
    tracks = []
    for folder in folders:
        pose = read_trial(folder).tables.get("pose")
        if pose is None or len(pose["t"]) < 2:
            raise LogError(f"{folder}: no table pose; the marker was not seen")
        tracks.append(np.stack([pose["t"], pose["x"], pose["y"]], 1))
    return tracks


def _despiked(t: np.ndarray, values: np.ndarray, path: Path) -> tuple[np.ndarray, float]:
    """Values with spikes replaced by the straight line between their neighbours, and the share of rows that had one."""
    middle = np.median(values, 0)
    deviation = 1.4826 * np.median(np.abs(values - middle), 0)
    odd = np.abs(values - middle) > SPIKE * np.maximum(deviation, 1e-9)
    share = float(odd.any(1).mean())
    if share > SPIKES:
        raise LogError(
            f"{path}: {100 * share:.0f} % of the rows are spikes, farther than {SPIKE:g} robust deviations from the median; "
            "remove them first (by correlation or signal-to-noise ratio), or check the probe"
        )
    columns = [np.interp(t, t[~bad], column[~bad]) if bad.any() else column for column, bad in zip(values.T, odd.T, strict=True)]
    return np.stack(columns, 1), share


def _even(t: np.ndarray, values: np.ndarray, dt: float) -> np.ndarray:
    """Values interpolated to an even grid of step dt; unchanged if the time stamps are even already."""
    if np.abs(np.diff(t) - dt).max() < 0.02 * dt:
        return values
    grid = t[0] + dt * np.arange(int((t[-1] - t[0]) / dt + 1e-6) + 1)
    return np.stack([np.interp(grid, t, column) for column in values.T], 1)
