"""Audit of a trial's clocks: rate, jitter, lost and repeated rows of every table; lags and drifts between tables.

A shift of 2 ms in the stamps looks like 24 % of damping, so this comes before any identification. Nothing is mended here.
"""

from dataclasses import asdict, dataclass, replace
from itertools import combinations

import numpy as np

from fishmj.errors import LogError
from fishmj.log.delay import Lag, lag_between
from fishmj.log.trial import Table, Trial, gaps, stacked

PAUSE = 10.0  # s; a longer step is a pause: no rate and no lost row is counted in it
LOST = 1.5  # steps longer than this many usual steps lack rows
LOCAL = 10  # steps on either side that say what is usual
COUNTED = 5e-3  # jitter below this part of the step: stamps are a frame counter, not a clock
DRIFT = 5e-5  # s/s; less is what two quartz clocks do
SAME_ROWS, OTHER_SPAN = 0.1, 0.2  # tables of equal length to 10 % whose spans differ by 20 %


@dataclass(frozen=True)
class Clock:
    """Stamps of one table. Times in s, `rate` in Hz; jitter is |step - median step|."""

    table: str
    rows: int
    start: float
    span: float
    rate: float
    jitter: float  # median
    jitter_p95: float
    jitter_p99: float
    dropped: int  # rows that are missing: from `seq` where there is one, else from long steps
    duplicated: int  # rows sent twice: a `seq` that repeats, else a row equal to the one before within half a step
    stale: float  # fraction of rows that repeat the values of the row before (a slow sensor read too fast)
    backward: int  # steps that do not rise
    gaps: int  # pauses that split the trial
    counted: bool  # stamps are perfectly even: counted, not measured


@dataclass(frozen=True)
class Audit:
    """All clocks of a trial, the lags between its channels, and what is worth knowing, one sentence each."""

    trial: str
    clocks: tuple[Clock, ...]
    lags: tuple[Lag, ...]
    findings: tuple[str, ...]

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "trial": self.trial,
            "clocks": [asdict(clock) for clock in self.clocks],
            "lags": [lag.as_dict() for lag in self.lags],
            "findings": list(self.findings),
        }

    def text(self) -> str:
        """A few lines for a terminal."""
        wide = max((len(clock.table) for clock in self.clocks), default=0)
        lines = [f"{self.trial or 'trial'}:"]
        for c in self.clocks:
            jitter = "/".join(f"{1e3 * v:.2f}" for v in (c.jitter, c.jitter_p95, c.jitter_p99))
            lines.append(
                f"  {c.table:<{wide}}  {c.rows} rows, {c.span:.2f} s, {c.rate:.2f} Hz; jitter {jitter} ms (median/p95/p99); "
                f"{c.dropped} dropped, {c.duplicated} duplicated, {c.gaps} gaps"
            )
        lines += [f"  {lag.text()}" for lag in self.lags]
        return "\n".join(lines + [f"  ! {finding}" for finding in self.findings])


def audit(trial: Trial, *, seed: int = 0) -> Audit:
    """Audit every table and every pair of channels that can be compared."""
    clocks = tuple(clock_of(name, table) for name, table in sorted(trial.tables.items()) if name != "target")
    lags, findings = [], []
    for earlier, later, either in _pairs(trial):
        try:
            lags.append(lag_between(earlier, later, either_sign=either, seed=seed))
        except LogError as error:
            findings.append(str(error))
    shared = _by_stamps(trial, clocks)
    findings += _table_findings(shared) + _pair_findings(trial, shared) + _lag_findings(lags)
    return Audit(trial.name, clocks, tuple(lags), tuple(findings))


def clock_of(name: str, table: Table) -> Clock:
    """Figures of one table's stamps."""
    t = np.asarray(table["t"], float)
    step = np.diff(t)
    middle = float(np.median(step)) if len(step) else 0.0
    off = np.abs(step - middle) if len(step) else np.zeros(1)
    same = _repeats(table)
    swum = float(np.sum(step[step <= max(PAUSE, 2 * middle)]))
    steps = int(np.sum(step <= max(PAUSE, 2 * middle)))
    if "seq" in table:
        seq = np.diff(np.asarray(table["seq"], float))
        dropped, duplicated = int(np.sum(np.maximum(seq - 1, 0))), int(np.sum(seq == 0))
    else:
        dropped, duplicated = _missing(step[step <= max(PAUSE, 2 * middle)]), int(np.sum(same & (step < 0.5 * middle)))
    return Clock(
        table=name,
        rows=len(t),
        start=float(t[0]) if len(t) else 0.0,
        span=float(t[-1] - t[0]) if len(t) else 0.0,
        rate=steps / swum if swum > 0 else 0.0,
        jitter=float(np.median(off)),
        jitter_p95=float(np.quantile(off, 0.95)),
        jitter_p99=float(np.quantile(off, 0.99)),
        dropped=dropped,
        duplicated=duplicated,
        stale=float(np.mean(same)) if len(same) else 0.0,
        backward=int(np.sum(step <= 0)),
        gaps=len(gaps(t)) if len(t) > 1 else 0,
        counted=bool(len(step) > 2 and np.quantile(off, 0.99) < COUNTED * middle),
    )


