"""Offset between two clocks from the onset of motion: where both records begin at rest, a body stirs when its joints do.

A steady beat fits itself at any whole number of beats, so that its shift tells no offset. Its beginning does. A fish that is held
while its joints beat, or towed before they do, stirs at another time too, on right clocks. So the later channel's first motion
must look like the earlier one's at the onset of that (the clocks differ), clearly more than at the same stamps (the fish was held
or towed); with the channels as equal, the records must have begun as far apart.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from fishmj.log.clock_alignment import rates
from fishmj.log.trial import Trial, stacked

GRID, BLUR = 0.02, 2.5  # s of the common grid; steps of it over which a rate is smoothed
SLOW = 0.1  # s, median step of a channel too coarse for an onset
REST = 0.4  # s that a record must begin at rest
CALM, STIRS = 0.2, 0.15  # of the usual rate: most at rest, and least at the onset
LEAST, BEATS = 1.0, 1.25  # s, and beats of the earlier channel, by which the onsets differ at least
SHORTEST, FIRST = 4.0, 2.0  # s of a record; beats of first motion that are compared
LATE, FREED = 0.1, 0.2  # s of a delayed copy of the earlier channel: the mechanism between the two; in which a free body settles
ALIKE, CLEARER, EQUAL = 0.6, 0.5, 1.2  # share of first motion explained; what is left over what is left at the same stamps
LEFT = 0.02  # share by which that is more at the same stamps; a fish that was held leaves 0.007 there
TOGETHER = 0.25  # s, to which the records' first stamps differ as their onsets do
LONGEST = 600.0  # s of a record that are looked at


class Onset(NamedTuple):
    """First motion of a channel: its time [s], and the rates (G, N) on a grid (G,) [s]."""

    at: float
    grid: np.ndarray
    rate: np.ndarray


def onset_of(t: np.ndarray, values: np.ndarray) -> Onset | None:
    """First motion of a channel, t (T,) [s], values (T, N); None if it does not begin at rest, or never clearly moves."""
    if len(t) < 8 or t[-1] - t[0] < SHORTEST or float(np.median(np.diff(t))) > SLOW:
        return None
    grid = np.arange(t[0], min(t[-1], t[0] + LONGEST), GRID)
    rate, rows = rates(t, values, grid, BLUR), round(REST / GRID)
    rate = rate - np.median(rate[:rows], axis=0)
    pace = np.sqrt(np.convolve(np.sum(rate**2, axis=1), np.ones(rows // 2) / (rows // 2), "same"))
    usual, calm = float(np.quantile(pace, 0.95)), float(pace[:rows].max())
    if calm >= CALM * usual:
        return None
    return Onset(float(grid[np.argmax(pace > max(STIRS * usual, 2 * calm))]), grid, rate)


def offset_findings(trial: Trial, told: Collection[str] = ()) -> list[str]:
    """One sentence for each table whose first motion is early or late: joints against commands, the body against both.

    Args:
        told: tables whose offset is known already.
    """
    out: list[str] = []
    tables, good = trial.tables, {}
    for name, template in (("cmd", "c#"), ("joint", "j#")):
        if name in tables and (angles := stacked(tables[name], template)).shape[1]:
            good[name] = (tables[name]["t"], angles)
    channels = {"joint": good["joint"]} if len(good) == 2 else {}
    if "pose" in tables:
        channels["pose"] = tables["pose"]["t"], np.unwrap(tables["pose"]["yaw"])[:, None]
    for name, column in (("velocity", "yaw_rate"), ("imu", "wz")):
        if column in tables.get(name, {}):
            t, turn = tables[name]["t"], tables[name][column]
            channels[name] = t, np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * np.diff(t))])[:, None]
    for name, channel in channels.items():
        source = "joint" if name != "joint" and "joint" in good else "cmd"
        if name in told or source not in good or (at := offset_by_onset(*good[source], *channel)) is None:
            continue
        if name == "joint":
            del good["joint"]  # whose clock is off: the body is compared with the commands
        out.append(
            f"{source} first moves at t = {at[0]:.2f} s, {name} at t = {at[1]:.2f} s, both from rest and alike: their clocks"
            f" differ by whole beats or more, {at[1] - at[0]:.2f} s; the map's [tables.{name}] offset = {at[0] - at[1]:.2f},"
            " and a new import, align them to 0.3 s; log check then tells the lag that is left"
        )
    return out


def offset_by_onset(ta: np.ndarray, a: np.ndarray, tb: np.ndarray, b: np.ndarray) -> tuple[float, float] | None:
    """Times [s] of the first motion of two channels, t (T,) [s] and values (T, N), if their clocks differ by it; else None."""
    if np.array_equal(ta, tb):
        return None
    one, two = onset_of(ta, a), onset_of(tb, b)
    if one is None or two is None:
        return None
    excess = two.at - one.at
    beat = _beat(one)
    if abs(excess) <= max(LEAST, BEATS * beat):
        return None
    moved = (two.grid >= two.at) & (two.grid < two.at + FIRST * beat)
    ours, none = (_unlike(one, two.grid[moved] - shift, two.rate[moved]) for shift in (excess, 0.0))
    together = abs(float(tb[0] - ta[0]) - excess) < TOGETHER
    clearer = ours < EQUAL * none + LEFT if together else ours < min(CLEARER * none, none - LEFT)
    return (one.at, two.at) if clearer and ours < 1 - ALIKE else None


def _beat(onset: Onset) -> float:
    """Period [s] of the strongest frequency from the onset on."""
    rate = onset.rate[onset.grid >= onset.at]
    power = np.sum(np.abs(np.fft.rfft(rate - rate.mean(axis=0), axis=0)) ** 2, axis=1)
    return len(rate) * GRID / max(int(np.argmax(power)), 1)


def _unlike(one: Onset, at: np.ndarray, rate: np.ndarray) -> float:
    """Share of the rates (G, N) that those of another channel at the times `at`, and a body's settling, leave unexplained."""
    sources = [np.interp(at - late, one.grid, k, 0.0, 0.0) for k in one.rate.T for late in (0.0, LATE)]
    freed = at - at[0]
    design = np.stack([*sources, np.ones(len(at)), freed, np.exp(-freed / FREED)], axis=1)
    left = rate - design @ np.linalg.lstsq(design, rate, rcond=1e-6)[0]
    return float(np.sum(left**2) / max(np.sum((rate - rate.mean(axis=0)) ** 2), 1e-300))
