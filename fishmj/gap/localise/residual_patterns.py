"""Patterns of the residual: lag of every channel, lock to the tail beat, growth with the command's speed, world or body, side.

Lags behind the model and behind the command come from cross-correlations of rates, with bootstrap intervals (log/timebase.py),
over all records in which the channel moves, concatenated with pauses. During a tail beat,

    r(t) = p0 + p1 t + g c(t) + h H[c](t)     in windows of two beats at least;  H quarter of a beat later (Hilbert transform)

locked = share of the residual's variance about its straight line that g and h explain, corrected for degrees of freedom. g < 0:
the motion is too small; h: it is too late.

The gap of the position may have a direction fixed in the tank or on the robot; that of the heading may have a side:

    dr/dt of the position's residual = a + R(heading) b       a [m/s] fixed in the world: current, swirl, tether, camera axes
                                                              b [m/s] fixed on the body: thrust, drag, offsets
    d/dt of the heading's residual = even + odd * (turning rate of the model)
                                                              even [rad/s]: the same on both sides: offset, asymmetry
                                                              odd: a turn too strong or too weak

In body axes, a appears as first harmonic over the heading and b as a constant. Rates are straight lines through STRETCH seconds,
tapered so that a beat does not look like a turn; fits are weighted with the floor; standard deviations resample BLOCK seconds.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from fishmj.base.errors import LogError
from fishmj.gap.localise.comparison import Comparison, beat_of
from fishmj.log.timebase import Lag, lag_between

# --------------------------------------------------------------------------------------------------------------------------- lags
PAUSE = 3.0  # s between records
SAME = 0.006  # s, least difference of lags that counts: a servo within its tolerance makes less
REACH = 0.25  # s
MOVES = {"joint": 0.03, "heading": 0.05}  # rad, least standard deviation of a record that is compared


class Lags(NamedTuple):
    """Lags of the channels; None if not found. Positive: measured comes later.

    joint, heading: measured behind the model; *_after: with the found effects. command: joint behind the command; model: the
    model's joint behind the command. residual: joint residual behind the command.
    """

    joint: Lag | None
    heading: Lag | None
    joint_after: Lag | None
    heading_after: Lag | None
    command: Lag | None
    model: Lag | None
    residual: Lag | None


def lags(c: Comparison) -> Lags:
    """All lags of a comparison."""
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
    """The lag; None if the data are too short or weak, its interval is too wide, or another peak is as high."""
    if earlier is None or later is None:
        return None
    try:
        lag = lag_between((a, *earlier), (b, *later), reach=REACH, either_sign=either_sign)
    except LogError:
        return None
    return lag if lag.found and not lag.ambiguous else None


def chain(c: Comparison, channel: str, which) -> tuple[np.ndarray, np.ndarray] | None:
    """Stamps and values of a channel of all moving records, end to end. which: measured, command, or a row's number."""
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
    """Returns True for a lag whose interval excludes zero by more than the resolution."""
    return lag is not None and (lag.low > SAME or lag.high < -SAME)


def compatible(a: Lag | None, b: Lag | None) -> bool:
    """Returns True if two lags are equal within their intervals."""
    return a is not None and b is not None and a.low - SAME <= b.high and b.low - SAME <= a.high


# ------------------------------------------------------------------------------------------------------------------ beat and rate
LEAST = 0.05  # rad, least standard deviation of a beating command
BINS = 5
RECENT = 0.25  # s, time in which a command becomes a motion


class BeatLock(NamedTuple):
    """Lock to the tail beat. locked: share of the variance. behind: its phase behind the command, rad. windows: number fitted."""

    locked: float
    behind: float
    windows: int


class BeatRates(NamedTuple):
    """Mean square of the joint residual over the floor, level (B,), by speed of the command, middle (B,) rad/s, B up to BINS."""

    middle: np.ndarray
    level: np.ndarray

    @property
    def ratio(self) -> float:
        """Mean square of the fastest fifth over that of the slowest."""
        return float(self.level[-1] / max(self.level[0], 1e-9))


def beat(c: Comparison, channel: str) -> BeatLock | None:
    """Lock of the joints or the heading to the beat; None if nothing beats for long enough."""
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
            spare += 2.0 * float(left @ left) / (some.sum() - 4)  # share that two columns explain by chance
            turned += (value[2] - 1j * value[3]) * np.mean(np.abs(at[some]) ** 2)
            windows += 1
    if not windows or total <= 0:
        return None
    return BeatLock(float(np.clip((taken - spare) / total, 0.0, 1.0)), float(-np.angle(turned)), windows)


