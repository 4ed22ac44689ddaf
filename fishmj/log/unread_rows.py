"""Rows without a measurement: a servo did not answer, or a camera lost the fish.

They are left out with a note wherever a log is used; `physical_checks` reports them. Bounds are in `plausible.toml`.
"""

from itertools import pairwise

import numpy as np

from fishmj.log.trial import GAP, Table
from fishmj.log.trial_check import Plausible

SHORT, OFTEN = 5, 3  # rows of one failed read at most; times that the same value must come back
LOST = 1.0  # s of a pose that is elsewhere and comes back, at most
LEAP = {"x": 0.05, "y": 0.05, "yaw": 0.5}  # m, m, rad: least jump of a lost pose


def is_sound(table: Table, names: list[str]) -> bool:
    """Returns True for columns of finite numbers, all of one length."""
    columns = [np.asarray(table[name]) for name in names if name in table]
    sound = len(columns) == len(names) and all(c.ndim == 1 and c.dtype.kind in "fiub" for c in columns)
    return sound and len({len(c) for c in columns}) == 1 and all(bool(np.isfinite(c).all()) for c in columns)


def lost_poses(table: Table, bounds: Plausible) -> tuple[np.ndarray, list[str]]:
    """(T,) bool rows of `pose` without the fish in view, and one note if there are some; none of a damaged table.

    x, y or yaw leaves its path and comes back within `LOST`, each time faster than a fish; one pose that a tracker repeats may
    last longer, and begin or end the table.
    """
    none = np.zeros(len(np.atleast_1d(next(iter(table.values()), ()))), bool)
    if not is_sound(table, ["t", "x", "y", "yaw"]) or len(none) < 12:
        return none, []
    t = np.asarray(table["t"], float)
    values = np.stack([np.asarray(table[name], float) for name in LEAP])
    steps = np.diff(values)
    steps[2] = np.angle(np.exp(1j * steps[2]))
    still = np.r_[0, np.cumsum(np.any(steps != 0, axis=0))]  # equal in rows that repeat one pose
    bad, seen = none.copy(), []
    for k, name in enumerate(LEAP):
        size = np.abs(steps[k])
        usual = float(np.median(size[size > 0])) if size.any() else 0.0
        limit = bounds.rate if name == "yaw" else bounds.leap
        jumps = np.flatnonzero((size > max(LEAP[name], 10 * usual)) & (size > limit * np.diff(t)))
        ends = [-1, *jumps, len(t) - 1] if len(jumps) else []
        rows = np.zeros(len(t), bool)
        for i, j in pairwise(ends):
            inside = i >= 0 and j < len(t) - 1
            if inside and not rows[i] and t[j + 1] - t[i] <= LOST:
                apart = values[k, j + 1] - values[k, i]
                apart = abs(np.angle(np.exp(1j * apart))) if name == "yaw" else abs(apart)
                rows[i + 1 : j + 1] = apart < 0.3 * min(size[i], size[j])
            if still[i + 1] == still[j] and j - i >= 2:
                rows[i + 1 : j + 1] = True
        if rows.any() and rows.mean() < 0.5:
            first = int(np.argmax(rows))
            seen.append(f"{name} {int(rows.sum())} times ({values[k, first]:.3g} first, at t = {t[first]:.3f} s)")
            bad |= rows
    return bad, [f"pose: {int(bad.sum())} of {len(t)} rows left out, the fish was lost in {'; '.join(seen)}"] if seen else []


def failed_reads(table: Table, bounds: Plausible) -> tuple[np.ndarray, list[str]]:
    """(T,) bool rows of `joint` with an unread joint, and one note if there are some; none of a damaged table."""
    if not is_sound(table, ["t", *joints(table)]):
        return np.zeros(len(np.atleast_1d(next(iter(table.values()), ()))), bool), []
    t = np.asarray(table["t"], float)
    bad, told = np.zeros(len(t), bool), []
    for name in joints(table):
        x = np.asarray(table[name], float)
        rows = failed_rows(t, x, bounds)
        if rows.any():
            first = int(np.argmax(rows))
            values = sorted(set(np.round(x[rows], 4)))
            seen = f"{values[0]:g} rad" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g} rad"
            fast = speeds(t, x)[rows[1:] | rows[:-1]].max()
            told.append(f"{name} {int(rows.sum())} times ({seen}, first at t = {t[first]:.3f} s, a jump of {fast:.3g} rad/s)")
            bad |= rows
    if bad.all():
        bad[:] = False
    if not bad.any():
        return bad, []
    return bad, [f"joint: {int(bad.sum())} of {len(t)} rows left out, failed reads of {'; '.join(told)}"]


