"""The trial folder of a swim: every requested and sent command, every packet and fix, each with its own stamps.

    cmd      t sent; c# as sent; asked# as requested by the policy or the experiment; seq; state of the supervisor
    joint    t; j#, temp#; seq and echo (-1: none), t_robot, t_rx
    pose     t; x, y, yaw, quality; t_taken, t_rx
    power    t; V, I
    obs, action, target

`t` is the host's clock, s from the first row. If the robot has a clock, t of `joint` and `power` is that clock's time of
measurement, shifted to the host's clock: even. The shift is that of the quickest answer to a question (`links.RobotClock`, half
of its round trip each way), else the least t_rx - t_robot, which is late by the radio's way up.

A fix is stamped at its arrival, as the schema asks: its own time plus the median latency, which `latency.pose` in
meta.toml holds.

Every few seconds a thread appends the new rows to a journal on disk (`journal`), which becomes the folder at the end. So a long
swim takes no more memory and time a second than a short one, and a killed process loses only the rows since the last time.
"""

import shutil
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fishmj.base.errors import FishmjError, LogError, StoreError
from fishmj.deploy.loop.journal import Journal, left
from fishmj.deploy.loop.observation import Pose
from fishmj.deploy.loop.supervisor import Condition, Event, named
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.log import Table, Trial, write_trial
from fishmj.log.trial_check import PLAUSIBLE, Plausible

EVERY = 2.0  # s between two writings
FIRST = 500  # rows that a table has room for: four seconds, and more where the disk refuses
UNDER_WAY = "under way, or its host was killed: fishmj deploy recover FOLDER makes a trial of its journal"
KILLED = "ended: its host was killed; recovered from the journal"
ALL_BOUNDS = [field.name for field in fields(Plausible)]
LEAST = {"voltage_least": 1e-30, "current_least": 1e-30}


class Listener(Protocol):
    """Interface for further receivers of the log's rows; no call may wait."""

    def command(self, t: float, joint: np.ndarray) -> None:
        """Receives a sent command."""

    def heard(self, t: float, packet: Telemetry) -> None:
        """Receives a packet of the robot."""

    def fix(self, pose: Pose) -> None:
        """Receives an accepted fix."""

    def event(self, event: Event) -> None:
        """Receives a change of state."""


class RowBuffer:
    """Buffer of rows for the disk: columns of float64, in an array that doubles when it is full."""

    def __init__(self, columns: Sequence[str]):
        self.columns, self.count = tuple(columns), 0
        self._data = np.empty((FIRST, len(self.columns)))

    def add(self, *values: float) -> None:
        """Adds one row, in the order of the columns."""
        if self.count == len(self._data):
            self._data = np.concatenate([self._data, np.empty_like(self._data)])
        self._data[self.count] = values
        self.count += 1

    def waiting(self) -> np.ndarray:
        """(n, C) rows in the buffer."""
        return self._data[: self.count].copy()

    def drop(self, count: int) -> None:
        """Removes the first `count` rows, which are on disk."""
        self._data[: self.count - count] = self._data[count : self.count].copy()
        self.count -= count


def refuse_taken(folder: Path) -> None:
    """Raises StoreError if the folder of a new trial exists already."""
    if folder.exists():
        raise StoreError(f"{folder}: exists; choose another name for the trial")


