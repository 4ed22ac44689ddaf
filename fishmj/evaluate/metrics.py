"""Results of an evaluation: time series of every trial, metrics of each trial by key, and their statistics.

    arrival             1 if the fish comes within 0.1 m in 30 s; none if a shorter trial ends before that, inside the domain
    approach_time       s, of the first entry
    rmse_after_arrival  m, sqrt(mean d^2) from first entry to 30 s; without arrival 10 to 30 s
    rmse_last20, rmse_total     m, over 40 to 60 s and 0 to 30 s
    power               W, electrical, idle included
    energy_per_metre    J/m of path through the water, if longer than the fish;  cost_of_transport = that / (m g)
    rheotactic_index    mean of cos(psi - upstream) over 30 to 60 s; rheotactic_index_linear = 1 - mean |psi - upstream| / 90 deg;
                        in still water, which has no upstream, a trial has neither

The course angle_of_attack, with rmse_total and power as above:

    settled             1 if the fish is within 0.1 m for the last 5 s
    settling_time       s, after which it stays within 0.1 m until the end
    furthest            m, largest distance

The course figure_eight, with power and the energies as above:

    cross_track         m, RMS distance to the nearest point of the path within a quarter of the figure around the target
    on_path             share of the time within 0.1 m of the path
    tracking_rmse       m, RMS distance to the moving target

A metric is NaN if a trial has none. psi and the speed through the water are averaged over 1 s, so that the beat counts neither as
turning nor as path. A trial that leaves the domain keeps its distance from then on; power, path and heading count until it
leaves. If the flow solver fails in a trial, its later distance is NaN, and so is every metric over that time. Means have
bootstrap intervals, by condition, and in paired comparisons:

    interval      percentile bootstrap over trials, 95 %, fixed seed (Efron & Tibshirani 1993)
    difference    mean of b_i - a_i over the trials that both have, its bootstrap interval, and Welch's t-test of a against b
    too few       fewer than `ENOUGH` trials have neither interval nor test (NaN), because a bootstrap interval of so few is far
                  too narrow (one trial: width zero)
    told apart    the interval excludes 0, for `APART` pairs or more: with fewer pairs, all differences of two equal controllers
                  have the same sign with probability 2^(1 - n) > 5 %, so that no 95 % interval can decide

Approach and settling time are medians over the trials that have one; every other key is a mean over the trials that have it.
"""

from typing import NamedTuple

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError
from fishmj.base.units import G, wrap
from fishmj.evaluate.protocol import ANGLE, EIGHT, HOLD, Trials
from fishmj.mjcf.description import Robot
from fishmj.tasks.reference import eight, path_length
from fishmj.water.choice import HYBRID, LBM, label

BEAT = 1.0  # s, averaging window
RESAMPLES, SEED, LEVEL = 10_000, 20210, 0.95
ENOUGH, APART = 5, 6  # trials
MEDIANS = ("approach_time", "settling_time")
NEAR, POINTS = 0.25, 201  # part of a figure eight, to each side of the target, and its points, among which the nearest is sought
UNITS = {
    "arrival": "1",
    "approach_time": "s",
    "rmse_after_arrival": "m",
    "rmse_last20": "m",
    "rmse_total": "m",
    "power": "W",
    "energy_per_metre": "J/m",
    "cost_of_transport": "1",
    "rheotactic_index": "1",
    "rheotactic_index_linear": "1",
}
COURSE_UNITS = {"settled": "1", "settling_time": "s", "furthest": "m", "cross_track": "m", "on_path": "1", "tracking_rmse": "m"}
NEEDS = {"arrival": "arrival_time", "approach_time": "arrival_time", "rmse_after_arrival": "arrival_time"}
NEEDS |= {"rmse_last20": "steady_window", "rmse_total": "arrival_time"}
NEEDS |= dict.fromkeys(("rheotactic_index", "rheotactic_index_linear"), "rheotaxis_window")  # its end is the shortest trial
LEADING = {
    HOLD: "rmse_after_arrival",
    ANGLE: "rmse_total",
    EIGHT: "cross_track",
}  # task -> distance that ranks controllers, trials