UNREAD = {"joint": failed_reads, "pose": lost_poses}  # table -> rows that hold no measurement


def joints(table: Table, letter: str = "j") -> list[str]:
    """Names of a table's columns of joints, j1..jN, or those of another letter."""
    return [name for name in table if name[0] == letter and name[1:].isdecimal()]


def speeds(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(T - 1,) speeds between neighbouring rows."""
    return np.abs(np.diff(x)) / np.maximum(np.diff(t), 1e-6)


def is_logged(t: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(G,) False for times between two stamps (T,) that are further apart than a gap, or than five usual steps."""
    step = np.diff(t, prepend=t[0], append=t[-1])
    return step[np.searchsorted(t, times)] <= max(GAP, 5 * float(np.median(step)))


def failed_rows(t: np.ndarray, x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """(T,) bool: readings that leave the path and return within a few rows."""
    bad = np.zeros(len(x), bool)
    for _ in range(4):  # what a driver answers again and again first: beside it a good reading looks like a spike
        rows = np.flatnonzero(~bad)
        if len(rows) < 12:
            break
        found = _recurring(x[rows], bounds)
        if not found.any():
            found = _spikes(t[rows], x[rows], bounds)
        if not found.any():
            break
        bad[rows[found]] = True
    return bad


def _peaks(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(runs,) first and last row of each run of equal values, its height over both neighbours, and the usual height."""
    start = np.flatnonzero(np.r_[True, np.diff(x) != 0])
    end = np.r_[start[1:], len(x)] - 1
    v = x[start]
    if len(v) < 5:
        return start, end, np.zeros(len(v)), np.inf
    up, down = v[1:-1] - v[:-2], v[1:-1] - v[2:]
    out = np.where(up * down > 0, np.minimum(np.abs(up), np.abs(down)), 0.0)
    ends = np.abs([v[0] - v[1], v[-1] - v[-2]])  # the first and the last row have one neighbour
    peak = np.r_[ends[0], out, ends[1]]
    return start, end, np.where(end - start < SHORT, peak, 0.0), float(np.quantile(np.abs(up + down) / 2, 0.75))


def _recurring(x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows of one value that returns exactly, in short runs, each time far from its neighbours."""
    start, _, peak, _ = _peaks(x)
    large = peak > bounds.spike
    values, counts = np.unique(x[start[large]], return_counts=True)
    for value in values[np.argsort(-counts)][:3]:
        mine, others = x == value, np.flatnonzero(x != value)
        alone, rest = peak[large & (x[start] == value)], x[others]
        if len(alone) < OFTEN or len(rest) < len(x) / 2:
            continue
        usual = _peaks(rest)[3]
        far = np.abs(rest - value).min() > max(0.5, np.ptp(rest))  # beyond all others: wherever it stands
        if far or np.median(alone) > max(bounds.spike, 5 * usual):
            off = np.abs(value - np.interp(np.arange(len(x)), others, rest))  # a joint may pass through it
            return mine & (far | (off > max(bounds.spike / 3, 5 * usual)))
    return np.zeros(len(x), bool)


def _spikes(t: np.ndarray, x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows of peaks that the joint cannot reach and leave in the available time."""
    start, end, peak, usual = _peaks(x)
    step = np.abs(np.diff(x[start]))
    fast = step > bounds.rate * (t[start[1:]] - t[end[:-1]])
    found = (peak > max(bounds.spike, 5 * usual)) & np.r_[True, fast] & np.r_[fast, True]
    return np.repeat(found, np.diff(np.r_[start, len(x)]))
