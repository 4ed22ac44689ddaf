"""A trial as the input of the search, and its comparison with a model.

Record           every measurement at its own time stamps, without resampling. Commands are held until the next one, as in the
                 servo; a model's step in which one arrives gets the mean over the step
ResidualLayout   short averages of every channel, measured minus predicted, as one long vector

A fast channel is averaged over 60 ms, a slow one over 0.2 s: less noise, without loss for a beat of 3 Hz. Heading and
position are whole free runs from the known start, so accumulated errors show. The covariance of the null (null/whitening.py)
accounts for the uncertainty of late times and the correlation of neighbouring values.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log import Trial
from fishmj.log.trial import stacked

MEDIA = ("water", "air")
REST = 0.3  # s of rest at the start, at most, over which the start pose is averaged
TINY = 1e-9  # s, to exclude the first row that moved from the rest
STILL = np.radians(2.0)  # a command or a joint that has moved by this no longer rests
NOISE = 6.0  # standard deviations of an encoder up to which a change is no movement
SWIMS = 0.15  # m/s, largest speed at the first row: a model starts at rest, or with the stated push
LATE = 0.5  # s after the first joint motion by which joints and pose must be measured, since the model starts there
LOST, JUMP = 0.25, 3.0  # s of a pause in steady commands; change over the pause, in usual steps, that means lost rows
OLDEST = 1.0  # s, largest age of a pose at its stamp
LONGEST = 3600.0  # s, largest length of a record; longer means clocks with different zeros
MOVING = 0.09  # s after the first motion in which the camera, by its delay, still shows the rest


class Sensor(NamedTuple):
    """One clock's measurements. values: (K, C) at stamps t (K,) [s since the record's start]; sigma: (C,) noise, NaN unknown."""

    t: np.ndarray
    values: np.ndarray
    sigma: np.ndarray


class Record(NamedTuple):
    """One trial, ready to be predicted."""

    name: str
    excitation: str
    replicate_of: str
    dt: float  # s, the model's step
    commands: np.ndarray  # (T, J) rad, mean over each of the model's steps
    joint: Sensor | None  # rad, J columns
    pose: Sensor | None  # x, y m, yaw rad unwrapped
    power: Sensor | None  # W, one column
    flow: tuple[float, float]  # what the log says of the mean current, m/s, tank frame
    medium: str  # water or air
    place: np.ndarray  # (3,) pose at which it was meant to start
    start: np.ndarray  # (3,) pose at t = 0, measured
    push: np.ndarray  # (3,) surge, sway [m/s], yaw rate [rad/s] at t = 0
    joints: np.ndarray  # (J,) angles at t = 0, rad
    session: float  # s since the session began
    placed: Sensor | None = None  # x, y m, yaw rad that the camera measures of the fish at rest at `place`
    stated: Mapping[str, float] = MappingProxyType({})  # noise of each column as the log states it, in the column's unit
    push_sigma: tuple[float, ...] = (0.0, 0.0, 0.0)  # standard deviation of `push`
    weighed: Sensor | None = None  # kg, m, kg m2: mass, balance point, yaw inertia of the straight fish (mass_properties.py)

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return max(float(s.t[-1]) for s in (self.joint, self.pose, self.power) if s is not None)


def record_of(trial: Trial, dt: float, camera: float | None = None) -> Record:
    """Reads one trial.

    camera: age [s] of a pose at its stamp that the model assumes; a log's own `latency.pose` replaces it.

    Raises LogError: missing or lost commands, missing or late measurements, different numbers of joints, clocks with different
    zeros, a fish that moves at the first row, or meta data that are not numbers.
    """
    if "cmd" not in trial.tables:
        raise LogError(f"trial {trial.name}: no table cmd; a search needs the commands")
    cmd = trial.table("cmd")
    begin, c = float(cmd["t"][0]), stacked(cmd, "c#")
    joint = _sensor(trial, "joint", begin, lambda t: stacked(t, "j#"), [f"j{i + 1}" for i in range(c.shape[1])])
    age = age_of_poses(trial)
    later = 0.0 if camera is None or age is None else camera - age
    pose = _sensor(trial, "pose", begin - later, _pose, ["x", "y", "yaw"])
    power = _sensor(trial, "power", begin, _power, ["power"]) if "I" in trial.tables.get("power", {}) else None
    if joint is None and pose is None:
        raise LogError(f"trial {trial.name}: neither joint nor pose was measured; nothing can be compared")
    if joint is not None and joint.values.shape[1] != c.shape[1]:
        counts = f"{c.shape[1]} joints were commanded but {joint.values.shape[1]} measured"
        raise LogError(f"trial {trial.name}: {counts}; give cmd and joint a column for each")
    end = max(float(s.t[-1]) for s in (joint, pose, power) if s is not None)
    if end > LONGEST:
        late = f"the last measurement is {end:.4g} s after the first command, at most {LONGEST:g} s are compared"
        raise LogError(f"trial {trial.name}: {late}; do all tables have the same time zero?")
    steps = int(np.ceil(end / dt)) + 1
    push = _three(trial, "push", (0.0, 0.0, 0.0))
    still = _still(cmd["t"] - begin, c, joint)
    _refuse_late(trial.name, {"joint": joint, "pose": pose}, still)
    _refuse_lost(trial.name, cmd["t"] - begin, c, joint)
    begins = _first(pose, 3, MOVING if push.any() else min(REST, still + MOVING))
    if pose is not None and not push.any():
        _at_rest(trial.name, pose, min(REST, still + MOVING))
    place = None if trial.value("start", None) is None else _three(trial, "start", ())
    speed, bearing, session = (_finite(trial, key) for key in ("flow.speed", "flow.direction", "session_time"))
    medium = str(trial.value("medium", "water"))
    if medium not in MEDIA:
        raise LogError(f"trial {trial.name}: medium = {medium[:40]!r}; expected one of {', '.join(MEDIA)}")
    return Record(
        name=trial.name,
        excitation=str(trial.value("excitation", "") or ""),
        replicate_of=str(trial.value("replicate_of", "") or ""),
        dt=dt,
        commands=_mean_commands(cmd["t"] - begin, c, steps, dt),
        joint=joint,
        pose=pose,
        power=power,
        flow=(speed * np.cos(bearing), speed * np.sin(bearing)),
        medium=medium,
        place=begins if place is None else place,
        start=begins,
        push=push,
        push_sigma=tuple(map(abs, _three(trial, "push_sigma", (0.0, 0.0, 0.0)).tolist())),
        joints=_first(joint, c.shape[1], min(REST, still)),
        session=session,
        stated=_stated(trial),
        placed=None if place is None or pose is None or push.any() else _placed(begins, place, pose.sigma),
    )


def age_of_poses(trial: Trial) -> float | None:
    """Age [s] that a log states of a pose at its stamp; None if it states none. Raises LogError: it is none of a camera."""
    if trial.value("latency.pose") is None:
        return None
    if not 0 <= (age := _finite(trial, "latency.pose")) <= OLDEST:
        raise LogError(f"trial {trial.name}: latency.pose = {age:g}; expected the age of a pose at its stamp, 0 to {OLDEST:g} s")
    return age


def _mean_commands(t: np.ndarray, c: np.ndarray, steps: int, dt: float) -> np.ndarray:
    """(steps, J) mean over each step of commands that are held from their stamps on; a stamp within 1 ns of a step begins it."""
    whole = np.ceil((t - TINY) / dt).astype(int)  # the first step that a command fills
    out = c[np.searchsorted(whole, np.arange(steps), side="right") - 1]
    share = whole[1:] - t[1:] / dt  # of the step before
    part = (share * dt > TINY) & (whole[1:] <= steps)
    np.add.at(out, whole[1:][part] - 1, share[part, None] * np.diff(c, axis=0)[part])
    return out


def _refuse_late(name: str, seen: dict[str, Sensor | None], still: float) -> None:
    """Raises LogError if the joints move before a table begins."""
    for table, sensor in seen.items():
        if sensor is not None and sensor.t[0] > still + LATE:
            raise LogError(
                f"trial {name}: {table} begins {sensor.t[0]:.3g} s after the first command, the joints move from"
                f" {max(still, 0):.3g} s on, and a model begins where both are known; do all tables have one time zero? If so,"
                f" begin the commands with the table {table}, while the fish lies still"
            )


def _refuse_lost(name: str, t: np.ndarray, commands: np.ndarray, joint: Sensor | None) -> None:
    """Raises LogError for a pause in steady commands in which the joints move, or after which the commands have jumped.

    If the joints have no row in the pause either, commands that move right before and after it count as lost.
    """
    step, moved = np.diff(t), np.abs(np.diff(commands, axis=0)).max(1)
    if len(step) < 8 or np.quantile(step, 0.75) > 1.5 * np.median(step):
        return
    for i in np.flatnonzero(step > max(LOST, 5 * np.median(step))):
        seen = np.zeros((0, 1)) if joint is None else joint.values[(joint.t > t[i] + REST) & (joint.t < t[i + 1])]
        beside = commands[(t >= t[i] - LOST) & (t <= t[i])], commands[(t >= t[i + 1]) & (t <= t[i + 1] + LOST)]
        swings = np.ptp(seen, 0).max() > 2 * STILL if len(seen) > 1 else min(np.ptp(c, 0).max() for c in beside) > 2 * STILL
        if swings or moved[i] > JUMP * max(np.quantile(moved, 0.9), STILL):
            raise LogError(
                f"trial {name}: no commands for {step[i]:.3g} s from t = {t[i]:.4g} s on, and they were not held: rows were lost;"
                " split the trial there (fishmj.log.segments)"
            )


def _sensor(trial: Trial, table: str, begin: float, read, names) -> Sensor | None:
    if table not in trial.tables or not len(trial.table(table)["t"]):
        return None
    rows = trial.table(table)
    values = np.asarray(read(rows), float)
    t = np.asarray(rows["t"], float) - begin
    keep = (t >= 0) & np.isfinite(values).all(1)
    sigma = np.array([_stated(trial).get(n, np.nan) for n in names])
    return Sensor(t[keep], values[keep], sigma) if keep.any() else None


def _pose(rows) -> np.ndarray:
    return np.stack([rows["x"], rows["y"], np.unwrap(np.asarray(rows["yaw"], float))], 1)


def _placed(begins: np.ndarray, place: np.ndarray, sigma: np.ndarray) -> Sensor:
    """The camera's pose of a fish that was put at `place`. sigma excludes the error of placing, which null runs have."""
    turn = np.angle(np.exp(1j * (begins[2] - place[2])))
    return Sensor(np.zeros(1), np.array([[*begins[:2], place[2] + turn]]), sigma)


