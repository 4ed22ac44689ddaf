"""Growth curves of the gap: error over time after frequent restarts of the model from measured states.

    e(H) = rms over restarts of measured(t0 + H) - model(t0 + H | measured state at t0),   H in HORIZONS
    slope of log e over log H: 0 a sensor, 1 a velocity (current, delay), 2 a force

The state at t0 is a parabola through the stamps of poses and angles around it, less their latency (camera, and that of the row's
effects). The error from the uncertainty of that state is subtracted in squares. A restart shows how an error begins; a free run
shows only its accumulated result.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.records.records import Record, Sensor

HORIZONS = (0.1, 0.3, 1.0, 3.0)  # s
EVERY = 0.4  # s between restarts
AROUND = 0.05  # s to either side of a horizon over which errors are averaged
HALF = {"joint": 0.06, "pose": 0.1}  # s to either side of a start, for the parabola fit
CHANNELS = {"joint": "rad", "position": "m", "heading": "rad"}
DRAWS = 200


class StampAges(NamedTuple):
    """Ages of measured values at their stamps, s, and the delay from a command to the servo, s."""

    command: float
    joint: float
    pose: float


class RestartState(NamedTuple):
    """A measured state: value and rate with their standard deviations, (C,) each."""

    value: np.ndarray
    rate: np.ndarray
    value_sd: np.ndarray
    rate_sd: np.ndarray


class GrowthSegment(NamedTuple):
    """Part of a record that starts in motion. swing: (J,) joint rates at its start, rad/s; joint, pose: states there."""

    record: Record
    swing: np.ndarray
    joint: RestartState
    pose: RestartState


@dataclass(frozen=True)
class GrowthCurve:
    """Growth curve of one channel.

    before, after, start: (H,) rms error of the present model, of the model with the found effects, and the largest error from
    the uncertainty of the start. slope, low, high: growth of the part that the found effects explain, or of the whole error if
    there are none, with a 90 % interval; NaN if it does not exceed the error of the start.
    """

    channel: str
    unit: str
    horizons: tuple[float, ...]
    before: np.ndarray
    after: np.ndarray
    start: np.ndarray
    restarts: int
    slope: float
    low: float
    high: float

    @property
    def kind(self) -> str:
        """Kind of growth in words; "not told" if the slope is too uncertain to decide."""
        if not np.isfinite(self.slope) or self.high - self.low > 1.5:
            return "not told"
        names = ("there at once", "like a velocity", "like a force")
        whole = int(np.clip(np.floor(self.slope + 0.35), 0, 2))
        if self.slope - whole > 0.35 and whole < 2:
            return ("between offset and velocity", "between velocity and force")[whole]
        return names[whole]


class RestartedModel(SwimmingFish):
    """A fish that starts in motion, with delayed commands pending."""

    def __init__(self, model: SwimmingFish, segments: list[GrowthSegment], late: StampAges):
        self.__dict__.update(model.__dict__)
        self.latency = model.latency - late.command  # cut() has shifted the commands already
        self.swings = {s.record.name: s.swing for s in segments}

    def _starts(self, record: Record, effect_rows) -> np.ndarray:
        state = super()._starts(record, effect_rows)
        nv = self.joints + 3
        state[:, nv + 3 : 2 * nv] = self.swings[record.name]
        return state


def latencies(model: SwimmingFish, row: np.ndarray) -> StampAges:
    """Latencies of a parameter row: nominal ones plus those of its effects."""
    values = list(row[len(model.constants) :])
    command, joint, pose = (float(model.active.delay(np, values, clock)) for clock in ("command", "joint", "pose"))
    return StampAges(model.latency + command, joint, model.camera + pose)


def cut(record: Record, t0: float, seconds: float, late: StampAges) -> GrowthSegment | None:
    """Part of a record from t0 on, with the state measured there; None if there are too few stamps.

    t0: physical time, s since the record's start; stamps are later by `late`.
    """
    if record.joint is None or record.pose is None:
        return None
    joint, pose = (state_at(s, t0 + wait, HALF[n]) for s, n, wait in _clocks(record, late))
    if joint is None or pose is None:
        return None
    x, y, yaw = pose.value
    vx, vy, r = pose.rate
    c = np.cos(yaw)
    s = np.sin(yaw)
    steps = int(np.ceil((seconds + max(late)) / record.dt)) + 1
    place = np.clip((t0 - late.command) / record.dt + np.arange(steps), 0, len(record.commands) - 1)
    i = np.minimum(place.astype(int), len(record.commands) - 2)
    commands = record.commands[i] + (place - i)[:, None] * (record.commands[i + 1] - record.commands[i])
    part = record._replace(
        name=f"{record.name}@{t0:.3f}",
        commands=commands,
        joint=_later(record.joint, t0, seconds + late.joint),
        pose=_later(record.pose, t0, seconds + late.pose),
        power=None,
        start=pose.value,
        place=pose.value,
        push=np.array([c * vx + s * vy, c * vy - s * vx, r]),
        joints=joint.value,
        session=record.session + t0,
    )
    return GrowthSegment(part, joint.rate, joint, pose)


def state_at(sensor: Sensor, t: float, half: float) -> RestartState | None:
    """State from a parabola fit to the readings within `half` s of t; None if fewer than five, or none on one side."""
    some = np.abs(sensor.t - t) <= half
    if some.sum() < 5 or sensor.t[some][0] > t - 0.4 * half or sensor.t[some][-1] < t + 0.4 * half:
        return None
    columns = np.vander(sensor.t[some] - t, 3, increasing=True)
    inverse = np.linalg.inv(columns.T @ columns)
    fit = inverse @ columns.T @ sensor.values[some]
    rest = sensor.values[some] - columns @ fit
    sigma = np.where(np.isfinite(sensor.sigma), sensor.sigma, np.sqrt(np.sum(rest**2, 0) / (some.sum() - 3)))
    return RestartState(fit[0], fit[1], sigma * np.sqrt(inverse[0, 0]), sigma * np.sqrt(inverse[1, 1]))


def _clocks(record: Record, late: StampAges):
    return ((record.joint, "joint", late.joint), (record.pose, "pose", late.pose))


def _later(sensor: Sensor, t0: float, until: float) -> Sensor:
    some = (sensor.t >= t0) & (sensor.t <= t0 + until + AROUND)
    return Sensor(sensor.t[some] - t0, sensor.values[some], sensor.sigma)


def segments(records: list[Record], late: StampAges, every: float = EVERY) -> list[tuple[int, GrowthSegment]]:
    """Restarts of all records: (record, segment), as long as the record allows, up to the longest horizon."""
    out = []
    for i, record in enumerate(records):
        for t0 in np.arange(every, record.seconds - HORIZONS[0] - AROUND - max(late), every):
            seconds = min(HORIZONS[-1], record.seconds - t0 - max(late) - AROUND)
            found = cut(record, float(t0), float(seconds), late)
            if found is not None:
                out.append((i, found))
    return out


def errors(model: SwimmingFish, records: list[Record], row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Restarts under one parameter row: record of each (S,), errors (S, H, J + 3), error from the start (S, H, J + 3).

    NaN where a record ends before the horizon.
    """
    # Each row restarts with its own latency. With the nominal one, a row with a delay would start from past states, with an
    # offset that the delay explains.
    late = latencies(model, row)
    found = segments(records, late)
    if not found:
        return np.zeros(0, int), *np.zeros((2, 0, len(HORIZONS), model.joints + 3))
    parts = [s for _, s in found]
    predictions = RestartedModel(model, parts, late).predict([s.record for s in parts], row)
    error = np.full((len(parts), len(HORIZONS), model.joints + 3), np.nan)
    start = np.full_like(error, np.nan)
    for s, (part, predicted) in enumerate(zip(parts, predictions, strict=True)):
        for sensor, name, wait in _clocks(part.record, late):
            columns = slice(0, model.joints) if name == "joint" else slice(model.joints, None)
            state = getattr(part, name)
            rest = sensor.values - predicted[name][0]
            for h, horizon in enumerate(HORIZONS):
                some = np.abs(sensor.t - wait - horizon) <= AROUND
                # Averaged around the horizon: the noise of a single reading would hide the errors of the first tenth of a second,
                # which distinguish an offset from a velocity.
                if some.sum() >= 3 and sensor.t[-1] >= wait + horizon:
                    error[s, h, columns] = rest[some].mean(0)
                    moved = horizon if name == "pose" else 0.0  # a servo's error from its start decays
                    start[s, h, columns] = np.sqrt(state.value_sd**2 * (1 + 1 / some.sum()) + (moved * state.rate_sd) ** 2)
    return np.array([i for i, _ in found]), error, start


