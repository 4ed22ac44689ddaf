"""The sense-and-act loop, written once: what the sensors still know of the past, and one control step on an engine.

    loop = ControlLoop(robot, "batch")
    loop.start(pose, scenario)
    obs = loop.observe(target, noise)          late and noisy, as camera and encoders give it
    trace = loop.act(commands)                 one control step of bus commands (B, T, J) rad

`ControlLoop` serves whoever swims on an engine; `SensorWindow` alone serves dm_control's physics and the flow solver, which
advance the fish themselves.
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj import engines
from fishmj.engines import FishParams, FishState, Trace
from fishmj.flow import Current
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.sensing import Sensors, readings


class SensorWindow(NamedTuple):
    """The last bus ticks of B fish, newest last: as far back as latency, the velocity filter and late encoders reach."""

    pose: np.ndarray  # (B, H, 3) m, rad
    joint: np.ndarray  # (B, K + 1, 2 J) angles and rates, rad, rad/s

    @classmethod
    def at_rest(cls, robot: Robot, sensors: Sensors, pose) -> "SensorWindow":
        """Straight fish that have always been at poses (B, 3)."""
        poses = np.repeat(pose[:, None], task.history_length(robot), 1)
        return cls(poses, np.zeros((len(pose), sensors.behind + 1, 2 * robot.n_joints)))

    def after(self, pose, joint, rate) -> "SensorWindow":
        """T bus ticks later: pose (B, T, 3), joint and rate (B, T, J)."""
        return SensorWindow(slide(np, self.pose, pose), slide(np, self.joint, readings(np, joint, rate)))


def slide(xp, window, rows):
    """A window (B, W, C) moved on by new rows (B, T, C)."""
    return xp.concatenate([window, rows], 1)[:, -window.shape[1] :]


class Scenario(NamedTuple):
    """What B fish are and meet, settled before the first step."""

    params: FishParams
    camera: np.ndarray  # (B,) int, camera latency in bus ticks
    current: Current


class ControlLoop:
    """B fish on an engine.

    Args:
        engine: name or engine.

    Attributes:
        scenario: as given to `start`. fish: their state. window: what the sensors remember. count: (B,) control steps so far.
    """

    scenario: Any
    fish: FishState

    def __init__(self, robot: Robot, engine):
        self.robot, self.sensors = robot, Sensors(robot)
        self.engine = engines.make(engine, robot) if isinstance(engine, str) else engine
        self.ticks = engines.ticks_per(robot)[1]

    def start(self, pose, scenario) -> None:
        """Begin at rest over ground at poses (B, 3) [m, rad], encoders at zero; scenario: a `Scenario` or more."""
        self.scenario, self.fish = scenario, engines.at_rest(self.robot, pose)
        self.fish.q[:, 3:] = scenario.params.zero
        self.window = SensorWindow.at_rest(self.robot, self.sensors, pose)
        self.count = np.zeros(len(pose), np.int64)

    def observe(self, target, noise) -> np.ndarray:
        """Observations (B, 5 + 2 J) of targets (B, 2) m; noise: standard normals times the wanted strength, same shape."""
        now = self.scenario
        senses = (self.window.pose, now.camera, self.window.joint)
        return task.observe_with_sensors(np, self.robot, self.sensors, now.params, *senses, target, noise)

    def act(self, commands) -> Trace:
        """Swim one control step of bus commands (B, T, J) rad. Raises SimDiverged."""
        self.fish, trace = self.advance(self.fish, commands)
        self.window = self.window.after(trace.pose, trace.joint, trace.rate)
        self.count = self.count + 1
        return trace

    def advance(self, fish: FishState, commands) -> tuple[FishState, Trace]:
        """The engine's step from `fish`, its trace as float64 NumPy; remembers nothing."""
        now = self.scenario
        fish, trace = self.engine.advance(fish, commands, now.params, now.current, self.count * self.ticks)
        return fish, Trace(*(np.asarray(a, float) for a in trace))
