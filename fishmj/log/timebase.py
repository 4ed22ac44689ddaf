"""Audit of a trial's clocks: rate, jitter, lost and repeated rows of every table; lags and drifts between tables.

A shift of 2 ms in the stamps looks like 24 % of damping, so this comes before any identification. Nothing is corrected here.

Lag of one channel behind another: cross-correlation of rates, peak between samples, bootstrap interval, drift. For signals
a, b on their own irregular stamps and rates a', b' on a common fine grid (for this comparison only),

    R(l) = sum_w sum_t a'_w(t) b'_w(t + l) / sqrt(sum_w sum_t a'_w(t)^2  sum_w sum_t b'_w(t + l)^2),   lag = argmax R

with the sum over windows w, and the peak from the parabola through the three highest points. (The energy of b' is that of the
shifted stretch: with a fixed one, a motion that grows would pull the lag.) A positive lag says that b comes later. The interval
resamples windows with replacement. The drift is the slope of the windows' own lags over the session.

A drift is attributed to the clocks only if frequency, amplitude and gain do not explain it: a mechanism's lag depends on them.

Both rates get the same Gaussian, which shifts nothing. The estimate cannot tell a delay of the clocks from one of the transport
or of the mechanism between the two channels; a first-order servo with time constant T appears as about T.
"""

from dataclasses import asdict, dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import f as f_test
from scipy.stats import t as student

from fishmj.base.errors import LogError
from fishmj.log.clock_alignment import LONGEST, REACH, offset_between, rates
from fishmj.log.onsets import offset_findings
from fishmj.log.trial import Table, Trial, gaps, repeats, stacked

WINDOW = 2.0  # s, one bootstrap unit
MIN_WINDOWS = 4
DRAWS = 400
WEAK = 0.5  # peak correlation below which no lag is claimed
WIDE = 0.1  # s, width of the interval above which none is claimed either
RIVAL = 0.95  # a second peak this close to the first makes a periodic signal ambiguous
EARLY = -0.02  # s; a joint that moves so long before its command has another clock
PAUSE = 10.0  # s; a longer step is a pause: no rate and no lost row is counted in it
LOST = 1.5  # steps longer than this many usual steps lack rows
LOCAL = 10  # steps on either side that say what is usual
STEADY = 0.01  # relative deviation over the windows below which frequency, amplitude or gain are taken for constant
MOVING = 0.05  # of the median energy of a window; one with less tells no gain
COUNTED = 5e-3  # jitter below this part of the step: stamps are a frame counter, not a clock
DRIFT = 5e-5  # s/s; less is what two quartz clocks do
SETTLES = 0.05  # s by which the heading's lag changes while a fish gathers way, with right clocks
DELAYS = {"command_latency": "cmd", "camera_latency": "pose"}  # of a description's [timing]: the table that has it
SAME_ROWS, OTHER_SPAN = 0.1, 0.2  # tables of equal length to 10 % whose spans differ by 20 %


@dataclass(frozen=True)
class Lag:
    """Lag of `later` behind `earlier` [s], 90 % interval [low, high]; `drift` in s per s of session, with its interval."""

    earlier: str
    later: str
    lag: float
    low: float
    high: float
    correlation: float  # at the peak; negative where the channels move against each other
    drift: float
    drift_low: float
    drift_high: float
    windows: int
    ambiguous: bool  # another lag within reach fits as well (a steady beat), or the best one lies at the edge

    @property
    def found(self) -> bool:
        """Returns True if the correlation is strong enough, and the interval narrow enough, for a lag."""
        return abs(self.correlation) >= WEAK and self.high - self.low <= WIDE

    def as_dict(self) -> dict:
        """All fields and `found`, for JSON."""
        return {**asdict(self), "found": self.found}

    def text(self) -> str:
        """One line."""
        head = f"{self.later} behind {self.earlier}: "
        if not self.found:
            interval = f"{1e3 * self.low:.0f} to {1e3 * self.high:.0f} ms"
            return head + f"not told: correlation {self.correlation:.2f}, interval {interval}; record reversals or a chirp"
        doubt = "; not unique within reach (a steady beat, or the edge of what was looked at): record reversals or a chirp"
        drift = f", drift {1e3 * self.drift:+.3f} ms/s ({1e3 * self.drift_low:+.3f} to {1e3 * self.drift_high:+.3f})"
        return (
            f"{head}{1e3 * self.lag:.1f} ms ({1e3 * self.low:.1f} to {1e3 * self.high:.1f}), "
            f"correlation {self.correlation:.2f}{drift}{doubt if self.ambiguous else ''}"
        )