def analytic(values: np.ndarray) -> np.ndarray:
    """(T,) analytic signal c + i H[c] without its mean; the ends are extended by mirroring."""
    values = values - values.mean()
    n = len(values)
    spectrum = np.fft.fft(np.concatenate([values, -values[::-1]]))
    spectrum[1:n] *= 2.0
    spectrum[n + 1 :] = 0.0
    return np.fft.ifft(spectrum)[:n]


def by_rate(c: Comparison) -> BeatRates | None:
    """Joint residual by the fastest command of the last RECENT seconds; None without joints or commands of several speeds."""
    speed, level = [], []
    for b in c.layout.blocks:
        if b.channel != "joint":
            continue
        record = c.records[b.record]
        rate = np.abs(np.gradient(record.commands[:, b.column], record.dt))
        rate = maximum_filter1d(rate, width := max(round(RECENT / record.dt), 1), origin=(width - 1) // 2)
        speed.append(np.interp(b.t, np.arange(len(rate)) * record.dt, rate))
        level.append(c.over_floor[0][b.where])
    if not speed:
        return None
    rate = np.concatenate(speed)
    ratio = np.concatenate(level)
    moving = rate > 1e-3
    if moving.sum() < 4 * BINS:
        return None
    edges = np.quantile(rate[moving], np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, rate[moving], side="right") - 1, 0, BINS - 1)
    bins = [place == k for k in np.unique(place)]
    if len(bins) < 2:
        return None
    middle = np.array([np.median(rate[moving][b]) for b in bins])
    return BeatRates(middle, np.array([np.mean(ratio[moving][b]) for b in bins]))


# --------------------------------------------------------------------------------------------------- world or body, left or right
STRETCH, EVERY, BLOCK = 2.0, 1.0, 4.0  # s
DRAWS = 400
OCTANTS = 8
TURNS = 0.3  # rad/s, least standard deviation of the turning rate to fit its share in the residual
BEATS = 0.03  # rad, least standard deviation of a moving command


class FrameResidual(NamedTuple):
    """Residual of the velocity over ground. world, body: (2,) m/s with sd; *_share: of its mean square that each explains alone.

    octant: (8, 2) weighted mean residual ahead and to the left, m/s, by heading (0 = along +x).
    """

    world: np.ndarray
    world_sd: np.ndarray
    body: np.ndarray
    body_sd: np.ndarray
    world_share: float
    body_share: float
    octant: np.ndarray

    @property
    def points(self) -> str:
        """Direction of the residual: world, body, or neither."""
        ahead = self.world_share - self.body_share
        if max(self.world_share, self.body_share) < 0.3 or abs(ahead) < 0.1:
            return "neither"
        return "world" if ahead > 0 else "body"


class Side(NamedTuple):
    """Residual of the turning rate by side.

    even [rad/s], odd [1], with sd (infinite: undetermined); left, right: mean residual while turning there, rad/s.
    """

    even: float
    even_sd: float
    odd: float
    odd_sd: float
    left: float
    right: float


class RecordStretch(NamedTuple):
    """Rates over one stretch of a record."""

    record: int
    block: int
    heading: float
    turning: float  # model, rad/s
    drift: np.ndarray  # (2,) m/s world
    spin: float  # rad/s
    beats: bool  # the joints move
    weight: float
    spin_weight: float


