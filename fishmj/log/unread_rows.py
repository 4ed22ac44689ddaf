"""Rows without a measurement: a servo did not answer, or a camera lost the fish.

They are left out with a note wherever a log is used; `physical_checks` reports them. Bounds are in `plausible.toml`.
"""

from itertools import pairwise

import numpy as np

from fishmj.log.trial import GAP, Table, repeats, table_spec
from fishmj.log.trial_check import Plausible

SHORT, OFTEN = 5, 3  # rows of one failed read at most; times that the same value must come back
MANY = 0.25  # share of lost poses beyond which the user decides on them
LOST = 1.0  # s of a pose that is elsewhere and comes back, at most
REPEATS, SLOWER, SPREAD, ALIKE = 20, 0.3, 1.2, 0.95  # runs; share of repeated rows; rows from their mean; share of runs
LONG = 5  # usual runs, which are a rest
SINGLE, TOGETHER = 0.6, 0.75  # of irregular frames: largest share of runs of one row; of rows that change, to those by chance
HALF, FOLD, LEVEL = np.pi + 1e-3, 2.4, 0.05  # rad: of a folded heading the most span, the least jump, and the least usual step
HELD, FILLED = 3, 0.1  # rows at least, and rad of the least jump to and from them, of a heading that a tracker filled in
LEAP = {"x": 0.05, "y": 0.05, "yaw": 0.5}  # m, m, rad: least jump of a lost pose


def is_sound(table: Table, names: list[str]) -> bool:
    """Returns True for columns of finite numbers, all of one length."""
    columns = [np.asarray(table[name]) for name in names if name in table]
    sound = len(columns) == len(names) and all(c.ndim == 1 and c.dtype.kind in "fiub" for c in columns)
    return sound and len({len(c) for c in columns}) == 1 and all(bool(np.isfinite(c).all()) for c in columns)


def lost_poses(table: Table, bounds: Plausible) -> tuple[np.ndarray, list[str]]:
    """(T,) bool rows of `pose` without the fish in view, and one note if there are some; none of a damaged table.

    x, y or yaw leaves its path and comes back within `LOST`, each time faster than a fish; one place that a tracker repeats may
    last longer, and begin or end the table. So may one heading, such as 0, that is repeated while x and y go on.
    """
    none = np.zeros(len(np.atleast_1d(next(iter(table.values()), ()))), bool)
    if not is_sound(table, ["t", "x", "y", "yaw"]) or len(none) < 12 or len(folds(table)):
        return none, []
    t = np.asarray(table["t"], float)
    values = np.stack([np.asarray(table[name], float) for name in LEAP])
    steps = np.diff(values)
    steps[2] = np.angle(np.exp(1j * steps[2]))
    place, whole = (np.r_[0, np.cumsum(np.any(of != 0, axis=0))] for of in (steps[:2], steps))  # equal in rows that repeat one
    bad, seen = none.copy(), []
    for k, name in enumerate(LEAP):
        size = np.abs(steps[k])
        jumps = leaps(name, t, size, bounds)
        ends = [-1, *jumps, len(t) - 1] if len(jumps) else []
        rows = np.zeros(len(t), bool)
        for i, j in pairwise(ends):
            inside = i >= 0 and j < len(t) - 1
            if inside and not rows[i] and t[j + 1] - t[i] <= LOST:
                apart = values[k, j + 1] - values[k, i]
                apart = abs(np.angle(np.exp(1j * apart))) if name == "yaw" else abs(apart)
                rows[i + 1 : j + 1] = apart < 0.3 * min(size[i], size[j])
            still = whole if name == "yaw" else place
            if still[i + 1] == still[j] and j - i >= 2:
                rows[i + 1 : j + 1] = True
        rows |= _filled_in(steps, max(FILLED, 10 * _usual(size))) if name == "yaw" else False
        rows = ~rows if _is_seen(values, k, rows) else rows
        if rows.any():
            first = int(np.argmax(rows))
            seen.append(f"{name} {int(rows.sum())} times ({values[k, first]:.3g} first, at t = {t[first]:.3f} s)")
            bad |= rows
    why = f"; that is {100 * bad.mean():.0f} % of all: are two fish in one file? Split it, or leave the cells of lost poses blank"
    note = f"pose: {int(bad.sum())} of {len(t)} rows left out, the fish was lost in {'; '.join(seen)}"
    return bad, [note + (why if bad.mean() > MANY else "")] if seen else []


def _is_seen(values: np.ndarray, k: int, rows: np.ndarray) -> bool:
    """Returns True if the fish is seen in these rows, which x, y or yaw (row k of `values`) jumps to, and is lost in the rest.

    A log may begin with a lost pose. A tracker that writes one value for it, such as x = y = 0, may do so in most of the rows.
    """
    held = [float(np.mean(v == np.median(v))) if len(v) else 1.0 for v in (values[k, rows], values[k, ~rows])]
    if rows.mean() > 0.5:
        return held[0] < 0.9 or held[1] > 0.5
    return k < 2 and held[0] < 0.5 and float(np.mean(np.any(values[:2, ~rows] != 0, axis=0))) < 0.1


