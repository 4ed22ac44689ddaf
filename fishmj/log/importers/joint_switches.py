"""Rows from which a log's joint angles are in another unit, or in each other's columns."""

import numpy as np

from fishmj.log.trial import Table
from fishmj.log.trial_check import bounds_of
from fishmj.log.unread_rows import failed_rows

SAME, TINY = 0.1, 1e-9  # of a logarithm: 10 %; rad
LEAST = 0.03  # rad, of a jump
FURTHER = 3.0  # times the worst miss of all other rows: a jump, and the swing of a joint that moves
OFTEN = 3  # times that columns change over; more is how a robot moves


def find(t: np.ndarray, angles: Table) -> tuple[int, str, str] | None:
    """First row of a switch, its column, and what to do; None without one.

    Args:
        t: (T,) s. angles: (T,) rad, by name.
    """
    if len(angles) < 2:
        return None
    if row := _other_unit(t, angles):
        text = "all joints are 57 times smaller or larger from about here on: degrees and radians? Split the file there"
        return row, next(iter(angles)), text
    bounds = bounds_of({}, "")
    read = np.flatnonzero(~np.any([failed_rows(t, x, bounds) for x in angles.values()], axis=0))
    row, names = _exchanged(t[read], {name: x[read] for name, x in angles.items()})
    text = f"{', '.join(names)} jump at this row, and each goes on where another stood: are their columns exchanged from here on?"
    return (int(read[row]), names[0], f"{text} Split the file there, and map the columns of each part") if row else None


def _other_unit(t: np.ndarray, angles: Table) -> int:
    """First row from which every joint stays 57 times smaller or larger than in the second before; 0 if none."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    reach = int(np.clip(1.0 / step, 20, 2000)) if step > 0 else 0
    if not reach or len(t) < 4 * reach:
        return 0
    size = np.abs(np.stack([x for x in angles.values() if x.any()] or [np.zeros(len(t))]))
    blocks = size[:, : size.shape[1] // reach * reach].reshape(len(size), -1, reach).max(axis=2)
    before = np.maximum.accumulate(blocks, axis=1)[:, :-1]  # largest angle up to each second, and from the next one on
    after = np.maximum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1][:, 1:]
    times = np.abs(np.log(np.maximum(before, TINY) / np.maximum(after, TINY)))
    last = np.maximum(blocks[:, :-1], np.pad(blocks, ((0, 0), (1, 0)))[:, :-2])  # two blocks: the switch may lie inside one
    first = np.maximum(blocks[:, 1:], np.pad(blocks, ((0, 0), (0, 1)))[:, 2:])
    abrupt = (last > 0.5 * before) & (first > 0.5 * after)
    found = np.flatnonzero(np.all((np.abs(times - np.log(180 / np.pi)) < SAME) & abrupt, axis=0))
    return int(found[0] + 1) * reach if len(found) and len(size) > 1 else 0


def _exchanged(t: np.ndarray, angles: Table) -> tuple[int, list[str]]:
    """First row from which moving joints stand in each other's columns, and their names; (0, []) if none.

    Two rows give each joint's next angle on a straight line. Joints that are exchanged miss it far beyond the worst miss of all
    other rows, and are where the line of another joint goes. Rows on both sides of a pause are not judged.
    """
    if len(t) < 20:
        return 0, []
    x, step = np.stack(list(angles.values())), np.diff(t)
    line = x[:, 1:-1] + np.diff(x)[:, :-1] * (step[1:] / step[:-1])  # of rows 2..
    miss = np.abs(x[None, :, 2:] - line[:, None])  # (joint, column, row)
    own = np.diagonal(miss).T
    even = np.maximum(step[1:], step[:-1]) < 2 * float(np.median(step))
    nearest = np.argmin(miss, axis=0)  # the joint that goes on in each column
    jumps = (own > LEAST) & (nearest != np.arange(len(x))[:, None]) & (FURTHER * miss.min(axis=0) < own)
    whole = np.all(np.sort(nearest, axis=0) == np.arange(len(x))[:, None], axis=0)  # each joint goes on in one column
    rows = np.flatnonzero(even & whole & (jumps.sum(axis=0) > 1))
    rows = rows[np.diff(rows, prepend=-9) > 2]
    others = even.copy()
    others[(rows[:, None] + np.arange(3)).clip(max=len(even) - 1)] = False  # the next two rows' lines begin before the switch
    if not 0 < len(rows) <= OFTEN or not others.any():
        return 0, []
    worst, reach = float(own[:, others].max()), max(20, round(0.5 / float(np.median(step))))
    for row in rows:
        mine = np.flatnonzero(jumps[:, row])
        near = x[mine, max(0, row + 2 - reach) : row + 2], x[mine, row + 2 : row + 2 + reach]
        swings = min(float(np.ptp(part, axis=1).min()) for part in near)
        if min(own[mine, row].min(), swings) > FURTHER * worst and miss.min(axis=0)[mine, row].max() <= worst:
            return int(row) + 2, [list(angles)[k] for k in mine]
    return 0, []
