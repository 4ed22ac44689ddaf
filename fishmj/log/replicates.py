"""Scatter between runs of the same command. It is the floor below which no model error can be seen.

R replicates of one excitation, compared over aligned time t_i (i = 1..T, interpolated for this comparison only):

    between = mean_i var_r y_r(t_i)          variance over replicates, divisor R - 1
    tau     = 1 + 2 sum_k rho(k)^2           rho: autocorrelation of y_r - mean_r y, k up to the first k > 5 tau (Sokal's rule)
    n_eff   = T / tau                        independent squares in one trial
    gap     = mean_i (y(t_i) - model(t_i))^2

(rho squared, since mean squares are compared: the squares of a Gaussian process are correlated like rho^2. The plain sum would
let a beat that slips in phase count every row as independent.) A model without any fault has gap = between, the scatter of the
trial itself. So a gap is NOT_REPEATABLE, and nothing can be named, if

    gap / between <= max(1.5, F_0.95(n_eff, (R - 1) n_eff))

The second bound is exceeded by scatter alone one time in twenty: with few effective samples 1.5 would promise too much.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.timebase import lag_between
from fishmj.log.trial import Trial, stacked

RATIO = 1.5  # a gap up to this many times the scatter of replicates is none
LEVEL = 0.95
CONDITIONS = ("robot", "medium", "water", "flow.speed", "flow.direction", "excitation")
START = 0.2  # s, over which the first pose is averaged
COMMANDS = ("cmd", "gait")
SHIFT = 0.4  # s, how far motions are moved onto each other


@dataclass(frozen=True)
class ChannelScatter:
    """Scatter of one channel between replicates. `floor` is its standard deviation, in the channel's unit."""

    name: str
    unit: str
    variance: float
    floor: float
    tau: float  # s, integrated autocorrelation time of the squares
    effective: float  # independent squares in one trial
    replicates: int

    @property
    def freedom(self) -> float:
        """Degrees of freedom of `variance`."""
        return (self.replicates - 1) * self.effective


