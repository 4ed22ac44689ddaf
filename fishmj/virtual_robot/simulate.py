"""Run the compiled loop for a plant: from commands with their arrival times to a recording at 1 kHz."""

from typing import NamedTuple

import numpy as np

from fishmj.errors import SimDiverged
from fishmj.virtual_robot.loop import H, advance
from fishmj.virtual_robot.robot_constants import RobotConstants
from fishmj.virtual_robot.state import COLUMNS, LOG, State

COLUMN = {name: i for i, name in enumerate(COLUMNS)}
STILL = np.zeros((2, 2))  # no gusts


class Recording(NamedTuple):
    """State every millisecond. data (T, LOG) in the order of `state.COLUMNS`."""

    t: np.ndarray  # (T,) s
    data: np.ndarray

    def at(self, times: np.ndarray, *names: str) -> np.ndarray:
        """Columns at any times, linear between milliseconds, held beyond the ends: (K, n)."""
        return np.stack([np.interp(times, self.t, self.data[:, COLUMN[name]]) for name in names], 1)


def workspace() -> tuple[np.ndarray, ...]:
    """Scratch arrays of `loop.advance`."""
    return (np.zeros((6, 6)), np.zeros(6), np.zeros((3, 3)), np.zeros((3, 6)), *(np.zeros(n) for n in (3, 3, 4, 3)))


def run(
    plant: RobotConstants, state: State, arrivals, commands, seconds: float, gust: np.ndarray = STILL, anchor=None
) -> Recording:
    """Advance `state` in place by `seconds`; commands (K, 3) [rad] reach the servos at arrivals (K,) [s].

    Raises:
        SimDiverged: the state left the finite numbers; says when.
    """
    steps = round(seconds / H)
    record, start = np.empty((steps, LOG)), float(state.clock[0])
    arrivals, commands = np.asarray(arrivals, float), np.asarray(commands, float).reshape(-1, 3)
    anchor = state.z[:3].copy() if anchor is None else anchor
    groups = (plant.body, plant.water, plant.motor, plant.tank, plant.odd, plant.air, anchor, plant.zero, gust)
    advance(*groups, arrivals, commands, state, record, workspace())
    bad = np.flatnonzero(~np.isfinite(record[:, 0]))
    if len(bad):
        raise SimDiverged(
            f"the virtual robot left the finite numbers at t = {start + bad[0] * H:.3f} s; reduce the planted value"
        )
    return Recording(start + np.arange(steps) * H, record)
