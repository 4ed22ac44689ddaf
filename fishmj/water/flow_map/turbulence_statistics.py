"""Mean speed, turbulence intensity and integral length scale at one point, from a probe's record.

    u'        = u - U                                       along the mean stream; v', w' across it
    TI        = u_rms / max(U, 0.1 m/s),   u_rms^2 = mean of the components' variances, minus the probe's white noise
    T_int     = int_0^tau0 rho(tau) dtau,  rho the autocorrelation of u', tau0 its first zero (4 times the lag of 1 / e at most)
    L         = U T_int                                     frozen advection (Taylor 1938, doi 10.1098/rspa.1938.0032)
    noise     = R(0) - (R(1) + (R(1) - R(2)) / (2^(2/3) - 1)), not below 0: in the inertial range R falls as tau^(2/3)
                (Kolmogorov), and white noise contributes at lag 0 only

Intervals come from a delete-one-group jackknife (Efron & Tibshirani 1993, chapter 11), for TI and L of their logarithms. Its
groups last at least `APART` integral times and are assumed to be independent. A record has seconds / (2 T_int) independent
samples.
"""

from collections.abc import Sequence
from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.least_squares import jackknife_sd

APART = 5.0  # minimal length of a group, integral times
GROUPS = 20  # maximal number of groups of the jackknife
FEWEST = 5  # minimal number of groups for intervals of speed and TI
LONG = 200.0  # minimal record for a length scale, integral times; with fewer its interval is too narrow
FINE = 4.0  # minimal number of samples per integral time for a length scale
TAIL = 4.0  # the correlation is cut off at this many times the lag where it is 1 / e
SMOOTH = 0.5  # rho(1) below which white noise and turbulence cannot be separated
SLOWEST = 0.02  # m/s, minimal speed for frozen advection past the probe
FASTEST_TURN = 0.3  # u_rms / U above which frozen advection does not hold
FLOOR: float = constant("turbulence", "speed_floor")  # m/s
# two-sided 95 % quantiles of Student's t, by degrees of freedom from 4 on (any table)
STUDENT = (2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093)


class ValueInterval(NamedTuple):
    """A number with its 95 % interval; NaN if the record is too short for one."""

    value: float
    low: float
    high: float


class Turbulence(NamedTuple):
    """Turbulence of the water at one point.

    Attributes:
        speed: m/s. direction: rad, towards which the water moves, in the axes of the components. intensity: TI.
        length: m, None if the record is too short; `why` then has the reason, and the length of a sufficient record.
        noise: m/s, standard deviation of the probe's noise in each component; NaN if it cannot be estimated.
        seconds: length of all records. independent: their number of independent samples.
    """

    speed: ValueInterval
    direction: float
    intensity: ValueInterval
    length: ValueInterval | None
    why: str
    noise: float
    seconds: float
    independent: float


def turbulence_of(records: Sequence[np.ndarray], dt: float) -> Turbulence:
    """Turbulence from records of one point at one setting.

    Args:
        records: each (T, C) m/s, evenly sampled: along x and, if measured, y and z.
        dt: s.

    Raises ConfigError: the records are too short for any interval, or constant.
    """
    seconds = dt * sum(map(len, records))
    mean = np.concatenate(records).mean(0)
    direction = float(np.arctan2(mean[1], mean[0])) if len(mean) > 1 else 0.0 if mean[0] >= 0 else float(np.pi)
    turned = [_turned(record, direction) for record in records]
    everything = np.concatenate(turned)
    middle = everything.mean(0)
    if everything.std(0).max() == 0.0:
        raise ConfigError("flow-map: all samples are equal; check that the probe is in the water, and the name of the column")
    lags = min(map(len, turned)) // 2
    scale = integral_time(_correlation([_products(r - middle, lags) for r in turned]), dt)
    groups = [g for r in turned for g in _groups(r, APART * scale, dt, seconds)]
    if len(groups) < FEWEST:
        raise ConfigError(
            f"flow-map: {seconds:.0f} s with an integral time of about {scale:.2g} s give {len(groups)} independent groups of "
            f"samples, but an interval needs {FEWEST}: record {FEWEST * APART * scale * 1.2:.0f} s at least"
        )
    most = max(round(2 * APART * scale / dt), 8)
    parts = [_part(g, middle, most) for g in groups]
    whole = _figures(parts, dt)
    without = [_figures(parts[:k] + parts[k + 1 :], dt) for k in range(len(parts))]
    speed = jackknifed(whole.speed, [w.speed for w in without])
    intensity = jackknifed(whole.intensity, [w.intensity for w in without], positive=True)
    why = _no_length(whole, scale, dt, seconds)
    length = None if why else jackknifed(whole.length, [w.length for w in without], positive=True)
    return Turbulence(speed, direction, intensity, length, why, whole.noise, seconds, seconds / (2 * max(whole.time, dt)))


class Figures(NamedTuple):
    """Statistics of some groups, in m/s, 1, m, s, m/s, and the correlation at lag 1."""

    speed: float
    intensity: float
    length: float
    time: float
    noise: float
    next: float


class _Part(NamedTuple):
    """Sums of one group: samples (), sum (C,), sums of lagged products (K, C) and their counts (K,), about `middle` (C,)."""

    samples: int
    total: np.ndarray
    products: np.ndarray
    pairs: np.ndarray
    middle: np.ndarray