class TrialLog:
    """One trial folder of a running swim.

    Args:
        folder: must not exist. meta: of the trial; `clock`, `latency` and `host` are added. joints: J.
        every: s between two writings.

    Attributes:
        listeners: receive every command, packet, fix and event, too.
        dropped: rows left out because a value was not finite. failed: error of the last writing, "" if it succeeded.
    """

    def __init__(self, folder: Path, meta: Mapping[str, Any], joints: int, *, every: float = EVERY):
        refuse_taken(folder)
        self.folder, self.meta, self.every = folder, dict(meta), every
        each = lambda letter: [f"{letter}{k + 1}" for k in range(joints)]
        self.joints = joints
        self.rows = {
            "cmd": RowBuffer(["t", *each("c"), *each("asked"), "seq", "state"]),
            "joint": RowBuffer(["t_rx", *each("j"), "seq", "echo", "t_robot", *each("temp")]),
            "pose": RowBuffer(["t_taken", "x", "y", "yaw", "quality", "t_rx"]),
            "power": RowBuffer(["t_rx", "V", "I", "t_robot"]),
            "obs": RowBuffer(["t", *[f"o{k + 1}" for k in range(5 + 2 * joints)]]),
            "action": RowBuffer(["t", *each("a")]),
            "target": RowBuffer(["t", "x", "y"]),
        }
        self.events: list[str] = []
        self.listeners: list[Listener] = []
        self.dropped, self.failed, self.closed, self.discarded = 0, "", False, False
        self._zero: float | None = None
        self._journal: Journal | None = None
        self._lock, self._closing = threading.Lock(), threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "TrialLog":
        self._thread = threading.Thread(target=self._flush, name="log", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.close("" if error is None else f"{kind.__name__}: {error}")

    def command(self, t: float, sent: np.ndarray, asked: np.ndarray, seq: int | None, state: int) -> None:
        """Records a command that was sent at `t`."""
        self._add("cmd", t, *sent, *asked, -1 if seq is None else seq, state)
        for listener in self.listeners:
            listener.command(t, sent)

    def heard(self, t: float, packet: Telemetry) -> None:
        """Records a packet that arrived at `t`."""
        number = lambda value, absent=np.nan: absent if value is None else value
        numbers = number(packet.seq, -1), number(packet.echo, -1)
        warmth = packet.temperature or [np.nan] * self.joints
        self._add("joint", t, *packet.joint, *numbers, number(packet.time), *warmth, may_lack=1 + self.joints)
        volts = packet.voltage
        if volts is None and packet.servo_voltage is not None:
            volts = float(np.mean(packet.servo_voltage))
        if volts is not None:
            self._add("power", t, volts, number(packet.current), number(packet.time), may_lack=2)
        for listener in self.listeners:
            listener.heard(t, packet)

    def fix(self, pose: Pose, quality: float) -> None:
        """Records a fix of the loop."""
        self._add("pose", pose.t, pose.x, pose.y, pose.yaw, quality, pose.heard)
        for listener in self.listeners:
            listener.fix(pose)

    def decided(self, t: float, obs: np.ndarray | None, action: np.ndarray | None) -> None:
        """Records the policy's observation and action at `t`; an action that is not finite becomes an event instead."""
        if obs is not None:
            self._add("obs", t, *obs)
        if action is not None:
            self._add("action", t, *action)

    def target(self, t: float, x: float, y: float) -> None:
        """Records the target position from `t` on, m."""
        self._add("target", t, x, y)

    def event(self, event: Event) -> None:
        """Records a change of the supervisor's state."""
        also = event.conditions & ~event.because & ~Condition.HEARD
        more = f"; also {named(also)}" if also else ""
        for listener in self.listeners:
            listener.event(event)
        self.say(event.t, f"{event.before.name} -> {event.after.name}: {named(event.because) or 'asked'}{more}")

    def say(self, t: float, text: str) -> None:
        """Records a line among the events."""
        self.events.append(f"{t - (self._zero if self._zero is not None else t):.3f} s {text}")

    def _add(self, name: str, t: float, *values: float, may_lack: int = 0) -> bool:
        """Adds one row if its numbers are finite; the last `may_lack` of them may be absent. Returns True if it was added."""
        if not np.isfinite((t, *values[: len(values) - may_lack])).all():
            self.dropped += 1
            return False
        if self._zero is None:
            self._zero = t
        with self._lock:
            self.rows[name].add(t, *values)
        return True

    def trial(self) -> Trial:
        """The trial so far, in the schema. Raises StoreError: the journal cannot be read."""
        with self._lock:
            waiting = {name: rows.waiting() for name, rows in self.rows.items()}
        kept = self._journal.rows() if self._journal is not None else {}
        raw = {name: np.concatenate([kept[name], new]) if name in kept else new for name, new in waiting.items()}
        tables = {name: dict(zip(self.rows[name].columns, rows.T, strict=True)) for name, rows in raw.items() if len(rows)}
        return trial_of(tables, self._zero or 0.0, self._told(), self.folder.name)

    def _told(self) -> dict[str, Any]:
        """The meta data with the events so far."""
        host = {**self.meta.get("host", {}), "events": list(self.events), "rows_dropped": self.dropped}
        return {**self.meta, "host": host}

    def flush(self) -> None:
        """Appends the new rows to the journal. Raises StoreError: the disk refuses; the rows wait."""
        if self._zero is None:
            return
        if self._journal is None:
            self._journal = Journal(self.folder, self._zero, {name: rows.columns for name, rows in self.rows.items()})
        told = self._told()
        self._journal.tell({**told, "host": {**told["host"], "state": UNDER_WAY}})
        for name, rows in self.rows.items():
            with self._lock:
                waiting = rows.waiting()
            if len(waiting):
                self._journal.append(name, waiting)
                with self._lock:
                    rows.drop(len(waiting))

    def discard(self) -> None:
        """Removes the trial: the robot was never armed, and the next swim may use the folder."""
        self.discarded = True

    def write(self) -> None:
        """Writes the trial folder in one step and removes the journal."""
        if self.discarded:
            if self._journal is not None:
                shutil.rmtree(self.folder, ignore_errors=True)
            return
        trial = self.trial()
        if trial.tables:
            write_whole(self.folder, trial)

    def _flush(self) -> None:
        while not self._stop.wait(self.every):
            try:
                self.flush()
                self.failed = ""
            except FishmjError as error:  # a full disk: told, tried again, and the swim goes on
                self.failed = str(error)

    def close(self, why: str = "") -> None:
        """Writes the last rows; may be called twice, also from another thread.

        Raises StoreError: the disk refuses; the trial then lies in the folder for temporary files.
        """
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        with self._closing:
            if self.closed:
                return
            if why:
                self.events.append(f"ended: {why}")
            try:
                self.write()
            except StoreError as error:
                self.folder = Path(tempfile.mkdtemp(prefix="fishmj-")) / self.folder.name
                self.write()
                raise StoreError(f"{error}; the trial was kept in {self.folder}") from error
            finally:
                self.closed = True
                if self._journal is not None:
                    self._journal.close()


def recovered(folder: Path) -> Trial:
    """Makes the trial of a swim whose host was killed from its journal, and writes it in its place.

    Raises StoreError: there is no journal, or its host is still running; LogError: there is no row in it.
    """
    meta, zero, columns, rows = left(folder)
    host = {name: value for name, value in meta.get("host", {}).items() if name != "state"}
    meta = {**meta, "host": {**host, "events": [*host.get("events", []), KILLED]}}
    tables = {name: dict(zip(columns[name], table.T, strict=True)) for name, table in rows.items() if len(table)}
    trial = trial_of(tables, zero, meta, folder.name)
    write_whole(folder, trial)
    return trial


def trial_of(raw: Mapping[str, Table], zero: float, meta: Mapping[str, Any], name: str) -> Trial:
    """Converts recorded rows to tables of the schema.

    Args:
        raw: columns of `TrialLog.rows`; stamps are of the host's clock, s. zero: its time, s, at which the trial's time is 0.
    """
    tables: dict[str, Table] = {}
    clock = {"cmd": "host, sending", "obs": "host", "action": "host", "target": "host"}
    latency = dict(meta.get("latency", {}))
    for table in ("cmd", "obs", "action", "target"):
        if table in raw:
            tables[table] = {**raw[table], "t": raw[table]["t"] - zero}
    for table in ("joint", "power"):
        if table in raw:
            tables[table], clock[table] = _on_even_clock(raw[table], zero, meta.get("host", {}).get("robot", {}).get("clock", {}))
    if "pose" in raw:
        pose = raw["pose"]
        late = float(np.median(pose["t_rx"] - pose["t_taken"]))
        rest = {column: values for column, values in pose.items() if column not in ("t_taken", "t_rx")}
        stamps = {"t_taken": pose["t_taken"] - zero, "t_rx": pose["t_rx"] - zero}
        tables["pose"] = {"t": pose["t_taken"] - zero + late, **rest, **stamps}
        clock["pose"], latency["pose"] = "host, frame taken plus latency.pose", late
    tables = {table: _rising(columns) for table, columns in tables.items()}
    about = {**meta, "clock": {table: clock[table] for table in tables}, **({"latency": latency} if latency else {})}
    return Trial(about, tables, name=name)


def write_whole(folder: Path, trial: Trial) -> None:
    """Writes a trial over the content of its folder. Raises StoreError, LogError."""
    save = partial(write_trial, folder, overwrite=True, form="npz", precision="float64")
    try:
        save(trial)
    except LogError as error:  # a reading beyond all bounds is what one wants to see afterwards: it is kept, and said
        host = {**trial.meta.get("host", {}), "implausible": str(error)}
        save(replace(trial, meta={**trial.meta, "host": host, PLAUSIBLE: dict.fromkeys(ALL_BOUNDS, 1e30) | LEAST}))


def _on_even_clock(table: Table, zero: float, told: Mapping[str, float]) -> tuple[Table, str]:
    """The table with its `t`, and the name of its clock; columns that lack a number are left out.

    told: fields of `links.RobotClock`, {} if it was never asked.
    """
    full = {name: values for name, values in table.items() if np.isfinite(values).all()}
    heard = full["t_rx"] - zero
    if "t_robot" not in full:
        return {"t": heard, **{name: v for name, v in full.items() if name != "t_rx"}}, "host, reading"
    runs = np.concatenate([[0], np.flatnonzero(np.diff(full["t_robot"]) < 0) + 1, [len(heard)]])  # the robot began anew
    t, clocks = heard.copy(), []
    for begin, end in zip(runs[:-1], runs[1:], strict=True):
        own = full["t_robot"][begin:end]
        latest = np.min(heard[begin:end] - own)  # the shift may not be more: nothing is heard before it is read
        shift = told.get("ahead", np.inf) - zero
        known = 0.0 <= latest - shift <= told.get("round_trip", 0.0)  # else another life of the robot's was asked
        t[begin:end] = own + (shift if known else latest)
        clocks.append("half of a round trip" if known else "the least delay")
    return {"t": t, **full, "t_rx": heard}, f"robot, shifted to the host's by {' and '.join(dict.fromkeys(clocks))}"


def _rising(table: Table) -> Table:
    """Rows with a later stamp than all before; a repeated stamp is left out."""
    t = table["t"]
    keep = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    return table if keep.all() else {name: values[keep] for name, values in table.items()}
