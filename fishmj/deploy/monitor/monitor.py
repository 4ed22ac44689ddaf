"""Detects when robot and model part: during the swim, or on logs.

    monitor = Monitor(robot, flow=(0.2, 3.14), rate=0.1)
    monitor.update({"cmd": rows, "joint": rows, "pose": rows, "power": rows})      as they arrive; any number of rows
    monitor.alarms                                                                  time, channel, changed probe

The first `settle` seconds, or a healthy log given to `reference_of`, give the distribution of the robot's innovations. After that
a CUSUM for every channel and probe compares (`statistics`). Naming the fault is the task of `gap find`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.monitor.prediction import Innovation, SwimPredictor, channels
from fishmj.deploy.monitor.statistics import BLOCK, LEAST_BLOCKS, SIZE, Cusums, Reference, learn
from fishmj.deploy.monitor.tick_interpolation import Ticks, as_heard
from fishmj.log import Trial
from fishmj.mjcf.description import Robot

RATE = 0.1  # false alarms an hour, of all tests together
SETTLE = 300.0  # s of healthy swimming that the monitor learns from
RUN_IN = 6.0  # s until the observer has forgotten where it began

Tables = Mapping[str, Mapping[str, Any]]


class Alarm(NamedTuple):
    """An alarm: robot and model parted."""

    t: float  # s, end of the block that raised it, on the clock of the tables
    channel: str  # surge, sway, yaw_rate, j1 .. jN, power
    probe: str  # what moved: offset, drag, inertia, stream_x, rate, .., size
    sign: int  # +1: grew, -1: fell
    share: dict[str, float]  # every channel's highest CUSUM over the limit


@dataclass
class History:
    """The statistics over time: row k of `share` belongs to `t[k]`."""

    t: list[float]
    share: list[dict[str, float]]


class Blocks:
    """Innovations of one robot, block by block; arguments as of `Monitor`."""

    def __init__(
        self, robot: Robot, flow: tuple[float, float] = (0.0, 0.0), pose: bool = True, power: bool = True,
        camera: float | None = None,
    ):  # fmt: skip
        self.observer = SwimPredictor(robot, flow=(flow[0] * cos(flow[1]), flow[0] * sin(flow[1])), camera=camera)
        self.ticks = Ticks(robot, pose, power)
        self.probes = channels(robot.n_joints, pose, power)
        self.length = round(BLOCK / robot.timing.bus_dt)
        self.run_in = round(RUN_IN / robot.timing.bus_dt)
        self._since = -1  # ticks since the observer began; -1: it has not
        self._open: list[Innovation] = []

    def take(self, tables: Tables) -> Iterable[tuple[float, dict]]:
        """Adds rows; yields (s, block) for every completed block."""
        self.ticks.add(tables)
        for t, seen, paused in self.ticks.taken():
            if paused or self._since < 0:
                self.observer.begin(seen)
                self._since, self._open = 0, []
                continue
            self._since += 1
            innovation = self.observer.step(seen)
            if self._since <= self.run_in:
                continue
            self._open.append(innovation)
            if len(self._open) == self.length:
                made, self._open = self._open, []
                yield t, joined(made, self.probes)


def joined(innovations: list[Innovation], probes: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """A block: channel -> (e (n,), phi (n, P))."""
    return {
        name: (np.array([i.error[name] for i in innovations]), np.array([i.probes[name] for i in innovations])) for name in probes
    }


class Monitor:
    """Watches one robot.

    Args:
        robot: the description that the policy was trained on, in its water.
        flow: speed [m/s] and direction [rad] of the ordered stream.
        rate: false alarms an hour, of all tests together.
        settle: s of swimming to learn from without a `reference`.
        reference: of a healthy swim of this very robot (`reference_of`).
        pose, power: True if these tables are logged.
        camera: s from a frame to its stamp; by default the description's camera latency.

    Attributes:
        alarms: every alarm since the start; the tests restart after each.
        history: statistics over time.
    """

    def __init__(
        self, robot: Robot, flow: tuple[float, float] = (0.0, 0.0), rate: float = RATE, settle: float = SETTLE,
        reference: Reference | None = None, pose: bool = True, power: bool = True, camera: float | None = None,
    ):  # fmt: skip
        self.rate, self.blocks = rate, Blocks(robot, flow, pose, power, camera)
        self.wanted = round(settle / BLOCK)
        if reference is None and self.wanted < LEAST_BLOCKS:
            raise ConfigError(f"monitor: settle = {settle} s; expected at least {LEAST_BLOCKS * BLOCK:.0f} s, or a healthy log")
        if reference is not None and set(reference.channels) != set(self.blocks.probes):
            there, here = ", ".join(reference.channels), ", ".join(self.blocks.probes)
            raise ConfigError(
                f"monitor: the healthy log has the channels {there}; this robot's are {here}; record the same tables"
            )
        self._healthy: list[dict] = []
        self.cusums = None if reference is None else Cusums(reference, rate, BLOCK)
        self.alarms: list[Alarm] = []
        self.history = History([], [])

    @property
    def settled(self) -> bool:
        """Returns True once it knows the healthy robot and watches."""
        return self.cusums is not None

    def update(self, tables: Tables) -> list[Alarm]:
        """Adds new rows of cmd, joint, pose and power; returns the alarms that they raise."""
        raised = []
        for t, block in self.blocks.take(tables):
            if self.cusums is None:
                self._healthy.append(block)
                if len(self._healthy) >= self.wanted:
                    self.cusums = Cusums(learn(self._healthy, self.blocks.probes), self.rate, BLOCK)
                continue
            self.cusums.take(block)
            share = self.cusums.share()
            self.history.t.append(t)
            self.history.share.append(share)
            if channel := self.cusums.parted():
                probe, sign = self.cusums.highest(channel)
                raised.append(Alarm(t, channel, probe, sign, share))
                self.cusums = Cusums(self.cusums.reference, self.rate, BLOCK)
        self.alarms += raised
        return raised


def has(trials: Iterable[Trial], table: str) -> bool:
    """Returns True if all trials have the table."""
    return all(table in trial.tables and len(trial.tables[table]["t"]) > 1 for trial in trials)


def reference_of(robot: Robot, trials: Iterable[Trial], pose: bool = True, power: bool = True) -> Reference:
    """Reference distribution of the healthy robot's innovations, from its trials.

    Raises ConfigError: less than 80 s of it behind the run-in of every trial.
    """
    made: list[dict] = []
    probes: Mapping[str, tuple[str, ...]] = {}
    for trial in trials:
        blocks = Blocks(robot, flow_of(trial), pose, power, trial.value("latency.pose"))
        probes = blocks.probes
        made += [block for _, block in blocks.take(as_heard(trial.tables))]
    return learn(made, probes)


def flow_of(trial: Trial) -> tuple[float, float]:
    """(m/s, rad) of the ordered stream of a trial; still water if it states none."""
    flow = trial.meta.get("flow", {})
    return float(flow.get("speed") or 0.0), float(flow.get("direction") or 0.0)


def said(alarm: Alarm) -> str:
    """One line on an alarm for the person at the tank."""
    larger = alarm.probe == SIZE and alarm.sign > 0
    what = "innovations are larger" if larger else f"{alarm.probe} {'+' if alarm.sign > 0 else '-'}"
    return f"robot and model part at t = {alarm.t:.1f} s in {alarm.channel} ({what}); fishmj gap find LOGS names the cause"