class Result(NamedTuple):
    """Records of n trials; T bus ticks of 20 ms, row 0 is the start; K control steps."""

    controller: str
    policy_sha256: str  # of a policy's file, else ""
    robot: Robot
    trials: Trials
    engine: str
    t: np.ndarray  # (T + 1,) s
    target: np.ndarray  # (n, 2) m
    pose: np.ndarray  # (n, T + 1, 3) m, m, rad; tank frame, yaw not wrapped
    velocity: np.ndarray  # (n, T + 1, 3) true rates
    joint: np.ndarray  # (n, T + 1, J) rad
    rate: np.ndarray  # (n, T + 1, J) rad/s
    power: np.ndarray  # (n, T) W, servos and idle, mean over a tick
    command: np.ndarray  # (n, T, J) rad, on the bus
    obs: np.ndarray  # (n, K, 5 + 2 J)
    action: np.ndarray | None  # (n, K, J) of policies
    distance: np.ndarray  # (n, T + 1) m, frozen where a trial left the domain
    left: np.ndarray  # (n,) tick at which the trial left, T + 1 if it did not
    policy: dict | None = None  # of a policy: how it was trained, and what is different here (`LearnedController.trained`)
    left_out: tuple[str, ...] = ()  # effects of the description that were left out
    corrections: np.ndarray | None = None  # (n,) JSON of `fishmj.engines.hybrid.Hybrid.report`, of the water hybrid
    known: dict[str, np.ndarray] | None = None  # metrics (n,) read back from a trials.csv, without time series

    @property
    def water(self) -> str:
        """`lbm` for the flow solver, else as `fishmj.water.choice.label`."""
        solved = {"tanks": LBM, "lbm": LBM, "hybrid": HYBRID}
        return solved.get(self.engine.partition(",")[0]) or label(self.robot)


def arrival_tick(result: Result) -> np.ndarray:
    """Tick (n,) of the first entry into the arrival radius within the arrival time; -1 without an entry."""
    limit = round(constant("protocol", "arrival_time") / result.robot.timing.bus_dt)
    inside = (result.distance <= constant("protocol", "arrival_radius"))[:, : limit + 1]
    inside &= np.arange(inside.shape[1]) < result.left[:, None]
    return np.where(inside.any(1), inside.argmax(1), -1)


def failed(r: Result) -> np.ndarray:
    """True (n,) where the water or the motion of a trial failed in the flow solver, at `t[left]`."""
    return np.isnan(r.distance[:, -1]) if r.known is None and r.water == LBM else np.zeros(len(r.trials), bool)


def figures(r: Result) -> dict[str, np.ndarray]:
    """Figures (n,), one for each trial, by key."""
    if r.known is not None:
        return r.known
    return {HOLD: hold_figures, ANGLE: settling_figures, EIGHT: path_figures}[r.trials.task](r)


def hold_figures(r: Result) -> dict[str, np.ndarray]:
    """Figures (n,) of station holding."""
    window = lambda key: constant("protocol", key)
    end = window("arrival_time")
    first = arrival_tick(r)
    arrived = first >= 0
    since = np.where(arrived, r.t[first], window("missed_window")[0])
    cosine, linear = (np.where(r.trials.speed > 0, index, np.nan) for index in rheotaxis(r))
    return {
        "arrival": np.where(~arrived & (r.t[-1] < end - 1e-9) & (r.left >= len(r.t)), np.nan, arrived),
        "approach_time": np.where(arrived, r.t[first], np.nan),
        "rmse_after_arrival": rms(r, since, end),
        "rmse_last20": rms(r, *window("steady_window")),
        "rmse_total": rms(r, 0.0, end),
        **energies(r),
        "rheotactic_index": cosine,
        "rheotactic_index_linear": linear,
    }