def curves(model: SwimmingFish, records: list[Record], before: np.ndarray, after: np.ndarray) -> tuple[GrowthCurve, ...]:
    """Growth of each channel's error; empty if no record can be cut (no pose, no joints, stamps too far apart)."""
    if not isinstance(model, SwimmingFish):
        return ()
    owner, first, start = errors(model, records, before)
    if not len(owner):
        return ()
    other, second, _ = (owner, first, start) if np.array_equal(before, after) else errors(model, records, after)
    changed = other is not owner
    out = []
    for channel, unit in CHANNELS.items():
        columns = {"joint": slice(0, model.joints), "position": slice(model.joints, -1), "heading": slice(-1, None)}[channel]
        one, two = (_squares(e[..., columns], channel) for e in (first, second))
        made = _squares(start[..., columns], channel)
        rms = [np.sqrt(_mean(sq, np.ones(len(sq)))) for sq in (one, two, made)]
        slope, low, high = _slope(owner, one, other, two, made, changed)
        out.append(GrowthCurve(channel, unit, HORIZONS, rms[0], rms[1], rms[2], len(owner), slope, low, high))
    return tuple(out)


def _squares(error: np.ndarray, channel: str) -> np.ndarray:
    """(S, H) mean over joints, sum over x and y."""
    return np.sum(error**2, -1) if channel == "position" else np.mean(error**2, -1)


