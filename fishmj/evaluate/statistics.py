"""From one figure a trial to a statement: means with bootstrap intervals, by condition, and paired comparisons.

    interval      percentile bootstrap over trials, 95 %, fixed seed (Efron & Tibshirani 1993)
    difference    mean of b_i - a_i over the trials that both have, its bootstrap interval, and Welch's t-test of a against b
    too few       of fewer than `ENOUGH` trials there is neither interval nor test (NaN): a bootstrap of so few draws the same
                  values again and again, and its interval is far too narrow (one trial: none wide at all)
    told apart    the interval excludes 0, of `APART` pairs or more: of fewer even two equal controllers give all differences
                  the same sign in 2^(1 - n) > 5 % of the draws, so that no 95 % interval can tell

Approach time is a median over the trials that arrive; every other key is a mean over the trials that have it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.errors import ConfigError
from fishmj.evaluate.metrics import UNITS, Result, figures

RESAMPLES, SEED, LEVEL = 10_000, 20210, 0.95
ENOUGH, APART = 5, 6  # trials
MEDIANS = ("approach_time",)


class IntervalEstimate(NamedTuple):
    """A figure with its interval over n trials; `why` there is none, where low and high are NaN."""

    value: float
    low: float
    high: float
    n: int
    why: str = ""


class PairedDifference(NamedTuple):
    """b minus a, trial by trial, and Welch's test of the two samples."""

    key: str
    value: float
    low: float
    high: float
    n: int
    welch_t: float
    welch_p: float
    why: str = ""

    @property
    def apart(self) -> bool:
        """Whether the difference is one: its interval excludes 0, of `APART` pairs or more."""
        return self.n >= APART and (self.low > 0 or self.high < 0)


def statistic(key: str) -> Callable:
    """How a key is gathered over trials: a function of (array, axis)."""
    return np.median if key in MEDIANS else np.mean


def too_few(n: int) -> str:
    """Why n trials have no interval; "" where they have one."""
    return f"too few trials for an interval: {n} of {ENOUGH}" if n < ENOUGH else ""


def estimate(key: str, values) -> IntervalEstimate:
    """Gather (n,) figures, NaN left out, with a bootstrap interval over trials."""
    x = np.asarray(values, float)
    x = x[np.isfinite(x)]
    gather = statistic(key)
    value = float(gather(x)) if len(x) else np.nan
    if why := too_few(len(x)):
        return IntervalEstimate(value, np.nan, np.nan, len(x), why)
    return IntervalEstimate(value, *_interval(gather(_resampled(x), -1)), len(x))


def difference(key: str, a, b) -> PairedDifference:
    """Paired difference b - a of (n,) figures of the same trials; pairs with a NaN are left out."""
    from scipy.stats import ttest_ind_from_stats

    a, b = np.asarray(a, float), np.asarray(b, float)
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    value = float(np.mean(b - a)) if len(a) else np.nan
    if why := too_few(len(a)):
        return PairedDifference(key, value, np.nan, np.nan, len(a), np.nan, np.nan, why)
    low, high = _interval(_resampled(b - a).mean(-1))
    t = p = np.nan
    if np.ptp(a) > 0 or np.ptp(b) > 0:
        one, two = ((x.mean(), x.std(ddof=1), len(x)) for x in (b, a))
        t, p = ttest_ind_from_stats(*one, *two, equal_var=False)
    return PairedDifference(key, value, low, high, len(a), float(t), float(p))


def _resampled(x) -> np.ndarray:
    """(RESAMPLES, n) draws with replacement, the same for every key and controller of n trials."""
    return x[np.random.default_rng(SEED).integers(len(x), size=(RESAMPLES, len(x)))]


def _interval(draws) -> tuple[float, float]:
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(draws, [tail, 1 - tail])
    return float(low), float(high)


def summary(result: Result) -> dict:
    """Every key over all trials, by speed and by direction; plain numbers, ready for JSON.

    Returns:
        {"controller", "n", "overall": {key: {value, low, high, n, why, unit}}, "by_speed": {"0.1": ..}, "by_los": {"45": ..}}
    """
    found = figures(result)
    trials = result.trials
    degrees = np.round(np.degrees(trials.los)).astype(int)
    return {
        "controller": result.controller,
        "n": len(trials),
        "overall": gather(found),
        "by_speed": {f"{u:g}": gather(found, trials.speed == u) for u in np.unique(trials.speed)},
        "by_los": {f"{b}": gather(found, degrees == b) for b in np.unique(degrees)},
        "left_domain": int(np.sum(result.left < len(result.t))),
    }


def gather(found: dict, rows=slice(None)) -> dict:
    """{key: {value, low, high, n, why, unit}} of some trials."""
    return {key: {**estimate(key, x[rows])._asdict(), "unit": UNITS[key]} for key, x in found.items()}


def compare(first: Result, second: Result) -> list[PairedDifference]:
    """second minus first for every key, over the same trials. Raises ConfigError: the two were not judged on the same trials."""
    if [t.seed for t in first.trials.items] != [t.seed for t in second.trials.items]:
        raise ConfigError(f"compare: {first.controller} and {second.controller} were judged on different trials")
    a, b = figures(first), figures(second)
    return [difference(key, a[key], b[key]) for key in UNITS]