def energies(r: Result) -> dict[str, np.ndarray]:
    """Power and energies (n,) until a trial ends or leaves."""
    energy = _until_left(r, r.power).sum(1) * r.robot.timing.bus_dt
    way = _path_length(r)  # zero for a drifting fish; paths shorter than the fish are not used
    per_metre = energy / np.where(way > r.robot.length, way, np.nan)
    return {
        "power": energy / (np.maximum(np.minimum(r.left, r.power.shape[1]), 1) * r.robot.timing.bus_dt),
        "energy_per_metre": per_metre,
        "cost_of_transport": per_metre / (r.robot.mass * G),
    }


def settling_figures(r: Result) -> dict[str, np.ndarray]:
    """Figures (n,) of angle_of_attack."""
    outside = ~(r.distance <= constant("protocol", "arrival_radius")) | (np.arange(len(r.t)) >= r.left[:, None])
    last = len(r.t) - 1 - outside[:, ::-1].argmax(1)  # the last tick outside
    since = np.where(outside.any(1), r.t[np.minimum(last + 1, len(r.t) - 1)], 0.0)
    settled = since <= r.t[-1] - constant("experiments", "aoa_converge")
    return {
        "settled": settled.astype(float),
        "settling_time": np.where(settled, since, np.nan),
        "furthest": r.distance.max(1),
        "rmse_total": rms(r, 0.0, float(r.t[-1])),
        "power": energies(r)["power"],
    }


def path_figures(r: Result) -> dict[str, np.ndarray]:
    """Figures (n,) of figure_eight."""
    off = cross_track(r)
    mean = lambda x: np.sqrt(np.mean(x**2, 1))
    on = np.mean(off <= constant("protocol", "arrival_radius"), 1)
    return {"cross_track": mean(off), "on_path": on, "tracking_rmse": mean(r.distance), **energies(r)}


def cross_track(r: Result) -> np.ndarray:
    """Distance (n, T + 1) m to the figure eight, near the moving target; it stays as it is where a trial leaves the domain."""
    speed, off = constant("experiments", "figure8_speed"), np.empty(r.pose.shape[:2])
    along = np.linspace(-NEAR, NEAR, POINTS) * path_length()
    for k, t in enumerate(r.t):
        points, _ = eight(np, speed * t + along)
        chord, from_a = np.diff(points, axis=0), r.pose[:, k, None, :2] - points[:-1]
        share = np.clip(np.sum(from_a * chord, -1) / np.sum(chord**2, -1), 0.0, 1.0)
        off[:, k] = np.linalg.norm(from_a - share[..., None] * chord, axis=-1).min(1)
    return frozen(off, r.left)


