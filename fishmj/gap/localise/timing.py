"""How late is every channel, is the residual locked to the tail beat, and does it grow with the speed of the command?

Lags, behind the model and behind the command, are cross-correlations of rates with their bootstrap intervals (log/delay.py), over
all records in which the channel moves, set one after the other with pauses between. Where the command beats,

    r(t) = p0 + p1 t + g c(t) + h H[c](t)     in windows of two beats at least;  H quarter of a beat later (Hilbert transform)

locked = share of the residual's variance about its straight line that g and h take, corrected for their number. g < 0: too small
a motion, h: too late a motion.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from fishmj.errors import LogError
from fishmj.gap.localise.comparison import Comparison, beat_of
from fishmj.log.delay import Lag, lag_between

PAUSE = 3.0  # s between records
SAME = 0.006  # s, lags closer than this are not told apart: what a servo within its tolerance makes
REACH = 0.25  # s
MOVES = {"joint": 0.03, "heading": 0.05}  # rad, standard deviation from which a record has something to compare


class Lags(NamedTuple):
    """None where it cannot be told. Positive: measured comes later.

    joint, heading: measured behind the model; *_after: with the effects found. command: joint behind the command; model: the
    model's joint behind it. residual: what is left of the joints, behind the command.
    """

    joint: Lag | None
    heading: Lag | None
    joint_after: Lag | None
    heading_after: Lag | None
    command: Lag | None
    model: Lag | None
    residual: Lag | None


def lags(c: Comparison) -> Lags:
    """All of them."""
    measured, before, after = (chain(c, "joint", which) for which in ("measured", 0, 1))
    command = chain(c, "joint", "command")
    yaw, yaw_before, yaw_after = (chain(c, "heading", which) for which in ("measured", 0, 1))
    rest = None if measured is None or before is None else (measured[0], measured[1] - before[1])
    return Lags(
        joint=between("model", before, "joints", measured),
        heading=between("model", yaw_before, "heading", yaw),
        joint_after=between("model", after, "joints", measured),
        heading_after=between("model", yaw_after, "heading", yaw),
        command=between("command", command, "joints", measured),
        model=between("command", command, "model", before),
        residual=between("command", command, "joint residual", rest, either_sign=True),
    )


def between(a: str, earlier, b: str, later, either_sign: bool = False) -> Lag | None:
    """The lag, or None when it is not found: too short, too weak, too wide an interval, or another peak as high."""
    if earlier is None or later is None:
        return None
    try:
        lag = lag_between((a, *earlier), (b, *later), reach=REACH, either_sign=either_sign)
    except LogError:
        return None
    return lag if lag.found and not lag.ambiguous else None


def chain(c: Comparison, channel: str, which) -> tuple[np.ndarray, np.ndarray] | None:
    """Stamps and values of a channel of all records that move, end to end. which: measured, command, or a row's number."""
    times, values, at = [], [], 0.0
    sensor, columns = ("joint", slice(None)) if channel == "joint" else ("pose", slice(2, 3))
    for record, predicted in zip(c.records, c.predictions, strict=True):
        given = getattr(record, sensor)
        if given is None or given.values[:, columns].std(0).max() < MOVES[channel]:
            continue
        if which == "command":
            stride = max(round(0.02 / record.dt), 1)
            shown = record.commands[::stride]
            times.append(at + np.arange(len(shown)) * stride * record.dt)
        else:
            shown = given.values if which == "measured" else predicted[sensor][which]
            times.append(at + given.t)
        values.append(shown[:, columns] - shown[:1, columns])
        at += given.t[-1] + PAUSE
    return (np.concatenate(times), np.concatenate(values)) if times else None


def significant(lag: Lag | None) -> bool:
    """Whether a lag is there: its interval leaves zero by more than can be told apart."""
    return lag is not None and (lag.low > SAME or lag.high < -SAME)


def compatible(a: Lag | None, b: Lag | None) -> bool:
    """Whether two lags may be one."""
    return a is not None and b is not None and a.low - SAME <= b.high and b.low - SAME <= a.high


