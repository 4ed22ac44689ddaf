"""A robot's log as the input of the search: segments that start from estimated states (multiple shooting).

    q(t) ~ a + v (t - s) + ..      local cubic over `half` on either side of a segment's start s: angle a, rate v
    error of the start             root mean square difference to a local quintic: noise, and what a cubic cannot follow
    noise of a joint               residual of the local cubics, median over the starts

A free base (attitude.py) comes first: its place, and its turn from the start of the segment, whose polynomial is in the frame of
the start.

A chaotic arm leaves any model within seconds, so no log is compared as one free run. A segment is a whole number of the windows
of `ResidualLayout`, so no average crosses a start.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import LogError
from fishmj.gap.records import attitude
from fishmj.gap.records.records import WINDOW, Sensor
from fishmj.log import Trial
from fishmj.log.trial import stacked

FILE = "robot.toml"
PAUSE = 0.1  # s without a reading or a steady command, or five usual steps: no segment crosses it
TURN = 3.0  # rad from one reading to the next: the encoder wrapped round


@cache
def assumed(table: str) -> dict[str, float]:
    """Values of one table of data/calib/robot.toml."""
    return {key: entry["value"] for key, entry in read_toml(calib_folder() / FILE)[table].items()}


NO_TURNS = np.zeros((0, 4))  # of a fixed base


class RobotRecord(NamedTuple):
    """One log. The fields from `pose` on are those of a fish's `Record` that a robot's log does not have."""

    name: str
    excitation: str
    replicate_of: str
    dt: float  # s, the model's step
    sent: np.ndarray  # (n,) s
    commands: np.ndarray  # (n, A) as sent, by actuator
    joint: Sensor  # rad or m, by joint, after the six coordinates of a free base; readings within segments only
    starts: np.ndarray  # (S,) s
    length: float  # s of a segment
    angles: np.ndarray  # (S, J) at the starts
    rates: np.ndarray  # (S, J)
    accelerations: np.ndarray  # (S, J)
    angle_error: np.ndarray  # (J,)
    rate_error: np.ndarray  # (J,)
    channels: Mapping[str, tuple[str, ...]]  # names of the joints, as the residual's channels
    turns: np.ndarray = NO_TURNS  # (K, 4) attitude of a free base at the readings
    start_turns: np.ndarray = NO_TURNS  # (S, 4) at the starts
    pose: None = None
    power: None = None
    placed: None = None
    weighed: None = None
    push_sigma: tuple[float, ...] = (0.0, 0.0, 0.0)
    session: float = 0.0
    medium: str = "air"

    @property
    def mark(self) -> int:
        """Hash of commands, stamps and starts, since a changed record keeps its name."""
        arrays = [self.sent, self.commands, self.joint.t, self.starts, self.angles, self.rates, self.accelerations]
        arrays += [self.turns, self.start_turns]
        return hash((self.length, *(a.tobytes() for a in arrays)))

    def beside(self, told: np.ndarray, rows: slice) -> np.ndarray:
        """(R, n, J) readings at some rows, from a base's place and quaternion and joints (R, n, J + 1); of joints alone, them.

        Measured less predicted is then the rotation vector from the predicted attitude to the measured one.
        """
        if not len(self.turns):
            return told
        turn = attitude.rotation_vector(told[..., 3:7], self.turns[rows])
        return np.concatenate([told[..., :3], self.joint.values[rows, 3:6] + turn, told[..., 7:]], -1)

    @property
    def seconds(self) -> float:
        """Length of what is compared."""
        return self.length * len(self.starts)


def robot_record(trial: Trial, dt: float, joints: tuple[str, ...]) -> RobotRecord:
    """Cuts one log into segments and estimates their start states. dt: the model's step [s]. joints: `RobotDescription.channels`.

    Raises LogError: no commands or positions, another number of joints, or no segment without a pause.
    """
    for table, what in (("cmd", "commands"), ("joint", "positions")):
        if table not in trial.tables or not len(trial.table(table)["t"]):
            raise LogError(f"log {trial.name}: no {what}; a search needs commands and joint positions")
    cmd, moved = trial.table("cmd"), trial.table("joint")
    begin = max(float(cmd["t"][0]), float(moved["t"][0]))
    t, q, turns, begins = np.asarray(moved["t"], float) - begin, stacked(moved, "j#"), NO_TURNS, NO_TURNS
    free = attitude.has_base(joints)
    if free:
        if missing := [c for c in (*attitude.PLACE, *attitude.QUATERNION) if c not in moved]:
            raise LogError(f"log {trial.name}: no column {missing[0]} of the base's pose; the model has a free base")
        turns = np.stack([moved[c] for c in attitude.QUATERNION], 1)
        place = np.stack([moved[c] for c in attitude.PLACE], 1)
        q = np.concatenate([place, np.zeros_like(place), q], 1)  # turns are filled in from each start
    if q.shape[1] != len(joints):
        raise LogError(f"log {trial.name}: positions of {q.shape[1]} joints; the model has {len(joints)}: {', '.join(joints)}")
    keep = np.isfinite(q).all(1) & (np.isfinite(turns).all(1) if free else True)
    t, q, turns = t[keep], q[keep], turns[keep] if free else turns
    if len(t) < 2 or not np.all(np.diff(t) > 0):
        raise LogError(f"log {trial.name}: stamps of positions do not increase; sort the rows and remove duplicates")
    own = q[:, 6:] if free else q
    if np.abs(np.diff(own, axis=0)).max(initial=0.0) > TURN:
        own[:] = np.unwrap(own, axis=0)
    segments, window = assumed("segments"), WINDOW["joint"]
    step = float(np.median(np.diff(t)))
    half = max(segments["half"], 0.5 * step * (segments["fewest"] + 1))
    length = window * round(segments["length"] / window)
    first = window * np.ceil(max(half, t[0] + half) / window)
    starts = np.arange(first, t[-1] - length, length)
    sent = np.asarray(cmd["t"], float) - begin
    steady = len(sent) > 1 and np.quantile(np.diff(sent), 0.75) < 1.5 * np.median(np.diff(sent))  # no commands by event
    pauses = np.concatenate([pauses_in(t), *([pauses_in(sent)] if steady else [])])
    whole = [s for s in starts if not np.any((pauses[:, 1] > s - half) & (pauses[:, 0] < s + length))]
    if not whole:
        whole_log = f"{t[-1] - t[0]:.2g} s with {len(pauses)} pauses"
        raise LogError(f"log {trial.name}: no {length:g} s without a pause in {whole_log}; record a new log")
    starts = np.array(whole)
    inside = np.searchsorted(starts, t, side="right") - 1
    used = (inside >= 0) & (t < starts[np.maximum(inside, 0)] + length)
    if free:
        begins = np.stack([_attitude_at(t, turns, s, half) for s in starts])
    fits, finer = [], []
    for k, s in enumerate(starts):
        rows = _near(t, s, half)
        mine = q[rows]
        if free:
            mine = np.concatenate([mine[:, :3], attitude.rotation_vector(turns[rows], begins[k]), mine[:, 6:]], 1)
        fits.append(_local(t[rows], mine, s, half, degree=3))
        finer.append(_local(t[rows], mine, s, half, degree=5))
    values = np.stack([fit.values for fit in fits])  # (S, 4.., J)
    wider = np.stack([fit.values for fit in finer])
    error = np.sqrt(np.mean((values[:, :2] - wider[:, :2]) ** 2, 0))
    sigma = np.maximum(np.median(np.stack([fit.residual for fit in fits]), 0), 1e-9)
    spread = np.stack([fit.spread[:2] for fit in fits]).mean(0)[:, None] * sigma
    if free:
        begins = attitude.turned(begins, values[:, 0, 3:6])
        values[:, 0, 3:6] = 0.0
        q[:, 3:6] = attitude.rotation_vector(turns, begins[np.maximum(inside, 0)])
    return RobotRecord(
        name=trial.name,
        excitation=str(trial.value("excitation", "") or ""),
        replicate_of=str(trial.value("replicate_of", "") or ""),
        dt=dt,
        sent=sent,
        commands=stacked(cmd, "c#"),
        joint=Sensor(t[used], q[used], sigma),
        starts=starts,
        length=length,
        angles=values[:, 0],
        rates=values[:, 1],
        accelerations=2.0 * values[:, 2],
        angle_error=np.maximum(error[0], spread[0]),
        rate_error=np.maximum(error[1], spread[1]),
        channels={"joint": joints},
        turns=turns[used] if free else turns,
        start_turns=begins,
    )


def pauses_in(t: np.ndarray) -> np.ndarray:
    """(K, 2) s: begin and end of each pause in stamps (T,)."""
    late = np.flatnonzero(np.diff(t) > max(PAUSE, 5.0 * float(np.median(np.diff(t)))))
    return np.stack([t[late], t[late + 1]], 1)


def _near(t: np.ndarray, at: float, half: float) -> slice:
    """Rows that a local fit may take."""
    return slice(*np.searchsorted(t, [at - 4.0 * half, at + 4.0 * half]))


def _attitude_at(t: np.ndarray, turns: np.ndarray, at: float, half: float) -> np.ndarray:
    """(4,) attitude at a time: a local cubic of the rotation vector from the nearest reading."""
    k, rows = int(np.clip(np.searchsorted(t, at), 0, len(t) - 1)), _near(t, at, half)
    fit = _local(t[rows], attitude.rotation_vector(turns[rows], turns[k]), at, half, degree=3)
    return attitude.turned(turns[k], fit.values[0])


def robot_records(trials: Sequence[Trial], dt: float, joints: tuple[str, ...]) -> list[RobotRecord]:
    """The logs of one search. Raises LogError."""
    return thinned([robot_record(trial, dt, joints) for trial in trials], int(assumed("segments")["most"]))


def thinned(records: list[RobotRecord], most: int) -> list[RobotRecord]:
    """The records with at most `most` segments in total, spread evenly: the cost of a search is proportional to them."""
    total = sum(len(r.starts) for r in records)
    return [_some_of(r, max(1, round(len(r.starts) * most / total))) for r in records] if total > most else records


def _some_of(record: RobotRecord, count: int) -> RobotRecord:
    """The record with `count` of its segments."""
    kept = np.unique(np.linspace(0, len(record.starts) - 1, count).round().astype(int))
    place = np.searchsorted(record.starts, record.joint.t, side="right") - 1
    rows = np.isin(place, kept)
    joint = record.joint._replace(t=record.joint.t[rows], values=record.joint.values[rows])
    some = {name: getattr(record, name)[kept] for name in ("starts", "angles", "rates", "accelerations")}
    if len(record.turns):
        some |= {"turns": record.turns[rows], "start_turns": record.start_turns[kept]}
    return record._replace(joint=joint, **some)


class _LocalFit(NamedTuple):
    """Polynomial about a time."""

    values: np.ndarray  # (degree + 1, J) coefficients
    residual: np.ndarray  # (J,) standard deviation
    spread: np.ndarray  # (degree + 1,) standard deviation of a coefficient for unit noise


def _local(t: np.ndarray, q: np.ndarray, at: float, half: float, degree: int) -> _LocalFit:
    """Least squares polynomial about a time."""
    rows = slice(*np.searchsorted(t, [at - half, at + half]))
    x = (t[rows] - at) / half
    if len(x) <= degree:  # a slow log: the nearest readings
        rows = slice(max(0, rows.start - degree), rows.stop + degree)
        x = (t[rows] - at) / half
    a = np.vander(x, min(degree, len(x) - 1) + 1, increasing=True)
    found, *_ = np.linalg.lstsq(a, q[rows], rcond=None)
    left = np.sum((q[rows] - a @ found) ** 2, 0) / max(len(x) - a.shape[1], 1)
    units = half ** -np.arange(a.shape[1])
    spread = np.sqrt(np.diag(np.linalg.pinv(a.T @ a))) * units
    pad = degree + 1 - a.shape[1]
    values = np.pad(found * units[:, None], ((0, pad), (0, 0)))
    return _LocalFit(values, np.sqrt(left), np.pad(spread, (0, pad)))
