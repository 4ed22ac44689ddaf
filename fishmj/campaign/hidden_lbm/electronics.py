"""Electronics of the second robot on the joints of the solver's fish: commands arrive, servos push, everything is recorded.

Per step of the water: `actuate` sends the servos ahead and gives the solver their law, `follow` takes the state that it found.
"""

from typing import NamedTuple

import numpy as np

from fishmj.campaign.hidden_lbm.hidden_body import HiddenBody, HiddenDifference
from fishmj.campaign.hidden_lbm.implicit_servo import END, FASTEST, IMPULSE, SLOPE, STILL, ahead
from fishmj.virtual_robot.loop import H
from fishmj.virtual_robot.robot_constants import RobotConstants
from fishmj.virtual_robot.simulate import LOG, Recording, State, workspace

PLACES = 12  # first columns of the recording: pose, its rates, joints, their rates


class Queue(NamedTuple):
    """Commands (K, 3) rad that reach the servos at times (K,) s, rising."""

    times: np.ndarray
    commands: np.ndarray


class Electronics:
    """One robot's electronics.

    Args:
        made: the robot. state: at t = 0. queue: what arrives, and when. gust: weather of the second robot's water (G, 2).
    """

    def __init__(self, made: RobotConstants, state: State, queue: Queue, gust: np.ndarray):
        self.made, self.state, self.queue, self.gust = made, state, queue, gust
        self.difference = HiddenDifference(made, gust)
        self.law, self.held = np.zeros((3, 5)), np.zeros(3, bool)
        self.rows: list[np.ndarray] = []  # one array (n, LOG) a step
        self._work, self._tick, self._next = workspace(), -1, 0.0
        self._kept: tuple[list[np.ndarray], int, float] = ([], 0, 0.0)

    def begin_tick(self, tick: int) -> None:
        """Called at the start of every attempt at a tick: a second one starts from where the first did."""
        arrays = (*self.state, *self.difference.wakes)
        if tick != self._tick:
            self._tick, self._kept = tick, ([a.copy() for a in arrays], len(self.rows), self._next)
            return
        saved, rows, self._next = self._kept
        for array, old in zip(arrays, saved, strict=True):
            array[:] = old
        del self.rows[rows:]

    def actuate(self, body: HiddenBody, time: float) -> None:
        """Set the joints' law, and what effects add, for the step of the water that begins at `time` s."""
        extra = np.zeros(3)
        if self.difference.acts:
            force, mass = self.difference(self.state, body.dt)
            body.applied[:3], body.added_mass = force[:3], mass
            extra = force[3:]
        if time >= self._next - 1e-9:  # steps finer than the servos' share a law
            self._send_ahead(max(1, round(body.dt / H)))
        seconds = max(body.dt, H)
        slope = self.law[:, SLOPE] / seconds
        body.set_torque(self.law[:, IMPULSE] / seconds + slope * self.law[:, END] + extra, slope)

    def _send_ahead(self, steps: int) -> None:
        made, q = self.made, self.queue
        record = np.empty((steps, LOG))
        first = int(np.searchsorted(q.times, self.state.clock[0] - H))
        given = (made.body, made.water, made.motor, made.tank, made.odd, made.zero, self.gust)
        ahead(*given, q.times[first:], q.commands[first:], self.state, record, self._work, self.law)
        self.held = self.law[:, FASTEST] < STILL
        self._next = float(self.state.clock[0])
        self.rows.append(record)

    def follow(self, body: HiddenBody) -> None:
        """The state that the solver found in place of the guess; between its steps the recording is a straight line."""
        self.place(body)
        record = self.rows[-1]
        if len(record) > 1:
            now = places(self.state)
            share = (np.arange(len(record)) / len(record))[:, None]
            record[:, :PLACES] = record[0, :PLACES] + share * (now - record[0, :PLACES])

    def place(self, body: HiddenBody) -> None:
        """Places and rates of the body, links by absolute angle."""
        q, v = body.data.qpos, body.data.qvel
        self.state.z[:2], self.state.rate[:2] = q[:2], v[:2]
        self.state.z[2:], self.state.rate[2:] = np.cumsum(q[2:]), np.cumsum(v[2:])

    def recording(self) -> Recording:
        """Everything so far, a row a millisecond."""
        data = np.concatenate(self.rows)
        return Recording(np.arange(len(data)) * H, data)


def places(state: State) -> np.ndarray:
    """Pose, its rates, joints, their rates (12,)."""
    z, rate = state.z, state.rate
    return np.concatenate([z[:3], rate[:3], np.diff(z[2:]), np.diff(rate[2:])])
