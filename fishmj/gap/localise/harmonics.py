"""Is the residual locked to the tail beat, and does it grow with the speed of the command?

    r(t) = p0 + p1 t + g c(t) + h H[c](t)     in windows of two beats at least;  H quarter of a beat later (Hilbert transform)

locked = share of the residual's variance about its straight line that g and h take, corrected for their number. g < 0: too small
a motion, h: too late a motion. Only where the command beats.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from fishmj.gap.localise.comparison import Comparison
from fishmj.gap.localise.error_by_regime import beat_of

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