def lag_between(
    earlier: tuple[str, np.ndarray, np.ndarray],
    later: tuple[str, np.ndarray, np.ndarray],
    *,
    either_sign: bool = False,
    reach: float = REACH,
    seed: int = 0,
) -> Lag:
    """Lag of `later` behind `earlier`, each (name, t (T,) [s], values (T, N)); the N channels are paired in order.

    Raises LogError: less than `MIN_WINDOWS` windows in common, or a channel that never moves.
    """
    (name_a, ta, a), (name_b, tb, b) = earlier, later
    n = min(a.shape[1], b.shape[1])
    if min(len(ta), len(tb)) < 8 or not n:
        raise LogError(f"{name_b} behind {name_a}: {len(ta)} and {len(tb)} rows; at least 8 of each are needed")
    step = float(np.clip(min(np.median(np.diff(ta)), np.median(np.diff(tb))) / 4, 1e-3, 5e-3))
    ta, tb = _without_pauses(np.asarray(ta, float), np.asarray(tb, float), WINDOW)
    start, end = max(ta[0], tb[0]), min(ta[-1], tb[-1])
    count = int((end - start) / step)
    size = max(int(min(WINDOW, (end - start) / MIN_WINDOWS) / step), 1)
    shift = round(reach / step)
    if count < MIN_WINDOWS * size or size < 2 * shift:
        need = MIN_WINDOWS * 2 * reach
        raise LogError(
            f"{name_b} behind {name_a}: {max(end - start, 0):.2f} s in common; at least {need:g} s are needed for a lag"
        )
    if count > LONGEST:
        raise LogError(
            f"{name_b} behind {name_a}: {end - start:.0f} s in common; a lag is looked for in {LONGEST * step:.0f} s at most; "
            "split the trial"
        )
    grid = start + step * np.arange(count)
    blur = 1.5 * max(np.median(np.diff(ta)), np.median(np.diff(tb))) / step
    rate_a, rate_b = (rates(t, v[:, :n], grid, blur) for t, v in ((ta, a), (tb, b)))
    if not (np.any(rate_a) and np.any(rate_b)):
        raise LogError(f"{name_b} behind {name_a}: one of them never moves, so there is no lag to see")
    products, energy_a, energy_b = _windows(rate_a, rate_b, size, shift)

    def curve_of(index) -> np.ndarray:
        total = np.sqrt(energy_a[index].sum() * energy_b[index].sum(axis=0))
        return products[index].sum(axis=0) / np.maximum(total, 1e-300)

    curve = curve_of(slice(None))
    sign = -1.0 if either_sign and -curve.min() > curve.max() else 1.0
    at, peak = _peak(sign * curve)
    draws = np.random.default_rng(seed).integers(0, len(products), (DRAWS, len(products)))
    near = max(round(0.5 * shift), 3)  # resampled peaks are looked for around the peak of the whole
    low, high = np.quantile([_near(sign * curve_of(d), at, near) for d in draws], [0.05, 0.95])
    own = np.stack([sign * curve_of([w]) for w in range(len(products))])
    gain = (sign * products).max(axis=1) / np.maximum(energy_a, 1e-300)
    moves = _movements(rate_a, size, gain)
    drift, bounds = _drift(own, np.clip(own.max(axis=1), 0, 1) * energy_a, at, near, size * step, *moves)
    where = lambda k: float((k - shift) * step)  # index on the curve -> lag [s]
    return Lag(
        *(name_a, name_b, where(at), where(low), where(high), float(sign * peak)),
        *(drift * step, bounds[0] * step, bounds[1] * step),
        *(len(products), _rival(np.abs(curve) if either_sign else curve, at)),
    )