def _stated(trial: Trial) -> dict[str, float]:
    """Column -> noise that the log states, without invalid values."""
    given = trial.value("sigma", {})
    number = lambda v: isinstance(v, int | float) and not isinstance(v, bool) and 0 <= v < np.inf
    return {str(name): float(v) for name, v in given.items() if number(v)} if isinstance(given, dict) else {}


def _power(rows) -> np.ndarray:
    return np.asarray(rows["V"] * rows["I"], float)[:, None]


def _finite(trial: Trial, key: str) -> float:
    """A number of the meta data, 0 without one."""
    value = trial.value(key, 0.0) or 0.0
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        raise LogError(f"trial {trial.name}: {key} = {str(value)[:40]!r}; expected a finite number")
    return float(value)


def _three(trial: Trial, key: str, otherwise) -> np.ndarray:
    """(3,) numbers of the meta data."""
    value = trial.value(key, otherwise)
    try:
        found = np.array(value, float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise LogError(f"trial {trial.name}: {key} = {str(value)[:60]!r}; expected three finite numbers")
    return found


def _still(t: np.ndarray, commands: np.ndarray, joint: Sensor | None) -> float:
    """Time from the first command during which neither commands nor joints move, s; without joints, a first command is a move."""
    moves = [t[np.abs(commands - (0.0 if joint is None else commands[0])).max(1) > STILL]]
    if joint is not None:
        least = np.fmax(STILL, NOISE * joint.sigma)
        moves.append(joint.t[(np.abs(joint.values - joint.values[0]) > least).any(1)])
    return min((float(found[0]) for found in moves if len(found)), default=np.inf) - TINY


def _at_rest(name: str, pose: Sensor, rest: float) -> None:
    """Raises LogError if the fish moves in the first rows: logs lack joint rates, so a model cannot start there."""
    rows = pose.t <= rest
    if rows.sum() < 3:
        return
    t, seen = pose.t[rows] - pose.t[rows].mean(), pose.values[rows]
    spread = float(np.sqrt(np.sum(t**2)))
    if not spread:
        return
    speed = float(np.hypot(*(t @ seen[:, :2]) / spread**2))
    noise = float(np.nan_to_num(pose.sigma[:2]).max()) / spread
    if speed > SWIMS + NOISE * noise:
        raise LogError(
            f"trial {name}: the fish moves at {speed:.2g} m/s at the first row without a stated push; a model starts at rest. "
            "Begin the record where the fish is still; if a carriage launches it, state push in meta.toml"
        )


def _first(sensor: Sensor | None, size: int, rest: float) -> np.ndarray:
    """Mean over the first moments."""
    if sensor is None:
        return np.zeros(size)
    return sensor.values[sensor.t <= max(rest, float(sensor.t[0]))].mean(0)


WINDOW = {"joint": 0.06, "pose": 0.2, "power": 0.2, "placed": 0.2, "weighed": 0.2}  # s
CHANNELS = {
    "joint": ("joint",),
    "pose": ("position", "position", "heading"),
    "power": ("power",),
    "placed": ("start",) * 3,
    "weighed": ("weighing",) * 3,
}


class ChannelBlock(NamedTuple):
    """A part of the vector: one column of one sensor of one record."""

    record: int
    sensor: str
    column: int
    channel: str  # joint, position, heading, power, start, weighing; of a robot in MJCF: the name of the joint
    t: np.ndarray  # (n,) middle of each average, s
    window: np.ndarray  # (n,) number of each average since t = 0
    where: slice  # in the vector
    first: np.ndarray  # (n,) first stamp of each average
    counts: np.ndarray  # (n,)
    sigma: float  # of one measurement, NaN unknown


class ResidualLayout:
    """Layout of the residual vector for a set of records. `size` is the length of the vector."""

    def __init__(self, records: Sequence[Any]):
        self.records, self.blocks, self.size = list(records), [], 0
        for i, record in enumerate(records):
            names = CHANNELS | dict(getattr(record, "channels", {}))
            for sensor in WINDOW:
                given = getattr(record, sensor, None)
                if given is None:
                    continue
                number = np.floor(given.t / WINDOW[sensor]).astype(int)
                window, first, counts = np.unique(number, return_index=True, return_counts=True)
                t = np.add.reduceat(given.t, first) / counts
                for column in np.flatnonzero(np.isfinite(given.values).any(0)).tolist():
                    channel = names[sensor][column % len(names[sensor])]
                    where = slice(self.size, self.size + len(counts))
                    sigma = float(given.sigma[column])
                    self.blocks.append(ChannelBlock(i, sensor, column, channel, t, window, where, first, counts, sigma))
                    self.size = where.stop
        self.record = np.concatenate([np.full(len(b.t), b.record) for b in self.blocks])
        self.channel = np.concatenate([np.full(len(b.t), b.channel) for b in self.blocks])

    @property
    def measured(self) -> np.ndarray:
        """(size,) the averages themselves."""
        zero = lambda record: {s: np.zeros((1, *x.values.shape)) for s in WINDOW if (x := getattr(record, s, None)) is not None}
        return self.residuals([zero(record) for record in self.records])[0]

    def residuals(self, predictions: list[dict]) -> np.ndarray:
        """(R, size) measured minus predicted; predictions of `model.predict` for these records."""
        rows = len(next(iter(predictions[0].values())))
        out = np.empty((rows, self.size))
        for b in self.blocks:
            measured = getattr(self.records[b.record], b.sensor).values[:, b.column]
            values = measured - predictions[b.record][b.sensor][:, :, b.column]
            out[:, b.where] = np.add.reduceat(values, b.first, axis=1) / b.counts
        return out

    def aligned(self, other: "ResidualLayout", vector: np.ndarray) -> np.ndarray:
        """A vector of `other` (same experiments, other stamps) in this layout's windows.

        A window that `other` lacks is interpolated linearly from its neighbours.
        """
        out = np.empty(self.size)
        for mine, theirs in zip(self.blocks, other.blocks, strict=True):
            out[mine.where] = np.interp(mine.window, theirs.window, vector[theirs.where])
        return out

    def noise(self) -> np.ndarray:
        """(size,) standard deviation of the averages from the sensors' own noise, NaN where unknown."""
        out = np.empty(self.size)
        for b in self.blocks:
            out[b.where] = b.sigma / np.sqrt(b.counts)
        return out


LEAD, PACE = 2.0, 1.0  # s skipped at the start, and between two positions that give a speed


def mean_speed_and_yaw_rate(t: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
    """(mean speed from positions one second apart, m/s; mean yaw rate, rad/s) after the first two seconds.

    Args:
        t: (K,) s. pose: (K, 3) m, m, rad unwrapped.
    """
    begin = min(LEAD, 0.5 * t[-1])
    marks = np.arange(begin, t[-1] + 1e-9, min(PACE, 0.5 * (t[-1] - begin)))
    x, y, yaw = (np.interp(marks, t, column) for column in pose.T)
    return float(np.hypot(np.diff(x), np.diff(y)).sum() / np.ptp(marks)), float((yaw[-1] - yaw[0]) / np.ptp(marks))