def _mean(squares: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(H,) weighted mean of the restarts (S, H) that reach a horizon; NaN where none does."""
    count = np.sum(np.isfinite(squares) * weights[:, None], 0)
    return np.divide(np.nansum(squares * weights[:, None], 0), count, out=np.full(count.shape, np.nan), where=count > 0)


def _slope(owner, one, other, two, made, changed: bool) -> tuple[float, float, float]:
    """Slope of log error over log H with its 90 % interval, resampling records."""
    records = np.unique(owner)
    rng = np.random.default_rng(0)

    def of(weights: np.ndarray) -> float:
        # The bootstrap draws records, not restarts, because restarts of one record share constants and commands.
        mean = lambda sq, who: _mean(sq, weights[who])
        # Squares are subtracted, because the error from the start, or the remaining error with the found effects, is
        # independent of the effects' contribution. Below a fifth of the whole the difference is mostly noise.
        square = mean(one, owner) - (mean(two, other) if changed else mean(made, owner))
        floor = 0.2 * mean(one, owner)
        good = np.isfinite(square) & (square > floor)
        if good.sum() < 2:
            return float("nan")
        return float(np.polyfit(np.log(np.array(HORIZONS)[good]), 0.5 * np.log(square[good]), 1)[0])

    size = int(max(owner.max(), other.max())) + 1
    slopes = np.array([of(np.bincount(rng.choice(records, len(records)), minlength=size).astype(float)) for _ in range(DRAWS)])
    slopes = slopes[np.isfinite(slopes)]
    whole = of(np.ones(size))
    low, high = np.quantile(slopes, [0.05, 0.95]) if len(slopes) > DRAWS // 2 else (np.nan, np.nan)
    return whole, float(low), float(high)
