"""Interpolates arriving rows of the tables to the ticks of the bus, for the comparison with the model.

A command acts `command_latency` after it was sent and holds until the next. A measurement between two rows is on the straight
line between them. A tick is complete only when every table has passed it, so that late rows are never guessed.

The robot's own stamps are shifted by the least delay of a packet: late by the radio's way up, but equally in every swim. A
log's own shift, of half a round trip (`links.RobotClock`), has no such lag but differs by a millisecond or two from swim to swim.
At 5 rad/s that is 10 mrad, which is no fault of a joint.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fishmj.deploy.monitor.prediction import TickMeasurement
from fishmj.log import stacked
from fishmj.mjcf.description import Robot

PAUSE = 0.25  # s without rows of a table: the model starts afresh behind it
KEPT = 2.0  # s of rows that are kept


def as_heard(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Tables of a log, joint and power stamped by the robot's clock plus the least delay; without that clock unchanged."""
    made = dict(tables)
    for name in ("joint", "power"):
        table = made.get(name, {})
        if "t_robot" not in table or "t_rx" not in table:
            continue
        own, heard = np.asarray(table["t_robot"], float), np.asarray(table["t_rx"], float)
        life = np.concatenate([[0], np.cumsum(np.diff(own) < 0)])  # the robot began anew
        least = np.array([np.min((heard - own)[life == k]) for k in range(life[-1] + 1)])
        made[name] = {**table, "t": own + least[life]}
    return made


class Ticks:
    """Converts rows to `TickMeasurement`, tick by tick. pose, power: True if the robot has them."""

    def __init__(self, robot: Robot, pose: bool = True, power: bool = True):
        self.robot, self.dt = robot, robot.timing.bus_dt
        self.needs = {"cmd": "c#", "joint": "j#", **({"pose": "xyw"} if pose else {}), **({"power": "VI"} if power else {})}
        self.rows: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.next: int | None = None  # number of the next tick, from the clock's zero

    def add(self, tables: Mapping[str, Mapping[str, Any]]) -> None:
        """Appends rows; rows that are not newer than all before are dropped."""
        for name in self.needs:
            table = tables.get(name)
            if table is None or not len(table["t"]):
                continue
            t, values = np.asarray(table["t"], float), self._values(name, table)
            if name in self.rows:
                before = self.rows[name]
                fresh = t > before[0][-1]
                t, values = np.concatenate([before[0], t[fresh]]), np.concatenate([before[1], values[fresh]])
            keep = np.all(np.isfinite(values), 1) & np.concatenate([[True], np.diff(t) > 0])
            self.rows[name] = (t[keep], values[keep])

    def _values(self, name: str, table: Mapping[str, Any]) -> np.ndarray:
        columns = {key: np.asarray(value) for key, value in table.items()}
        if name in ("cmd", "joint"):
            return stacked(columns, self.needs[name])
        if name == "power":
            return (np.asarray(columns["V"], float) * np.asarray(columns["I"], float))[:, None]
        return np.stack([np.asarray(columns[key], float) for key in ("x", "y", "yaw")], 1)

    def taken(self) -> list[tuple[float, TickMeasurement, bool]]:
        """(time s, measurement, True if rows were missing before it) of every tick that is complete now."""
        if set(self.rows) != set(self.needs) or any(not len(t) for t, _ in self.rows.values()):
            return []
        if self.next is None:
            self.next = int(np.ceil(max(t[0] for t, _ in self.rows.values()) / self.dt)) + 1
        end = min(t[-1] for name, (t, _) in self.rows.items() if name != "cmd")
        count = int(np.floor(end / self.dt + 1e-9)) - self.next + 1
        if count <= 0:
            return []
        times = self.dt * (self.next + np.arange(count))
        self.next += count
        steps = round(self.dt / self.robot.timing.physics_dt)
        inside = self.robot.timing.physics_dt * (np.arange(steps) - steps)
        act = (times[:, None] + inside - self.robot.timing.command_latency).ravel()
        t, values = self.rows["cmd"]
        target = values[np.clip(np.searchsorted(t, act + 1e-9, side="right") - 1, 0, None)].reshape(count, steps, -1)
        read = {name: self._at(name, times) for name in self.needs if name != "cmd"}
        paused = np.any([_paused(self.rows[name][0], times) for name in read], 0)
        self._forget(float(times[-1]))
        lists = {name: value.tolist() for name, value in read.items()}
        poses, powers = lists.get("pose"), lists.get("power")
        return [
            (
                float(times[k]),
                TickMeasurement(
                    target[k].tolist(), lists["joint"][k], poses[k] if poses else None, powers[k][0] if powers else None
                ),
                bool(paused[k]),
            )
            for k in range(count)
        ]

    def _at(self, name: str, times: np.ndarray) -> np.ndarray:
        t, values = self.rows[name]
        if name == "pose":
            values = np.column_stack([values[:, :2], np.unwrap(values[:, 2])])
        return np.stack([np.interp(times, t, column) for column in values.T], 1)

    def _forget(self, now: float) -> None:
        for name, (t, values) in self.rows.items():
            first = max(int(np.searchsorted(t, now - KEPT)) - 1, 0)
            self.rows[name] = (t[first:], values[first:])


def _paused(t: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns True for times whose neighbouring rows are too far apart."""
    after = np.clip(np.searchsorted(t, times), 1, max(len(t) - 1, 1))
    if len(t) < 2:
        return np.ones(len(times), bool)
    return t[after] - t[after - 1] > PAUSE
