"""The trial folder of a swim: every command asked and sent, every packet and fix, each with its own stamps.

    cmd      t sent; c# as they left; asked# as the policy or the experiment wanted them; seq; state of the supervisor
    joint    t; j#, temp#; seq and echo (-1: none), t_robot, t_rx
    pose     t; x, y, yaw, quality; t_taken, t_rx
    power    t; V, I
    obs, action, target

`t` is the host's clock, s from the first row. Where the robot has a clock, t of `joint` and `power` is that clock's, shifted by
the least t_rx - t_robot: even, as it was read. A fix is stamped as the schema wants it, when it arrives: its own time plus the
median latency, which `latency.pose` in meta.toml holds.

Rows are kept in arrays and written as a whole folder every few seconds, in a thread: what came since is all that a killed process
loses.
"""

import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fishmj.deploy.observer import Pose
from fishmj.deploy.supervisor import Condition, Event, named
from fishmj.errors import FishmjError, LogError, StoreError
from fishmj.log import Table, Trial, write_trial
from fishmj.log.trial_check import PLAUSIBLE, Plausible
from fishmj.protocols.messages import Telemetry

EVERY = 5.0  # s between two writings
SHARE = 0.05  # of the time that writing may take: a long swim is written less often
FIRST = 3000  # rows of a new table: a minute
ALL_BOUNDS = [field.name for field in fields(Plausible)]
LEAST = {"voltage_least": 1e-30, "current_least": 1e-30}


class Listener(Protocol):
    """Who hears what the log takes in; nothing here may wait."""

    def command(self, t: float, joint: np.ndarray) -> None: ...
    def heard(self, t: float, packet: Telemetry) -> None: ...
    def fix(self, pose: Pose) -> None: ...
    def event(self, event: Event) -> None: ...


class Rows:
    """A table that grows: columns of float64, in an array that doubles."""

    def __init__(self, columns: Sequence[str]):
        self.columns, self.count = tuple(columns), 0
        self._data = np.empty((FIRST, len(self.columns)))

    def add(self, *values: float) -> None:
        """One row, in the order of the columns."""
        if self.count == len(self._data):
            self._data = np.concatenate([self._data, np.empty_like(self._data)])
        self._data[self.count] = values
        self.count += 1

    def table(self) -> Table:
        """What is there, as columns of their own."""
        data = self._data[: self.count].copy()
        return {name: data[:, k] for k, name in enumerate(self.columns)}


