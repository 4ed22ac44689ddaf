"""What a judgement yields: the time series of every trial."""

from typing import NamedTuple

import numpy as np

from fishmj.calib import constant
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.description import Robot


class Result(NamedTuple):
    """What n trials did; T bus ticks of 20 ms, row 0 is the start; K control steps."""

    controller: str
    policy_sha256: str  # of a policy's file, else ""
    robot: Robot
    trials: Trials
    engine: str
    t: np.ndarray  # (T + 1,) s
    target: np.ndarray  # (n, 2) m
    pose: np.ndarray  # (n, T + 1, 3) m, m, rad; tank frame, yaw not wrapped
    velocity: np.ndarray  # (n, T + 1, 3) true rates
    joint: np.ndarray  # (n, T + 1, J) rad
    rate: np.ndarray  # (n, T + 1, J) rad/s
    power: np.ndarray  # (n, T) W, servos and idle, mean over a tick
    command: np.ndarray  # (n, T, J) rad, on the bus
    obs: np.ndarray  # (n, K, 5 + 2 J)
    action: np.ndarray | None  # (n, K, J) of policies
    distance: np.ndarray  # (n, T + 1) m, frozen where a trial left the domain
    left: np.ndarray  # (n,) tick at which the trial left, T + 1 if it did not

    @property
    def water(self) -> str:
        """`lbm` for the flow solver, else the robot's model: `structured`, `surrogate` or the file of a fitted one."""
        return "lbm" if self.engine.startswith("tanks") else str(self.robot.water.get("model", "structured"))


def arrival_tick(result: Result) -> np.ndarray:
    """(n,) tick of the first entry into the arrival radius within the arrival time; -1 where there is none."""
    limit = round(constant("protocol", "arrival_time") / result.robot.timing.bus_dt)
    inside = (result.distance <= constant("protocol", "arrival_radius"))[:, : limit + 1]
    inside &= np.arange(inside.shape[1]) < result.left[:, None]
    return np.where(inside.any(1), inside.argmax(1), -1)