@dataclass(frozen=True)
class Group:
    """Replicate trials, and their scatter by channel."""

    key: str
    trials: tuple[str, ...]
    seconds: float  # compared over
    aligned: str  # "command": time since the command began; "motion": moved onto each other; "start": time since the first row
    channels: tuple[ChannelScatter, ...]

    def channel(self, name: str) -> ChannelScatter:
        """Scatter of the channel `name`; raises LogError if the group lacks it."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise LogError(f"{self.key}: no channel {name!r} in its replicates; there are {', '.join(c.name for c in self.channels)}")


@dataclass(frozen=True)
class Repeatability:
    """The verdict on a gap: `ratio` = gap / between over all channels, `limit` the least significant ratio."""

    repeatable: bool  # True: the gap is larger than the scatter, go on; False: NOT_REPEATABLE
    ratio: float
    limit: float
    p: float  # chance that scatter alone gives such a ratio
    by_channel: dict[str, float]

    def text(self) -> str:
        """One sentence."""
        verdict = "larger than what replicates differ by" if self.repeatable else "NOT_REPEATABLE: replicates differ as much"
        return f"gap is {self.ratio:.2f} times the scatter of replicates (limit {self.limit:.2f}, p = {self.p:.2g}): {verdict}"


def groups(trials: Iterable[Trial]) -> dict[str, list[Trial]]:
    """Groups of replicates: linked by `replicate_of`, else equal in all of `CONDITIONS` with a known excitation.

    Groups of one are left out; the key is the first trial's name, or the excitation.
    """
    named = {trial.name or str(i): trial for i, trial in enumerate(trials)}
    parent = {name: name for name in named}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    first: dict[tuple, str] = {}
    for name, trial in named.items():
        other = trial.value("replicate_of")
        if isinstance(other, str) and other in named:
            parent[root(name)] = root(other)
        elif trial.value("excitation"):
            condition = tuple(repr(trial.value(key)) for key in CONDITIONS)
            parent[root(name)] = root(first.setdefault(condition, name))
    out: dict[str, list[Trial]] = {}
    for name, trial in named.items():
        out.setdefault(root(name), []).append(trial)
    labelled = {str(members[0].value("excitation") or name): members for name, members in out.items() if len(members) > 1}
    unique = len(labelled) == sum(len(members) > 1 for members in out.values())
    return labelled if unique else {name: members for name, members in out.items() if len(members) > 1}


def scatter(key: str, trials: list[Trial]) -> Group:
    """Between-replicate variance of every channel that all trials have.

    Raises LogError: fewer than two trials, or less than ten comparison times in common.
    """
    if len(trials) < 2:
        raise LogError(f"{key}: one trial has no replicate; record the same excitation at least twice")
    each, aligned = _aligned(trials)
    shared = [name for name in each[0] if all(name in other for other in each)]
    out, longest = [], 0.0
    for name in shared:
        unit = each[0][name][0]
        grid = _grid([other[name][1] for other in each])
        if len(grid) < 10:
            continue
        values = np.stack([np.interp(grid, t, y) for _, t, y in (other[name] for other in each)])
        variance = float(np.mean(np.var(values, axis=0, ddof=1)))
        tau = autocorrelation_time(values - values.mean(axis=0))
        step = float(grid[1] - grid[0])
        out.append(ChannelScatter(name, unit, variance, math.sqrt(variance), tau * step, max(len(grid) / tau, 1.0), len(trials)))
        longest = max(longest, float(grid[-1] - grid[0]))
    if not out:
        raise LogError(f"{key}: the replicates share no channel over at least ten rows; record longer, or with the same tables")
    return Group(key, tuple(trial.name for trial in trials), longest, aligned, tuple(out))


def judge(gap: Mapping[str, float], group: Group) -> Repeatability:
    """Compares a gap (mean square error by channel, over about one trial) with the scatter of replicates.

    Raises LogError: a channel of the gap has no replicates, or its replicates are identical (not measured, or the same file).
    """
    from scipy.stats import f as fisher

    if not gap:
        raise LogError(
            f"{group.key}: no gap given; expected mean squares by channel, of {', '.join(c.name for c in group.channels)}"
        )
    by_channel, top, bottom = {}, 0.0, 0.0
    for name, value in gap.items():
        channel = group.channel(name)
        if not channel.variance > 0:
            raise LogError(f"{group.key}: replicates of {name!r} are identical; are they one recording under two names?")
        by_channel[name] = float(value) / channel.variance
        top, bottom = top + channel.effective, bottom + channel.freedom
    ratio = float(np.mean(list(by_channel.values())))
    limit = max(RATIO, float(fisher.ppf(LEVEL, top, bottom)))
    return Repeatability(ratio > limit, ratio, limit, float(fisher.sf(ratio, top, bottom)), by_channel)


def autocorrelation_time(residuals: np.ndarray) -> float:
    """Integrated autocorrelation time of the squares of `(R, T)` residuals, in samples; rows are averaged first; 1 to T."""
    residuals = np.atleast_2d(np.asarray(residuals, float))
    n = residuals.shape[1]
    length = 1 << int(np.ceil(np.log2(2 * n)))
    power = np.abs(np.fft.rfft(residuals, length, axis=1)) ** 2
    cover = np.fft.irfft(power, length, axis=1)[:, :n].sum(axis=0) / np.arange(n, 0, -1)
    if not cover[0] > 0:
        return 1.0
    running = 2 * np.cumsum((cover / cover[0]) ** 2) - 1
    enough = np.flatnonzero(np.arange(n) > 5.0 * running)
    return float(np.clip(running[enough[0] if len(enough) else -1], 1.0, n))


def channels(trial: Trial, after: float = 0.0) -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
    """Comparable channels: name -> (unit, t since the command began [s], values).

    Without a clock in common with the command, t counts from the channel's first row. A free swim has no common start: its pose
    becomes forward, left and turned, relative to the mean of the 0.2 s after `after`.
    """
    zero = (
        min((float(trial.tables[n]["t"][0]) for n in COMMANDS if n in trial.tables), default=None) if _one_clock(trial) else None
    )
    out = {}

    def add(name: str, unit: str, t: np.ndarray, values: np.ndarray) -> None:
        out[name] = (unit, t - (t[0] if zero is None else zero), values)

    if "joint" in trial.tables:
        table = trial.tables["joint"]
        for i, values in enumerate(stacked(table, "j#").T):
            add(f"joint{i + 1}", "rad", table["t"], values)
    if "pose" in trial.tables:
        table = trial.tables["pose"]
        t, yaw = table["t"], np.unwrap(table["yaw"])
        early = (t >= t[0] + after) & (t <= t[0] + after + START) if after > 0 else t <= t[0] + START
        early[:1] |= not early.any()
        x, y, start = table["x"] - table["x"][early].mean(), table["y"] - table["y"][early].mean(), yaw[early].mean()
        add("forward", "m", t, np.cos(start) * x + np.sin(start) * y)
        add("left", "m", t, np.cos(start) * y - np.sin(start) * x)
        add("turned", "rad", t, yaw - start)
    for name, column, unit in (
        *(("velocity", "surge", "m/s"), ("velocity", "sway", "m/s"), ("velocity", "yaw_rate", "rad/s")),
        *(("power", "V", "V"), ("power", "I", "A")),
    ):
        if column in trial.tables.get(name, {}):
            add(column, unit, trial.tables[name]["t"], trial.tables[name][column])
    return out


def _one_clock(trial: Trial) -> bool:
    """Returns True if there is a command, and the meta data name no other clock than its for any table."""
    clocks = trial.value("clock")
    said = {str(clocks[name]) for name in trial.tables if name in clocks} if isinstance(clocks, dict) else set()
    return any(name in trial.tables for name in COMMANDS) and len(said) < 2


def _aligned(trials: list[Trial]) -> tuple[list[dict], str]:
    """Channels of every trial on one time axis.

    Without a clock in common with the command, the first channel that turns (joint1, else turned) gives each trial's shift onto
    the first; if it does not show one, nothing is shifted. The pose is then counted from the stretch that all share, so that
    every beat starts in the same phase.
    """
    each = [channels(trial) for trial in trials]
    if all(_one_clock(trial) for trial in trials):
        return each, "command"
    lead = next((name for name in ("joint1", "turned") if all(name in other for other in each)), None)
    if lead is None:
        return each, "start"
    _, ta, a = each[0][lead]
    shifts = [0.0]
    for other in each[1:]:
        _, tb, b = other[lead]
        try:
            lag = lag_between(("first", ta, a[:, None]), ("other", tb, b[:, None]), reach=SHIFT)
        except LogError:
            lag = None
        shifts.append(lag.lag if lag and lag.found else 0.0)
    begin = max(float(other[lead][1][0]) - shift for other, shift in zip(each, shifts, strict=True))
    out = []
    for trial, shift in zip(trials, shifts, strict=True):
        own = channels(trial, after=begin + shift)
        out.append({name: (unit, t - shift, values) for name, (unit, t, values) in own.items()})
    return out, "motion" if any(shifts) else "start"


def _grid(stamps: list[np.ndarray]) -> np.ndarray:
    """Comparison times: the stretch that all share, in steps of the slowest."""
    start, end = max(t[0] for t in stamps), min(t[-1] for t in stamps)
    step = max(float(np.median(np.diff(t))) if len(t) > 1 else np.inf for t in stamps)
    return start + step * np.arange(int((end - start) / step) + 1) if end > start and np.isfinite(step) else np.zeros(0)