class TrialLog:
    """One trial folder under way.

    Args:
        folder: must not exist. meta: of the trial; `clock`, `latency` and `host` are added. joints: J.

    Attributes:
        listeners: are told every command, packet, fix and event, too.
        dropped: rows left out because a value was not finite. failed: why the last writing did not work, "" where it did.
    """

    def __init__(self, folder: Path, meta: Mapping[str, Any], joints: int, *, every: float = EVERY):
        if folder.exists():
            raise StoreError(f"{folder}: exists; choose another name for the trial")
        self.folder, self.meta, self.every = folder, dict(meta), every
        each = lambda letter: [f"{letter}{k + 1}" for k in range(joints)]
        self.joints = joints
        self.rows = {
            "cmd": Rows(["t", *each("c"), *each("asked"), "seq", "state"]),
            "joint": Rows(["t_rx", *each("j"), "seq", "echo", "t_robot", *each("temp")]),
            "pose": Rows(["t_taken", "x", "y", "yaw", "quality", "t_rx"]),
            "power": Rows(["t_rx", "V", "I", "t_robot"]),
            "obs": Rows(["t", *[f"o{k + 1}" for k in range(5 + 2 * joints)]]),
            "action": Rows(["t", *each("a")]),
            "target": Rows(["t", "x", "y"]),
        }
        self.events: list[str] = []
        self.listeners: list[Listener] = []
        self.dropped, self.failed, self.closed = 0, "", False
        self._zero: float | None = None
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
        """A command that left at `t`."""
        self._add("cmd", t, *sent, *asked, -1 if seq is None else seq, state)
        for listener in self.listeners:
            listener.command(t, sent)

    def heard(self, t: float, packet: Telemetry) -> None:
        """A packet that arrived at `t`."""
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
        """A fix that the loop took in."""
        self._add("pose", pose.t, pose.x, pose.y, pose.yaw, quality, pose.heard)
        for listener in self.listeners:
            listener.fix(pose)

    def decided(self, t: float, obs: np.ndarray | None, action: np.ndarray | None) -> None:
        """What the policy saw and answered at `t`; an answer that is not finite stands among the events instead."""
        if obs is not None:
            self._add("obs", t, *obs)
        if action is not None:
            self._add("action", t, *action)

    def target(self, t: float, x: float, y: float) -> None:
        """Where the fish should be from `t` on."""
        self._add("target", t, x, y)

    def event(self, event: Event) -> None:
        """A change of the supervisor's state."""
        also = event.conditions & ~event.because & ~Condition.HEARD
        more = f"; also {named(also)}" if also else ""
        for listener in self.listeners:
            listener.event(event)
        self.say(event.t, f"{event.before.name} -> {event.after.name}: {named(event.because) or 'asked'}{more}")

    def say(self, t: float, text: str) -> None:
        """A line among the events."""
        self.events.append(f"{t - (self._zero if self._zero is not None else t):.3f} s {text}")

    def _add(self, name: str, t: float, *values: float, may_lack: int = 0) -> bool:
        """One row, when its numbers are finite; the last `may_lack` of them may be absent."""
        if not np.isfinite((t, *values[: len(values) - may_lack])).all():
            self.dropped += 1
            return False
        if self._zero is None:
            self._zero = t
        with self._lock:
            self.rows[name].add(t, *values)
        return True

    def trial(self) -> Trial:
        """What is there so far, as a trial of the schema."""
        with self._lock:
            raw = {name: rows.table() for name, rows in self.rows.items() if rows.count}
        zero, meta = self._zero or 0.0, dict(self.meta)
        tables: dict[str, Table] = {}
        clock = {"cmd": "host, sending", "obs": "host", "action": "host", "target": "host"}
        latency = dict(meta.get("latency", {}))
        for name in ("cmd", "obs", "action", "target"):
            if name in raw:
                tables[name] = {**raw[name], "t": raw[name]["t"] - zero}
        if "joint" in raw:
            tables["joint"], clock["joint"] = _on_even_clock(raw["joint"], zero)
        if "power" in raw:
            tables["power"], clock["power"] = _on_even_clock(raw["power"], zero)
        if "pose" in raw:
            pose = raw["pose"]
            late = float(np.median(pose["t_rx"] - pose["t_taken"]))
            rest = {name: values for name, values in pose.items() if name not in ("t_taken", "t_rx")}
            stamps = {"t_taken": pose["t_taken"] - zero, "t_rx": pose["t_rx"] - zero}
            tables["pose"] = {"t": pose["t_taken"] - zero + late, **rest, **stamps}
            clock["pose"], latency["pose"] = "host, frame taken plus latency.pose", late
        tables = {name: _rising(table) for name, table in tables.items()}
        meta |= {"clock": {name: clock[name] for name in tables}}
        meta |= {"latency": latency} if latency else {}
        meta["host"] = {**meta.get("host", {}), "events": list(self.events), "rows_dropped": self.dropped}
        return Trial(meta, tables, name=self.folder.name)

    def write(self) -> None:
        """Write what is there, the whole folder in one step."""
        trial = self.trial()
        if not trial.tables:
            return
        save = partial(write_trial, self.folder, overwrite=True, form="npz", precision="float64")
        try:
            save(trial)
        except LogError as error:  # a reading beyond all bounds is what one wants to see afterwards: it is kept, and said
            host = {**trial.meta["host"], "implausible": str(error)}
            save(replace(trial, meta={**trial.meta, "host": host, PLAUSIBLE: dict.fromkeys(ALL_BOUNDS, 1e30) | LEAST}))

    def _flush(self) -> None:
        wait = self.every
        while not self._stop.wait(wait):
            begin = time.perf_counter()
            try:
                self.write()
                self.failed = ""
            except FishmjError as error:  # a full disk: told, tried again, and the swim goes on
                self.failed = str(error)
            wait = max(self.every, (time.perf_counter() - begin) / SHARE)

    def close(self, why: str = "") -> None:
        """Write the last rows; may be called twice, also from another thread.

        Raises:
            StoreError: the disk refuses; the trial then lies in the folder for temporary files.
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


def _on_even_clock(table: Table, zero: float) -> tuple[Table, str]:
    """The table with its `t`, and the clock that stamped it; columns that lack a number are left out."""
    full = {name: values for name, values in table.items() if np.isfinite(values).all()}
    heard = full["t_rx"] - zero
    if "t_robot" not in full:
        return {"t": heard, **{name: v for name, v in full.items() if name != "t_rx"}}, "host, reading"
    runs = np.concatenate([[0], np.flatnonzero(np.diff(full["t_robot"]) < 0) + 1, [len(heard)]])  # the robot began anew
    t = heard.copy()
    for begin, end in zip(runs[:-1], runs[1:], strict=True):
        own = full["t_robot"][begin:end]
        t[begin:end] = own + np.min(heard[begin:end] - own)
    return {"t": t, **full, "t_rx": heard}, "robot, shifted to the host's"


def _rising(table: Table) -> Table:
    """Rows whose stamp is later than every one before; a repeated stamp is left out."""
    t = table["t"]
    keep = np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])
    return table if keep.all() else {name: values[keep] for name, values in table.items()}
