"""Run the compiled loop for a plant: from commands with their arrival times to a recording at 1 kHz."""

from typing import NamedTuple

import numpy as np

from fishmj.errors import SimDiverged
from fishmj.virtual_robot.loop import H, advance
from fishmj.virtual_robot.robot_constants import RobotConstants

LOG = 20  # columns of the recording, see `COLUMNS`
COLUMNS = ("x", "y", "yaw", "vx", "vy", "wz", "j1", "j2", "j3", "k1", "k2", "k3", "V", "I", "e1", "e2", "e3", "d1", "d2", "d3")


class State(NamedTuple):
    """Places in the tank frame, links by absolute angle: z = (X, Y, th1..th4), X, Y the reference point on the head."""

    z: np.ndarray  # (6,) m, rad
    rate: np.ndarray  # (6,) m/s, rad/s
    amps: np.ndarray  # (3,) motor currents, A
    drive: np.ndarray  # (3,) torque that the firmware asks of the bridge, N m
    seen: np.ndarray  # (3,) angle at the last firmware tick, rad
    goal: np.ndarray  # (3,) latest command, rad
    aim: np.ndarray  # (3,) command after ramp and rate limit, rad
    ramp: np.ndarray  # (3, 3) of the motion-time ramp: from rad, to rad, since s
    gap: np.ndarray  # (3,) play: motor side less link side, rad
    branch: np.ndarray  # (3,) stretch of the skin's viscous branch, rad
    bouc: np.ndarray  # (3,) hysteresis state of the skin, rad
    stuck: np.ndarray  # (3,) friction impulse of the last step, N m s
    wake: np.ndarray  # (6,) circulation m/s; lagged tail force N, N, moment N m; two states of the resonance
    speed: np.ndarray  # (4,) skin friction speed of each link to the power 0.8
    battery: np.ndarray  # (3,) terminal voltage V, current A, charge drawn A s
    clock: np.ndarray  # (3,) time s; next firmware tick s; firmware resets until s


def at_rest(start, angles, voltage: float, push=(0.0, 0.0, 0.0)) -> State:
    """A fish at `start` (x, y, yaw), joints at `angles` and told to stay there, launched with `push` (u, v, r), its own axes."""
    x, y, yaw = start
    u, v, r = push
    joints = np.asarray(angles, float)
    theta = yaw + np.concatenate([[0.0], np.cumsum(joints)])
    c, s = np.cos(yaw), np.sin(yaw)
    return State(
        z=np.concatenate([[x, y], theta]),
        rate=np.concatenate([[c * u - s * v, s * u + c * v], np.full(4, r)]).astype(float),
        ramp=np.stack([joints, joints, np.zeros(3)], 1),
        wake=np.zeros(6),
        speed=np.zeros(4),
        battery=np.array([voltage, 0.0, 0.0]),
        **{name: joints.copy() for name in ("seen", "goal", "aim")},
        **{name: np.zeros(3) for name in ("amps", "drive", "gap", "branch", "bouc", "stuck", "clock")},
    )


COLUMN = {name: i for i, name in enumerate(COLUMNS)}
STILL = np.zeros((2, 2))  # no gusts


class Recording(NamedTuple):
    """State every millisecond. data (T, LOG) in the order of `COLUMNS`."""

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