def offsets(trial: Trial) -> list[str]:
    """One sentence for every pair of channels whose motion, or the onset of it, shows a clock offset."""
    out, told = [], set()
    for earlier, later, either in _pairs(trial):
        if found := offset_between(earlier, later, either_sign=either):
            told |= {later[0]}
            names = " and ".join(name for name, table in DELAYS.items() if table in (earlier[0], later[0]))
            late = ", or a delay is that long" if found[0] > 0 else ""
            out.append(
                f"{later[0]} is {abs(found[0]):.2f} s {'behind' if found[0] > 0 else 'ahead of'} {earlier[0]} by their motion, "
                f"delays of servo and camera included (correlation {found[1]:.2f}): their clocks differ{late}; the map's "
                f"[tables.{later[0]}] offset = {-found[0]:.2f}, and a new import, align them, and remove the true delay of "
                f"sensor or command too: add what is known of it to the offset, or keep the stamps and state it as {names} of the"
                " description"
            )
    return out + offset_findings(trial, told)


def _without_pauses(ta: np.ndarray, tb: np.ndarray, keep: float) -> tuple[np.ndarray, np.ndarray]:
    """Both stamps with every common pause cut to `keep` s, by the same amount for both, so that no lag changes.

    The grid is then as long as the motion, however long the logger slept. A drift is per second of the remaining time.
    """
    cut_a, cut_b = ta.copy(), tb.copy()
    ends = [(ta[i], ta[i + 1]) for i in np.flatnonzero(np.diff(ta) > keep)]
    for start, end in ends:
        row = int(np.searchsorted(tb, 0.5 * (start + end)))
        if not 0 < row < len(tb):
            continue
        pause, resume = max(start, tb[row - 1]), min(end, tb[row])
        if (spare := resume - pause - keep) > 0:
            cut_a[ta >= resume] -= spare
            cut_b[tb >= resume] -= spare
    return cut_a, cut_b