LEAST = 0.05  # rad, standard deviation of a command that beats
BINS = 5
RECENT = 0.25  # s, in which a command has become a motion


class Beat(NamedTuple):
    """locked: share of the variance. behind: rad of the beat by which the locked part follows the command. windows: fitted."""

    locked: float
    behind: float
    windows: int


class BeatRates(NamedTuple):
    """Mean square of the joint residual, × floor, by speed of the command: middle (BINS,) rad/s, level (BINS,)."""

    middle: np.ndarray
    level: np.ndarray

    @property
    def ratio(self) -> float:
        """Fastest fifth over slowest."""
        return float(self.level[-1] / max(self.level[0], 1e-9))


def beat(c: Comparison, channel: str) -> Beat | None:
    """Of the joints or the heading; None where nothing beats for long enough."""
    total = taken = spare = 0.0
    turned = 0.0 + 0.0j
    windows = 0
    for b in c.layout.blocks:
        record = c.records[b.record]
        if b.channel != channel:
            continue
        wave = analytic(record.commands[:, b.column if channel == "joint" else 0])
        period = beat_of(record)
        length = max(2.0, 2.0 * period)
        clock = np.arange(len(wave)) * record.dt
        at = np.interp(b.t, clock, wave.real) + 1j * np.interp(b.t, clock, wave.imag)
        for start in np.arange(0.0, b.t[-1] - length + 1e-6, length):
            some = (b.t >= start) & (b.t < start + length)
            if some.sum() < 8 or at[some].real.std() < LEAST or np.sum(np.diff(np.sign(at[some].real)) != 0) < 2:
                continue
            r = (c.residuals[0] / c.scale)[b.where][some]
            line = np.stack([np.ones(some.sum()), b.t[some]], 1)
            rest = r - line @ np.linalg.lstsq(line, r, rcond=None)[0]
            columns = np.concatenate([line, np.stack([at[some].real, at[some].imag], 1)], 1)
            value = np.linalg.lstsq(columns, r, rcond=None)[0]
            left = r - columns @ value
            total += float(rest @ rest)
            taken += float(rest @ rest - left @ left)
            spare += 2.0 * float(left @ left) / (some.sum() - 4)  # what two columns take by chance
            turned += (value[2] - 1j * value[3]) * np.mean(np.abs(at[some]) ** 2)
            windows += 1
    if not windows or total <= 0:
        return None
    return Beat(float(np.clip((taken - spare) / total, 0.0, 1.0)), float(-np.angle(turned)), windows)


def analytic(values: np.ndarray) -> np.ndarray:
    """(T,) c + i H[c], its mean removed; the ends are tapered by mirroring."""
    values = values - values.mean()
    n = len(values)
    spectrum = np.fft.fft(np.concatenate([values, -values[::-1]]))
    spectrum[1:n] *= 2.0
    spectrum[n + 1 :] = 0.0
    return np.fft.ifft(spectrum)[:n]


def by_rate(c: Comparison) -> BeatRates | None:
    """Joint residual by the fastest command of the last RECENT seconds; None without joints or when nothing is commanded."""
    speed, level = [], []
    for b in c.layout.blocks:
        if b.channel != "joint":
            continue
        record = c.records[b.record]
        rate = np.abs(np.gradient(record.commands[:, b.column], record.dt))
        rate = maximum_filter1d(rate, width := max(round(RECENT / record.dt), 1), origin=(width - 1) // 2)
        speed.append(np.interp(b.t, np.arange(len(rate)) * record.dt, rate))
        level.append(c.ratio[0][b.where])
    if not speed:
        return None
    rate = np.concatenate(speed)
    ratio = np.concatenate(level)
    moving = rate > 1e-3
    if moving.sum() < 4 * BINS:
        return None
    edges = np.quantile(rate[moving], np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, rate[moving], side="right") - 1, 0, BINS - 1)
    bins = [place == k for k in range(BINS)]
    middle = np.array([np.median(rate[moving][b]) for b in bins])
    return BeatRates(middle, np.array([np.mean(ratio[moving][b]) for b in bins]))
