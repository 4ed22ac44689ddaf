"""Runs the compiled loop of a robot: arriving commands in, a recording at 1 kHz out."""

from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import SimDiverged
from fishmj.gap.laboratory.virtual_robot.loop import H, advance
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants

POSE, METER = ("x", "y", "yaw", "vx", "vy", "wz"), ("V", "I")


@cache
def columns(joints: int) -> dict[str, int]:
    """Column index of each name in a recording: pose and its rates, joint angles and rates, meter, aims, drives."""
    each = lambda letter: [f"{letter}{j + 1}" for j in range(joints)]
    return {name: i for i, name in enumerate([*POSE, *each("j"), *each("k"), *METER, *each("e"), *each("d")])}


class ChainState(NamedTuple):
    """State in the tank frame: z = (X, Y, th1..thN), the reference point and the links' absolute angles; J = N - 1."""

    z: np.ndarray  # (N + 2,) m, rad
    rate: np.ndarray  # (N + 2,) m/s, rad/s
    amps: np.ndarray  # (J,) motor currents, A
    drive: np.ndarray  # (J,) torque requested by the firmware, N m
    seen: np.ndarray  # (J,) angle at the last firmware tick, rad
    goal: np.ndarray  # (J,) latest command, rad
    aim: np.ndarray  # (J,) command after ramp and rate limit, rad
    ramp: np.ndarray  # (J, 3) of the motion-time ramp: from rad, to rad, since s
    gap: np.ndarray  # (J,) backlash: motor side minus link side, rad
    branch: np.ndarray  # (J,) stretch of the skin's viscous branch, rad
    bouc: np.ndarray  # (J,) hysteresis state of the skin, rad
    stuck: np.ndarray  # (J,) friction impulse of the last step, N m s
    wake: np.ndarray  # (6,) circulation m/s; lagged tail force N, N, moment N m; two states of the resonance
    speed: np.ndarray  # (N,) skin friction speed of each link to the power 0.8
    arm: np.ndarray  # (N, 2) rear hinge of each link from its origin, tank frame, m; scratch
    battery: np.ndarray  # (3,) terminal voltage V, current A, charge drawn A s
    clock: np.ndarray  # (3,) time s; next firmware tick s; firmware resets until s


def at_rest(start, angles, voltage: float, push=(0.0, 0.0, 0.0)) -> ChainState:
    """State at `start` (x, y, yaw) with joints and targets at `angles`, launched with `push` (u, v, r) in the fish's axes."""
    x, y, yaw = start
    u, v, r = push
    joints = np.asarray(angles, float)
    n = len(joints) + 1
    theta = yaw + np.concatenate([[0.0], np.cumsum(joints)])
    c, s = np.cos(yaw), np.sin(yaw)
    return ChainState(
        z=np.concatenate([[x, y], theta]),
        rate=np.concatenate([[c * u - s * v, s * u + c * v], np.full(n, r)]).astype(float),
        ramp=np.stack([joints, joints, np.zeros(n - 1)], 1),
        wake=np.zeros(6),
        speed=np.zeros(n),
        arm=np.zeros((n, 2)),
        battery=np.array([voltage, 0.0, 0.0]),
        **{name: joints.copy() for name in ("seen", "goal", "aim")},
        clock=np.zeros(3),
        **{name: np.zeros(n - 1) for name in ("amps", "drive", "gap", "branch", "bouc", "stuck")},
    )


STILL = np.zeros((2, 2))  # no gusts


class StateRecording(NamedTuple):
    """State every millisecond. data (T, 8 + 4 J) in the order of `columns`."""

    t: np.ndarray  # (T,) s
    data: np.ndarray

    @property
    def joints(self) -> int:
        """Number of joints of the robot."""
        return (self.data.shape[1] - len(POSE) - len(METER)) // 4

    def at(self, times: np.ndarray, *names: str) -> np.ndarray:
        """Columns (K, n) at any times: linear between milliseconds, constant beyond the ends."""
        column = columns(self.joints)
        return np.stack([np.interp(times, self.t, self.data[:, column[name]]) for name in names], 1)


def workspace(joints: int = 3) -> tuple[np.ndarray, ...]:
    """Scratch arrays of `loop.advance`."""
    j, n = joints, joints + 3
    return (np.zeros((n, n)), np.zeros(n), np.zeros((j, j)), np.zeros((j, n)), *(np.zeros(k) for k in (j, j, 4, j)))


def run(
    plant: RobotConstants, state: ChainState, arrivals, commands, seconds: float, gust: np.ndarray = STILL, anchor=None
) -> StateRecording:
    """Advances `state` in place by `seconds`; commands (K, J) [rad] reach the servos at arrivals (K,) [s].

    Raises SimDiverged: the state left the finite numbers; gives the time.
    """
    steps = round(seconds / H)
    joints = len(plant.body.joints)
    record, start = np.empty((steps, len(columns(joints)))), float(state.clock[0])
    arrivals, commands = np.asarray(arrivals, float), np.asarray(commands, float).reshape(-1, joints)
    anchor = state.z[:3].copy() if anchor is None else anchor
    groups = (plant.body, plant.water, plant.motor, plant.tank, plant.odd, plant.air, anchor, plant.zero, gust)
    advance(*groups, arrivals, commands, state, record, workspace(joints))
    bad = np.flatnonzero(~np.isfinite(record[:, 0]))
    if len(bad):
        raise SimDiverged(
            f"the virtual robot left the finite numbers at t = {start + bad[0] * H:.3f} s; reduce the planted value"
        )
    return StateRecording(start + np.arange(steps) * H, record)