def stretches(c: Comparison) -> list[RecordStretch]:
    """Every stretch of every record that has a pose."""
    out: list[RecordStretch] = []
    for i, record in enumerate(c.records):
        blocks = [b for b in c.layout.blocks if b.record == i and b.sensor == "pose"]
        if len(blocks) != 3 or record.pose is None:
            continue
        t = blocks[0].t
        yaw = np.interp(t, record.pose.t, record.pose.values[:, 2])
        model = np.interp(t, record.pose.t, c.predictions[i]["pose"][0][:, 2])
        for start in np.arange(0.0, t[-1] - STRETCH + 1e-6, EVERY):
            some = (t >= start) & (t < start + STRETCH)
            if some.sum() < 4:
                continue
            drift = np.array([_slope(t[some], c.residuals[0][b.where][some]) for b in blocks[:2]])
            spin = _slope(t[some], c.residuals[0][blocks[2].where][some])
            floor = [float(np.mean(c.scale[b.where][some] ** 2)) for b in blocks]
            turning = _slope(t[some], model[some])
            place = (i, int(start // BLOCK), float(yaw[some].mean()), turning)
            first, last = (round(edge / record.dt) for edge in (start, start + STRETCH))
            beats = float(record.commands[first:last].std(0).max()) > BEATS
            out.append(RecordStretch(*place, drift, spin, beats, 2.0 / (floor[0] + floor[1]), 1.0 / floor[2]))
    return out


def frame(found: list[RecordStretch]) -> FrameResidual | None:
    """Residual of the velocity in world and body axes; None without a pose."""
    if len(found) < 4:
        return None
    heading = np.array([s.heading for s in found])
    weight = np.array([s.weight for s in found])
    drift = np.stack([s.drift for s in found])
    co = np.cos(heading)
    si = np.sin(heading)
    world = np.tile(np.eye(2), (len(found), 1, 1))
    body = np.stack([np.stack([co, -si], 1), np.stack([si, co], 1)], 1)
    both = np.concatenate([world, body], 2)  # (n, 2, 4)
    value, sd = _fit(both, drift, weight, _blocks(found))
    by_world, by_body = (_explained(part, drift, weight) for part in (world, body))
    seen = np.stack([co * drift[:, 0] + si * drift[:, 1], co * drift[:, 1] - si * drift[:, 0]], 1)
    octant = np.round(heading / (2 * np.pi / OCTANTS)).astype(int) % OCTANTS
    sums = np.stack([np.bincount(octant, weight * seen[:, k], OCTANTS) for k in (0, 1)], 1)
    mean = sums / np.maximum(np.bincount(octant, weight, OCTANTS), 1e-12)[:, None]
    mean[np.bincount(octant, weight, OCTANTS) < 0.01 * weight.sum()] = np.nan
    return FrameResidual(value[:2], sd[:2], value[2:], sd[2:], by_world, by_body, mean)


def side(found: list[RecordStretch]) -> Side | None:
    """Even and odd part of the residual turning rate while the joints move; None without a pose."""
    found = [s for s in found if s.beats]
    if len(found) < 4:
        return None
    turning = np.array([s.turning for s in found])
    spin = np.array([s.spin for s in found])
    weight = np.array([s.spin_weight for s in found])
    columns = np.stack([np.ones(len(found)), turning], 1)[:, None]
    both = turning.std() > TURNS
    value, sd = _fit(columns if both else columns[..., :1], spin[:, None], weight, _blocks(found))
    if not both:  # no turns: only the even part can be fitted
        value = np.append(value, 0.0)
        sd = np.append(sd, np.inf)
    means = [float(np.mean(spin[some])) if (some := sign * turning > 0.1).any() else np.nan for sign in (1, -1)]
    return Side(float(value[0]), float(sd[0]), float(value[1]), float(sd[1]), *means)


def _slope(t: np.ndarray, values: np.ndarray) -> float:
    """Slope of the straight line through values, weighted with a Hann window over the stretch."""
    weight = np.sin(np.pi * (t - t[0] + 0.5 * (t[1] - t[0])) / (t[-1] - t[0] + t[1] - t[0])) ** 2
    t = t - weight @ t / weight.sum()
    return float((weight * t) @ values / ((weight * t) @ t))


def _blocks(found: list[RecordStretch]) -> np.ndarray:
    """(n,) index of each stretch's block, 0.. ."""
    keys = [(s.record, s.block) for s in found]
    order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return np.array([order[key] for key in keys])


def _fit(columns: np.ndarray, target: np.ndarray, weight: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted least squares of target (n, d) on columns (n, d, p): values and their standard deviations, by block bootstrap."""
    normal = np.einsum("n,ndp,ndq->npq", weight, columns, columns)
    right = np.einsum("n,ndp,nd->np", weight, columns, target)
    count = int(block.max()) + 1
    sums = np.zeros((count, *normal.shape[1:])), np.zeros((count, right.shape[1]))
    np.add.at(sums[0], block, normal)
    np.add.at(sums[1], block, right)
    ridge = 1e-9 * np.trace(sums[0].sum(0)) * np.eye(normal.shape[1])
    solved = lambda draw: np.linalg.solve(sums[0][draw].sum(0) + ridge, sums[1][draw].sum(0))
    draws = np.random.default_rng(0).integers(0, count, (DRAWS, count))
    return solved(slice(None)), np.array([solved(d) for d in draws]).std(0)


def _explained(columns: np.ndarray, target: np.ndarray, weight: np.ndarray) -> float:
    """Share of the weighted mean square of the target that the columns explain."""
    value, _ = _fit(columns, target, weight, np.arange(len(target)))
    rest = target - np.einsum("ndp,p->nd", columns, value)
    return float(1.0 - np.sum(weight[:, None] * rest**2) / np.sum(weight[:, None] * target**2))