def leaps(name: str, t: np.ndarray, size: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows of `pose` after which x, y or yaw steps, by `size`, faster than a fish and ten times as far as usual."""
    limit = bounds.rate if name == "yaw" else bounds.leap
    return np.flatnonzero((size > max(LEAP[name], 10 * _usual(size))) & (size > limit * np.diff(t)))


def _usual(size: np.ndarray) -> float:
    """Median of the steps that are not zero; 0 without one."""
    return float(np.median(size[size > 0])) if size.any() else 0.0


def _filled_in(steps: np.ndarray, least: float) -> np.ndarray:
    """(T,) bool rows in which the heading stands at one value while x or y moves, between a jump to it and a jump back."""
    turned = np.flatnonzero(steps[2] != 0)
    rows = np.zeros(steps.shape[1] + 1, bool)
    for i, j in pairwise(turned):  # the heading is one number in rows i + 1 to j
        there, back = steps[2, i], steps[2, j]
        if j - i >= HELD and min(abs(there), abs(back)) > least and there * back < 0 and steps[:2, i + 1 : j].any():
            rows[i + 1 : j + 1] = True
    return rows


def folds(pose: Table) -> np.ndarray:
    """Rows before which a heading jumps from one edge of half a turn to the other: it is an axis, folded; none of a direction.

    Such are the angles of an image's moments. Both sides of a jump are one axis, and the fish itself does not jump.
    """
    x, y, yaw = (np.asarray(pose[name], float) for name in LEAP)
    step = np.abs(np.diff(yaw))
    jumps = step > FOLD
    if not jumps.any() or np.ptp(yaw) > HALF:
        return np.zeros(0, int)
    usual = max(LEVEL, 3 * float(np.quantile(step[~jumps], 0.95, method="higher"))) if not jumps.all() else LEVEL
    sound = (np.pi - step < usual) & (np.hypot(np.diff(x), np.diff(y)) < LEAP["x"])
    return np.flatnonzero(jumps) + 1 if sound[jumps].all() else np.zeros(0, int)


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


def is_coarse(steps: np.ndarray) -> bool:
    """Returns True if steps (C, T) from row to row, as magnitudes, are mostly the least that each column's numbers resolve."""
    return all(np.median(step[step > 0]) < 1.5 * step[step > 0].min() for step in steps if step.any())


def fresh_rows(table: str, columns: Table) -> tuple[np.ndarray, list[str]]:
    """Rows in which a sensor that is slower than its log has a new value, with a note; all rows of any other table.

    A camera's 10 poses a second, written into 50 rows, are each up to 0.1 s old. Values that stand for about the same number of
    rows, or columns that change in the same rows, tell such a log from a robot at rest and from coarse numbers. In a rest, rows
    are kept at the sensor's rate.
    """
    every = np.arange(len(columns["t"]))
    if table == "cmd" or not table_spec(table).continuous:
        return every, []
    new = np.append(True, ~repeats(columns))
    starts = np.flatnonzero(new)
    length = np.diff(starts)[1:]  # the first value may have begun before the log
    if len(length) < REPEATS or len(starts) > (1 - SLOWER) * len(every):
        return every, []
    mean = float(length[length <= 2 * np.median(length)].mean())
    run = np.diff(np.append(starts, len(every)))[np.cumsum(new) - 1]  # rows of the value that stands in a row
    rest = run > LONG * np.median(length)
    irregular = bool(mean < 1 / (1 - SLOWER) or np.mean(np.abs(length - mean) <= SPREAD) < ALIKE)
    if irregular:
        moving = [v for c, v in columns.items() if c not in ("t", "t_rx", "seq") and np.ptp(v)]
        steps = np.abs(np.diff(np.stack(moving)))[:, ~rest[1:]]
        alone = 1 - np.prod(1 - np.mean(steps > 0, axis=1))  # share of rows with a change, did each column change by itself
        if is_coarse(steps) or np.mean(length == 1) > SINGLE or steps.any(axis=0).mean() > TOGETHER * alone:
            return every, []
        mean = float(length[length <= LONG * np.median(length)].mean())
    since = every - starts[np.cumsum(new) - 1]
    fresh = np.flatnonzero((since == 0) | rest & (since % max(2, round(mean)) == 0))
    period, how = float(np.median(np.diff(columns["t"]))), ", at irregular instants" * irregular
    text = f"{table}: each value stands in {mean:.3g} rows{how}: {1 / (mean * period):.3g} Hz written at {1 / period:.3g} Hz"
    return fresh, [f"{text}; its first row is kept, {len(fresh)} of {len(every)}"]


UNREAD = {"joint": failed_reads, "pose": lost_poses}  # table -> rows that hold no measurement


def left_out(name: str, table: Table, bounds: Plausible) -> tuple[np.ndarray, list[str]]:
    """(T,) bool rows of `joint` or `pose` to leave out, and notes; none where so many poses are lost that the user decides."""
    bad, notes = UNREAD[name](table, bounds)
    return (bad, notes) if name != "pose" or not bad.mean() > MANY else (np.zeros(len(bad), bool), [])


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