def _windows(a: np.ndarray, b: np.ndarray, size: int, shift: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per window and lag: sums of a(t) b(t + l) (W, L), of a(t)^2 (W,) and of b(t + l)^2 (W, L), with L = 2 shift + 1.

    b is taken beyond the window's ends, so that every lag sums over the same stretch of a.
    """
    count = len(a) // size
    padded = np.pad(b, ((shift, shift), (0, 0)))
    products, energy_b = np.zeros((2, count, 2 * shift + 1))
    energy_a = np.sum(a[: count * size].reshape(count, -1) ** 2, axis=1)
    length = 1 << int(np.ceil(np.log2(2 * size + 4 * shift)))
    for w in range(count):
        one, two = a[w * size : (w + 1) * size], padded[w * size : (w + 1) * size + 2 * shift]
        spectrum = np.conj(np.fft.rfft(one, length, axis=0)) * np.fft.rfft(two, length, axis=0)
        products[w] = np.fft.irfft(spectrum, length, axis=0)[: 2 * shift + 1].sum(axis=1)
        running = np.concatenate([[0.0], np.cumsum(np.sum(two**2, axis=1))])
        energy_b[w] = running[size : size + 2 * shift + 1] - running[: 2 * shift + 1]
    return products, energy_a, energy_b


def _peak(curve: np.ndarray) -> tuple[float, float]:
    """Index between samples and height of the highest point."""
    i = int(np.argmax(curve))
    if not 0 < i < len(curve) - 1:
        return float(i), float(curve[i])
    left, top, right = curve[i - 1 : i + 2]
    bend = left - 2 * top + right
    offset = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return i + offset, float(top - 0.25 * (left - right) * offset)


def _near(curve: np.ndarray, at: float, reach: int) -> float:
    """Position of the peak within `reach` samples of index `at`."""
    start = max(round(at) - reach, 0)
    return start + _peak(curve[start : round(at) + reach + 1])[0]


def _movements(rates: np.ndarray, size: int, gain: np.ndarray) -> tuple[np.ndarray, bool]:
    """((K, W) mean frequency squared, amplitude, gain and its square of every window; True if the gain varies)."""
    count = len(rates) // size
    blocks = rates[: count * size].reshape(count, size, -1)
    energy = np.sum(blocks**2, axis=(1, 2)) + 1e-300
    frequency = np.sum(np.diff(blocks, axis=1) ** 2, axis=(1, 2)) / energy
    moving = gain[energy > MOVING * np.median(energy)]
    found = [v for v in (frequency, np.sqrt(energy), gain, gain**2) if np.std(v) > STEADY * np.mean(v)]
    return np.array(found).reshape(-1, count), bool(np.std(moving) > STEADY * np.mean(moving))


def _drift(
    curves: np.ndarray, weights: np.ndarray, at: float, near: int, spacing: float, moves: np.ndarray, varies: bool
) -> tuple[float, tuple[float, float]]:
    """Slope of the windows' own lags [samples/s], weighted, and its 99 % interval.

    If the gain varies, or the lags follow frequency and amplitude (an F test at 1 %), the mechanism between the channels varies
    too. The slope is then the part that frequency, amplitude and gain leave unexplained; its interval is that of all fits without
    one of them.
    """
    lags = np.array([_near(row, at, near) for row in curves])
    times = spacing * (np.arange(len(lags)) - 0.5 * (len(lags) - 1)) / (spacing * len(lags))
    moves = (moves - moves.mean(axis=1, keepdims=True)) / np.maximum(moves.std(axis=1, keepdims=True), 1e-12)
    moves = moves[: max(len(lags) - 4, 0)]
    root = np.sqrt(weights / max(float(weights.max()), 1e-300))

    def fit(*more: np.ndarray) -> tuple[float, float, float, int]:
        """(slope, half its interval, sum of squares that is left, degrees of freedom)."""
        design = np.stack([times, np.ones(len(lags)), *more], axis=1) * root[:, None]
        found, *_ = np.linalg.lstsq(design, root * lags, rcond=1e-9)
        error, free = float(np.sum((root * lags - design @ found) ** 2)), len(lags) - design.shape[1]
        spread = float(np.linalg.pinv(design.T @ design, rcond=1e-12)[0, 0])
        return float(found[0]), float(student.ppf(0.995, free) * np.sqrt(error / free * spread)), error, free

    fits = [fit()]
    if len(moves):
        whole = fit(*moves)
        ratio = (fits[0][2] - whole[2]) / len(moves) / max(whole[2] / whole[3], 1e-300)
        if varies or f_test.sf(ratio, len(moves), whole[3]) < 0.01:
            fits = [whole, *(fit(*np.delete(moves, k, axis=0)) for k in range(len(moves)))]
    length = spacing * len(lags)
    return fits[0][0] / length, (min(f[0] - f[1] for f in fits) / length, max(f[0] + f[1] for f in fits) / length)


def _rival(curve: np.ndarray, at: float) -> bool:
    """Returns True if another local maximum is almost as high, or if the highest point is at the edge of the range."""
    inner = np.flatnonzero((curve[1:-1] >= curve[:-2]) & (curve[1:-1] > curve[2:])) + 1
    others = inner[np.abs(inner - at) > 3]
    edge = round(at) in (0, len(curve) - 1)
    return bool(edge or np.any(curve[others] >= RIVAL * curve.max()))


@dataclass(frozen=True)
class TableClock:
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
    """All clocks of a trial, the lags between its channels, and remarks, one sentence each."""

    trial: str
    clocks: tuple[TableClock, ...]
    lags: tuple[Lag, ...]
    findings: tuple[str, ...]

    def as_dict(self) -> dict:
        """The audit as plain data for JSON."""
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


def audit(trial: Trial) -> Audit:
    """Audits every table and every pair of comparable channels."""
    clocks = tuple(clock_of(name, table) for name, table in sorted(trial.tables.items()) if name != "target")
    lags, findings = [], []
    for earlier, later, either in _pairs(trial):
        try:
            lags.append(lag_between(earlier, later, either_sign=either))
        except LogError as error:
            findings.append(str(error))
    shared = _by_stamps(trial, clocks)
    findings += offsets(trial) + _table_findings(shared) + _pair_findings(trial, shared) + _lag_findings(lags)
    return Audit(trial.name, clocks, tuple(lags), tuple(findings))


def clock_of(name: str, table: Table) -> TableClock:
    """Figures of one table's stamps."""
    t = np.asarray(table["t"], float)
    step = np.diff(t)
    middle = float(np.median(step)) if len(step) else 0.0
    off = np.abs(step - middle) if len(step) else np.zeros(1)
    same = repeats(table)
    swum = float(np.sum(step[step <= max(PAUSE, 2 * middle)]))
    steps = int(np.sum(step <= max(PAUSE, 2 * middle)))
    if "seq" in table and np.ptp(table["seq"]) > 0:  # a constant number, such as -1, counts nothing
        seq = np.diff(np.asarray(table["seq"], float))
        dropped, duplicated = int(np.sum(np.maximum(seq - 1, 0))), int(np.sum(seq == 0))
    else:
        dropped, duplicated = _missing(step[step <= max(PAUSE, 2 * middle)]), int(np.sum(same & (step < 0.5 * middle)))
    return TableClock(
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
    """Number of rows that long steps lack.

    The yardstick is the median around each step, since a bus may change its rate. The threshold leaves room for jitter: more than
    1.5 local steps, and more than four robust standard deviations above one.
    """
    if len(step) < 3:
        return 0
    reach = min(LOCAL, (len(step) - 1) // 2)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(step, reach, mode="reflect"), 2 * reach + 1)
    local = np.median(around, axis=1)
    ratio = step / np.maximum(local, 1e-12)
    sigma = 1.4826 * float(np.median(np.abs(ratio - 1)))
    return int(np.sum(np.maximum(np.round(ratio[ratio > max(LOST, 1 + 4 * sigma)]) - 1, 0)))


def _pairs(trial: Trial):
    """(earlier, later, True if they may move against each other) of all comparable channels."""
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


def _by_stamps(trial: Trial, clocks: tuple[TableClock, ...]) -> list[TableClock]:
    """One clock for all tables with identical stamps, under their joined names, so that each remark appears once."""
    out: list[TableClock] = []
    for clock in clocks:
        t = trial.tables[clock.table]["t"]
        for i, other in enumerate(out):
            if np.array_equal(t, trial.tables[other.table.split(", ")[0]]["t"]):
                out[i] = replace(other, table=f"{other.table}, {clock.table}", duplicated=min(other.duplicated, clock.duplicated))
                break
        else:
            out.append(clock)
    return out


def _table_findings(clocks: list[TableClock]) -> list[str]:
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


def _pair_findings(trial: Trial, clocks: list[TableClock]) -> list[str]:
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
        if lag.found and (lag.earlier, lag.later) == ("cmd", "joint") and lag.high < EARLY:
            out.append(
                f"joint moves {-1e3 * lag.lag:.0f} ms before cmd: one of the clocks is off; state its offset in the map, that"
                " lead and the servo's true delay, which a shift by the lead alone removes"
            )
        if lag.found and not lag.ambiguous and lag.later == "pose" and lag.high < EARLY:
            out.append(
                f"pose moves {-1e3 * lag.lag:.0f} ms before {lag.earlier}, and a heading follows: one of the clocks is off; state"
                " its offset in the map"
            )
        least = max(lag.drift_low, -lag.drift_high, 0.0)  # s/s, of the interval's values that nearest to none
        slips = least * lag.windows * WINDOW > (SETTLES if "pose" in (lag.earlier, lag.later) else 0.0)
        if lag.found and not lag.ambiguous and slips and abs(lag.drift) > DRIFT:
            out.append(
                f"{lag.later} drifts against {lag.earlier} by {1e3 * lag.drift:+.3f} ms/s: their clocks run at different rates"
            )
    return out