def frozen(values: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Values (n, T) that stay as they are from the tick `left` (n,) on, at which a trial leaves the domain."""
    tick = np.minimum(np.arange(values.shape[1]), left[:, None])
    return np.take_along_axis(values, np.minimum(tick, values.shape[1] - 1), 1)


def rms(r: Result, start, end: float) -> np.ndarray:
    """Root mean square distance from `start` ((n,) or one number) to `end` [s]; NaN if the run is shorter."""
    start = np.broadcast_to(start, (len(r.trials),))[:, None]
    inside = (r.t >= start - 1e-9) & (r.t <= end + 1e-9)
    mean = np.sum(np.where(inside, r.distance, 0.0) ** 2, 1) / np.maximum(
        inside.sum(1), 1
    )  # NaN outside the window does not count
    return np.where((r.t[-1] >= end - 1e-9) & inside.any(1), np.sqrt(mean), np.nan)


def rheotaxis(r: Result, window: tuple[float, float] | None = None, bounded: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Rheotactic indices (RI_cos, RI_lin), each (n,).

    window: s, default the hold phase. bounded: headings count until a trial leaves the domain. In still water, headings are
    relative to the direction `trials.upstream`: random headings give 0 on average, as in the paper's figure.
    """
    start, end = constant("protocol", "rheotaxis_window") if window is None else window
    heading = beat_mean(r.pose[:, :, 2], r.robot.timing.bus_dt)
    off = wrap(np, heading - r.trials.upstream)
    inside = (r.t >= start) & (r.t <= end + 1e-9) & ((np.arange(len(r.t)) < r.left[:, None]) | (not bounded))
    count = np.where((r.t[-1] >= end - 1e-9) & inside.any(1), inside.sum(1), np.nan)
    mean = lambda x: np.sum(x * inside, 1) / count
    return mean(np.cos(off)), 1 - mean(np.abs(off)) / (np.pi / 2)


def beat_mean(x, dt: float):
    """Centred moving average over one beat along axis 1 of (n, T); shorter at the ends."""
    half = round(BEAT / dt / 2)
    total = np.concatenate([np.zeros((len(x), 1)), np.cumsum(x, 1)], 1)
    i = np.arange(x.shape[1])
    low, high = np.maximum(i - half, 0), np.minimum(i + half + 1, x.shape[1])
    return (total[:, high] - total[:, low]) / (high - low)


def _path_length(r: Result) -> np.ndarray:
    """Path length through the undisturbed stream until the trial ends or leaves, (n,) m."""
    mean = np.array([f.mean[:2] for f in r.trials.flows()])
    relative = r.velocity[:, 1:, :2] - mean[:, None]
    dt = r.robot.timing.bus_dt
    speed = np.hypot(beat_mean(relative[..., 0], dt), beat_mean(relative[..., 1], dt))
    return _until_left(r, speed).sum(1) * dt


def _until_left(r: Result, x) -> np.ndarray:
    """Values x (n, T) with zeros after the trial has left the domain."""
    return x * (np.arange(x.shape[1]) < r.left[:, None])


class IntervalEstimate(NamedTuple):
    """A figure with its interval over n trials; `why`: reason for a missing interval, with low and high NaN."""

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
        """Returns True if the two differ: the interval excludes 0, with `APART` pairs or more."""
        return self.n >= APART and (self.low > 0 or self.high < 0)

    def interval(self, digits: int = 3) -> str:
        """Text of the interval, with a star where the two differ, or the reason for its absence."""
        return self.why or f"({self.low:+.{digits}f} {self.high:+.{digits}f}){' *' if self.apart else ''}"

    def text(self, digits: int = 3) -> str:
        """Text of the mean difference and its interval, or the reason for their absence."""
        return self.why or f"{self.value:+.{digits}f} {self.interval(digits)}"


def too_few(n: int) -> str:
    """Reason that n trials have no interval; "" if they have one."""
    return f"too few trials for an interval: {n} of {ENOUGH}" if n < ENOUGH else ""


def too_short(trials: Trials) -> dict[str, str]:
    """Reason for each key whose window lies beyond the end of these trials."""
    ends = {key: np.max(constant("protocol", name)) for key, name in NEEDS.items() if trials.task == HOLD}
    short = f"trials of {trials.duration:g} s are too short; expected"
    return {key: f"{short} {end:g} s" for key, end in ends.items() if trials.duration < end - 1e-9}


def estimate(key: str, values, short: str = "") -> IntervalEstimate:
    """Mean or median of (n,) figures without NaN, with a bootstrap interval over trials; short: reason if too few have one."""
    x = np.asarray(values, float)
    x = x[np.isfinite(x)]
    middle = np.median if key in MEDIANS else np.mean
    value = float(middle(x)) if len(x) else np.nan
    if why := too_few(len(x)):
        return IntervalEstimate(value, np.nan, np.nan, len(x), short or why)
    return IntervalEstimate(value, *_interval(middle(resampled(x), -1)), len(x))


def difference(key: str, a, b, *, short: str = "") -> PairedDifference:
    """Paired difference b - a of (n,) figures of the same trials; pairs with a NaN are left out. short: as in `estimate`."""
    from scipy.stats import ttest_ind_from_stats

    a, b = np.asarray(a, float), np.asarray(b, float)
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    value = float(np.mean(b - a)) if len(a) else np.nan
    if why := too_few(len(a)):
        return PairedDifference(key, value, np.nan, np.nan, len(a), np.nan, np.nan, short or why)
    low, high = _interval(resampled(b - a).mean(-1))
    t = p = np.nan
    if np.ptp(a) > 0 or np.ptp(b) > 0:
        one, two = ((x.mean(), x.std(ddof=1), len(x)) for x in (b, a))
        t, p = ttest_ind_from_stats(*one, *two, equal_var=False)
    return PairedDifference(key, value, low, high, len(a), float(t), float(p))


def paired_p(a, b) -> float:
    """Two-sided p value of the paired bootstrap that a and b (n,) have one mean; NaN for fewer than `APART` pairs.

    It is below 1 - `LEVEL` where the interval of `difference` excludes 0, up to one draw. Its least value is 2 / (RESAMPLES + 1).
    """
    off = np.asarray(b, float) - np.asarray(a, float)
    off = off[np.isfinite(off)]
    if len(off) < APART:
        return float("nan")
    means = resampled(off).mean(-1)
    return min(1.0, 2 * (1 + min(np.sum(means <= 0), np.sum(means >= 0))) / (RESAMPLES + 1))


def holm(p) -> np.ndarray:
    """P values (m,) adjusted for m tests by Holm's step-down method; NaN where a test has none, which counts as no test."""
    p = np.asarray(p, float)
    there = np.flatnonzero(np.isfinite(p))
    order = there[np.argsort(p[there])]
    adjusted = np.full(len(p), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return adjusted


def mean_of_known(x: np.ndarray) -> float:
    """Mean of figures (n,) without NaN; NaN if there is none."""
    return float(np.mean(x[np.isfinite(x)])) if np.isfinite(x).any() else float("nan")


def resampled(x) -> np.ndarray:
    """(RESAMPLES, n) draws with replacement, the same for every key and controller of n trials."""
    return x[np.random.default_rng(SEED).integers(len(x), size=(RESAMPLES, len(x)))]


def _interval(draws) -> tuple[float, float]:
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(draws, [tail, 1 - tail])
    return float(low), float(high)


def summary(result: Result) -> dict:
    """Summary of every key over all trials, by speed and by direction; plain numbers, ready for JSON.

    Returns:
        {"controller", "policy", "n", "overall": {key: {value, low, high, n, why, unit}}, "by_speed": {"0.1": ..},
        "by_los": {"45": ..}, "left_domain", "failed"}; policy as in `Result`; "task" if it is not station holding. The last two
        are the numbers of trials that left, and in which the flow solver failed.
    """
    found = figures(result)
    trials = result.trials
    degrees = np.round(np.degrees(trials.los)).astype(int)
    short = too_short(trials)
    return {
        "controller": result.controller,
        "policy": result.policy,
        **({} if trials.task == HOLD else {"task": trials.task}),
        "n": len(trials),
        "overall": gather(found, short=short),
        "by_speed": {f"{u:g}": gather(found, trials.speed == u, short) for u in np.unique(trials.speed)},
        "by_los": {f"{b}": gather(found, degrees == b, short) for b in np.unique(degrees)},
        "left_domain": int(np.sum((result.left < len(result.t)) & ~failed(result))),
        "failed": int(np.sum(failed(result))),
    }


def gather(found: dict, rows=slice(None), short: dict | None = None) -> dict:
    """Estimates {key: {value, low, high, n, why, unit}} of some trials; short: of `too_short`."""
    one = lambda key, x: estimate(key, x[rows], (short or {}).get(key, ""))._asdict()
    return {key: {**one(key, x), "unit": (UNITS | COURSE_UNITS)[key]} for key, x in found.items()}


def compare(first: Result, second: Result) -> list[PairedDifference]:
    """Differences second minus first for every key, over the same trials. Raises ConfigError if the trials are not the same."""
    if [t.seed for t in first.trials.items] != [t.seed for t in second.trials.items]:
        raise ConfigError(f"compare: {first.controller} and {second.controller} were judged on different trials")
    a, b, short = figures(first), figures(second), too_short(first.trials)
    return [difference(key, a[key], b[key], short=short.get(key, "")) for key in a]