def integral_time(rho: np.ndarray, dt: float) -> float:
    """Integral [s] of a correlation (K,) from lag 0 to its first zero, or to `TAIL` times the lag at which it is 1 / e.

    The tail of a short record is noise: without the second bound, some records give many times the true scale.
    """
    below = np.flatnonzero(rho <= 0.0)
    if len(below) and below[0] == 0:
        return 0.0
    folded = np.flatnonzero(rho <= exp(-1.0))
    end = int(below[0]) if len(below) else len(rho)
    bound = min(end, round(TAIL * folded[0]) + 1) if len(folded) else end
    time = float(rho[:bound].sum()) - 0.5 * float(rho[0] + rho[bound - 1])
    if bound == end < len(rho):
        last = float(rho[end - 1])
        time += 0.5 * last * last / (last - float(rho[end]))  # triangle to the interpolated zero between two lags
    return dt * time


def noise_variance(covariance: np.ndarray) -> float:
    """Variance of the white noise from covariances (K,) at lags 0, 1, 2, ..; NaN if neighbouring samples hardly correlate."""
    r0, r1, r2 = covariance[:3]
    if r1 < SMOOTH * r0:
        return float("nan")
    return float(max(r0 - (r1 + (r1 - r2) / (2 ** (2 / 3) - 1)), 0.0))


def _turned(record: np.ndarray, direction: float) -> np.ndarray:
    """Components (T, C) along and across the mean stream."""
    if record.shape[1] == 1:
        return record * np.cos(direction)
    c, s = np.cos(direction), np.sin(direction)
    along, across = c * record[:, 0] + s * record[:, 1], c * record[:, 1] - s * record[:, 0]
    return np.column_stack([along, across, *record.T[2:]])


def _products(x: np.ndarray, lags: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums of x_t x_(t+k) (K, C) of k < lags by the fast Fourier transform, and their counts (K,)."""
    n, lags = len(x), min(lags, len(x))
    size = 1 << int(np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(x, size, axis=0)
    return np.fft.irfft(np.abs(spectrum) ** 2, size, axis=0)[:lags], n - np.arange(lags)


def _correlation(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Correlation (K,) of the first component, from sums and counts."""
    lags = min(len(counts) for _, counts in parts)
    covariance = np.sum([p[:lags, 0] for p, _ in parts], 0) / np.sum([c[:lags] for _, c in parts], 0)
    noise = noise_variance(covariance)
    return _without(covariance, noise) / (covariance[0] - np.nan_to_num(noise))


def _without(covariance: np.ndarray, noise: float) -> np.ndarray:
    """Covariance without the noise at lag 0."""
    clean = covariance.copy()
    clean[0] -= np.nan_to_num(noise)
    return clean


def _groups(record: np.ndarray, least: float, dt: float, seconds: float) -> list[np.ndarray]:
    """Splits a record into groups of at least `least` s; at most `GROUPS` for all records together."""
    samples = max(int(np.ceil(max(least, seconds / GROUPS * (1 - 1e-9)) / dt)), 1)
    count = max(len(record) // samples, 1)
    return list(np.array_split(record, count)) if len(record) >= samples else []


def _part(group: np.ndarray, middle: np.ndarray, most: int) -> _Part:
    products, pairs = _products(group - middle, most)
    return _Part(len(group), (group - middle).sum(0), products, pairs, middle)


def _figures(parts: Sequence[_Part], dt: float) -> Figures:
    """Pooled statistics of groups."""
    lags = min(len(p.pairs) for p in parts)
    count = sum(p.samples for p in parts)
    off = np.sum([p.total for p in parts], 0) / count  # mean about `middle`
    pairs = np.sum([p.pairs[:lags] for p in parts], 0)
    covariance = np.sum([p.products[:lags] for p in parts], 0) / pairs[:, None] - off**2
    speed = float(parts[0].middle[0] + off[0])
    noises = np.array([noise_variance(c) for c in covariance.T])
    variance = covariance[0] - np.nan_to_num(noises)
    rho = _without(covariance[:, 0], noises[0]) / variance[0]
    # the sample mean makes every covariance too small by the variance of that mean, 2 T_int / T
    time = integral_time(rho, dt)
    lost = min(2 * time / (count * dt), 0.5)
    time = integral_time(rho + (1 - rho) * lost, dt)
    rms = sqrt(max(float(variance.mean()), 0.0) / (1 - lost))
    noise = float(np.sqrt(noises.mean()))
    return Figures(speed, rms / max(speed, FLOOR), speed * time, time, noise, float(covariance[1, 0] / covariance[0, 0]))


def jackknifed(whole: float, without: Sequence[float], positive: bool = False) -> ValueInterval:
    """Value with its jackknife interval; without: the values with one group left out."""
    n = len(without)
    t = STUDENT[min(n, len(STUDENT) + 4) - 5]
    if positive:
        if whole <= 0.0 or min(without) <= 0.0:
            return ValueInterval(whole, float("nan"), float("nan"))
        values, middle = np.log(without), log(whole)
    else:
        values, middle = np.asarray(without, float), whole
    error = t * float(jackknife_sd(values))
    if positive:
        return ValueInterval(whole, exp(middle - error), exp(middle + error))
    return ValueInterval(whole, middle - error, middle + error)


def _no_length(found: Figures, scale: float, dt: float, seconds: float) -> str:
    """Reason for the missing length scale of a record, and the length of a sufficient record; "" if there is a length scale."""
    time = max(found.time, scale)
    if found.speed < SLOWEST:
        return f"the water hardly moves ({found.speed:.3f} m/s): eddies are not advected past the probe"
    if found.intensity * max(found.speed, FLOOR) > FASTEST_TURN * found.speed:
        ratio = found.intensity * max(found.speed, FLOOR) / found.speed
        return f"u_rms is {ratio:.2f} of the speed: frozen advection does not hold"
    if time < FINE * dt:
        return f"{1 / dt:.3g} Hz is too slow for an integral time of {time:.2g} s; sample at {FINE / time:.0f} Hz or more"
    if seconds < LONG * time:
        return f"{seconds:.0f} s are too short for a length scale: record {1.2 * LONG * time:.0f} s at least"
    return ""