def _missing(step: np.ndarray) -> int:
    """Rows that long steps lack. The yardstick is the median around each step (a bus may change its rate), the threshold leaves
    room for the jitter: more than 1.5 local steps, and more than four robust standard deviations above one."""
    if len(step) < 3:
        return 0
    reach = min(LOCAL, (len(step) - 1) // 2)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(step, reach, mode="reflect"), 2 * reach + 1)
    local = np.median(around, axis=1)
    ratio = step / np.maximum(local, 1e-12)
    sigma = 1.4826 * float(np.median(np.abs(ratio - 1)))
    return int(np.sum(np.maximum(np.round(ratio[ratio > max(LOST, 1 + 4 * sigma)]) - 1, 0)))


def _repeats(table: Table) -> np.ndarray:
    """(T - 1,) True where all columns but the stamps and numbers equal the row before."""
    values = [np.asarray(v, float) for c, v in table.items() if c not in ("t", "t_rx", "seq")]
    if not values:
        return np.zeros(max(len(table["t"]) - 1, 0), bool)
    return np.all(np.diff(np.stack(values), axis=1) == 0, axis=0)


def _pairs(trial: Trial):
    """(earlier, later, whether they may move against each other) of all channels worth comparing."""
    tables = trial.tables
    signals = {}
    for name, template in (("cmd", "c#"), ("joint", "j#")):
        if name in tables and stacked(tables[name], template).shape[1]:
            signals[name] = (name, tables[name]["t"], stacked(tables[name], template))
    if "pose" in tables:
        signals["yaw"] = ("pose", tables["pose"]["t"], np.unwrap(tables["pose"]["yaw"])[:, None])
    if "cmd" in signals and "joint" in signals:
        yield signals["cmd"], signals["joint"], False
    if "yaw" in signals and (source := signals.get("joint") or signals.get("cmd")):
        name, t, values = source
        yield (name, t, values[:, :1]), signals["yaw"], True  # the head recoils against the first joint
    if "yaw" in signals and "velocity" in tables and "yaw_rate" in tables["velocity"]:
        t, rate = tables["velocity"]["t"], tables["velocity"]["yaw_rate"]
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
        yield signals["yaw"], ("velocity", t, turned[:, None]), False


def _by_stamps(trial: Trial, clocks: tuple[Clock, ...]) -> list[Clock]:
    """One clock for all tables with the very same stamps, under their joined names: what is said of one is said once."""
    out: list[Clock] = []
    for clock in clocks:
        t = trial.tables[clock.table]["t"]
        for i, other in enumerate(out):
            if np.array_equal(t, trial.tables[other.table.split(", ")[0]]["t"]):
                out[i] = replace(other, table=f"{other.table}, {clock.table}", duplicated=min(other.duplicated, clock.duplicated))
                break
        else:
            out.append(clock)
    return out


def _table_findings(clocks: list[Clock]) -> list[str]:
    out = []
    for c in clocks:
        if c.backward:
            out.append(f"{c.table}: {c.backward} stamps do not rise")
        if c.counted:
            out.append(
                f"{c.table}: stamps are perfectly even: counted at {c.rate:g} Hz, not read from a clock; real jitter is unknown"
            )
        if c.dropped:
            out.append(f"{c.table}: about {c.dropped} rows are missing ({100 * c.dropped / (c.rows + c.dropped):.1f} %)")
        if c.duplicated:
            out.append(f"{c.table}: {c.duplicated} rows were sent twice")
    return out


def _pair_findings(trial: Trial, clocks: list[Clock]) -> list[str]:
    out = []
    for one, two in combinations([c for c in clocks if c.rows > 20 and c.span > 0], 2):
        fast, slow = (one, two) if one.span < two.span else (two, one)
        alike = abs(one.rows - two.rows) <= SAME_ROWS * max(one.rows, two.rows)
        if alike and slow.span > (1 + OTHER_SPAN) * fast.span:
            out.append(
                f"{fast.table} and {slow.table} have as many rows ({fast.rows}, {slow.rows}) but span {fast.span:.2f} and "
                f"{slow.span:.2f} s: one of the clocks may run {fast.rate / slow.rate:.2f} times too fast"
            )
    command = trial.tables.get("cmd", {})
    if "t_rx" in command:
        delay = np.asarray(command["t_rx"], float) - np.asarray(command["t"], float)
        median, p95, p99 = (1e3 * np.quantile(delay, q) for q in (0.5, 0.95, 0.99))
        out.append(f"cmd: received {median:.1f} ms after sending (median; p95 {p95:.1f}, p99 {p99:.1f}), clock offset included")
    return out


def _lag_findings(lags: list[Lag]) -> list[str]:
    out = []
    for lag in lags:
        if lag.found and not lag.ambiguous and (lag.drift_low > 0 or lag.drift_high < 0) and abs(lag.drift) > DRIFT:
            out.append(
                f"{lag.later} drifts against {lag.earlier} by {1e3 * lag.drift:+.3f} ms/s: their clocks run at different rates"
            )
    return out
