"""The blocks of the campaign: for each kind of movement, what its k-th episode is, drawn from a few numbers in [0, 1).

A block is a function (k, u (9,), robot) -> keywords of a `Segment`: drive, flow, pose, joints, settle. Draws of neighbouring k
come from one low-discrepancy sequence, so a part of a block is spread like the whole. Angles rad; u is used in order.
"""

from collections.abc import Callable
from math import cos, pi, radians, sin
from typing import Any

import numpy as np

from fishmj.calib import constant
from fishmj.flow import Flow
from fishmj.mjcf.description import Robot

DRAWS = 9
SETTLE = 3.0  # s of flow past a held fish before its record
SWEEP = radians(4)  # rad/s, at which a held fish turns through the angles of attack: 1 % of the slowest stream at its nose
SPEEDS = (0.1, 0.2, 0.3)  # m/s
CELLS = ((1, 1), (0, 0), (2, 0), (0, 1), (2, 1), (1, 0))  # of frequency and amplitude; the middle of the range first
Made = dict[str, Any]


def within(u: float, low: float, high: float) -> float:
    return low + (high - low) * float(u)


def static(k: int, u, robot: Robot) -> Made:
    """A held fish in a stream: four postures, three speeds, the water from every side; three of four turn slowly."""
    reach, n = robot.servo.range / 3, robot.n_joints
    bends = np.array([np.zeros(n), np.full(n, 1.0), np.full(n, 2.0), 1.5 * (-1.0) ** np.arange(n)])
    joints = tuple((reach * bends[k % 4]).tolist())
    attack, side = pi * float(u[0]), 1 if u[1] < 0.5 else -1
    rate = 0.0 if k % 16 in (3, 6, 9, 12) else SWEEP * (1 if attack < pi / 2 else -1)  # each posture is held still, too
    flow = Flow(speed=SPEEDS[(k + k // 4) % 3], direction=pi)
    drive = {"kind": "hold", "rate": -side * rate}
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, -side * attack), "joints": joints, "settle": SETTLE}


def oscillation(k: int, u, robot: Robot) -> Made:
    """Forced oscillation in still water, for the added mass: heave, yaw, surge, each joint alone."""
    names = ["y", "yaw", *(f"j{i + 1}" for i in range(robot.n_joints)), "x"]
    along, frequency = names[k % len(names)], within(u[0], 0.5, 2.0)
    most, fastest = {"x": (0.06, 0.3), "y": (0.05, 0.3), "yaw": (0.25, 0.8)}.get(along, (radians(25), 3.0))  # m, m/s; rad, rad/s
    amplitude = within(u[1], 0.4, 1.0) * min(most, fastest / (2 * pi * frequency))
    bent = tuple((robot.servo.range / 3 * within(u[2], -1, 1) * np.ones(robot.n_joints)).tolist()) if u[3] < 0.4 else ()
    drive = {"kind": "shake", "along": along, "amplitude": amplitude, "frequency": frequency}
    return {"drive": drive, "joints": bent, "settle": 1 / frequency}


def chirp(k: int, u, robot: Robot) -> Made:
    """Joints from 0.2 to 3 Hz: held in a stream and to the letter, or free by the servos."""
    held = k % 2 == 0
    drive = {"kind": "chirp", "low": 0.2, "high": 3.0, "held": held, "amplitude": radians(within(u[0], 8, 25 if held else 35))}
    drive |= {"ratio": within(u[1], 0.7, 1.3), "lag": radians(within(u[2], -90, 120))}
    flow = Flow(speed=(0.0, 0.2, 0.4)[k // 2 % 3] if held else _current(u[3]), direction=pi if held else 2 * pi * float(u[4]))
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, 0.0 if held else 2 * pi * float(u[5]))}


def gait(k: int, u, robot: Robot) -> Made:
    """Swimming from rest: frequency, amplitude, lag, bias, stream and heading; a third swims straight, a half in still water."""
    bias = 0.0 if u[3] < 0.35 else radians(within((u[3] - 0.35) / 0.65, -30, 30))
    return {"drive": _wave(u, bias), "flow": Flow(speed=_current(u[4]), direction=2 * pi * float(u[5])), "pose": _heading(u[6])}


def straight(k: int, u, robot: Robot) -> Made:
    """Straight ahead from rest in still water, one draw from each of six cells of frequency and amplitude."""
    column, row = CELLS[k % len(CELLS)]
    wave = {"frequency": 0.5 + 0.45 * (column + float(u[0])), "amplitude": radians(12 + 11 * (row + float(u[1])))}
    drive = {"kind": "gait", "bias": 0.0, "lag": radians(within(u[2], 45, 75))}
    return {"drive": drive | wave, "pose": _heading(u[6])}


def turning(k: int, u, robot: Robot) -> Made:
    """Turning from rest in still water: a bias of 8 to 30 deg to either side."""
    wave = {"frequency": within(u[0], 0.8, 1.6), "amplitude": radians(within(u[1], 15, 30)), "lag": radians(within(u[2], 45, 75))}
    return {"drive": {"kind": "gait", "bias": radians(within(u[3], 8, 30)) * (-1) ** k} | wave, "pose": _heading(u[6])}


def random(k: int, u, robot: Robot) -> Made:
    """New random targets every control step, in a straight line or held, as an untrained policy gives them."""
    drive = {"kind": "targets", "amplitude": within(u[0], 0.15, 0.75) * robot.servo.range, "path": ("linear", "hold")[k % 2]}
    flow = Flow(speed=_current(u[1]), direction=2 * pi * float(u[2]))
    return {"drive": drive | {"seed": int(1e6 * u[3])}, "flow": flow, "pose": _heading(u[4])}


def manoeuvre(k: int, u, robot: Robot) -> Made:
    """Steps of amplitude, coasting, C-turns, start and stop, braking with a bent body, a stream from behind."""
    f, a, far = within(u[0], 0.8, 1.8), radians(within(u[1], 18, 32)), radians(within(u[2], 60, 120)) * (1 if u[3] < 0.5 else -1)
    phases = (
        [(4.0, f, a, 0.0), (9.0, f, 0.0, 0.0)],  # coast
        [(1.0, f, 0.0, 0.0), (0.7, f, 0.0, far), (9.0, f, a, 0.0)],  # C-turn from rest
        [(2.5, f, a, 0.0), (2.0, f, 0.0, 0.0)] * 3,  # start and stop
        [(4.0, f, a, 0.0), (2.5, f, 0.0, far), (9.0, f, a, 0.0)],  # brake
        [(3.0, f, a / 2, 0.0), (3.0, f, a, 0.0), (9.0, f / 2, a, 0.0)],  # steps
        [(3.0, f, a, 0.0), (2.0, f, a, far / 2), (9.0, f, a, -far / 2)],  # a stream from behind, S-turn
    )[k % 6]
    heading = 2 * pi * float(u[4])
    reverse = k % 6 == 5
    flow = Flow(
        speed=within(u[5], 0.1, 0.3) if reverse else _current(u[5]), direction=heading if reverse else 2 * pi * float(u[6])
    )
    drive = {"kind": "manoeuvre", "phases": phases, "lag": radians(within(u[7], 40, 80))}
    return {"drive": drive, "flow": flow, "pose": (0.0, 0.0, heading)}


def uneven(k: int, u, robot: Robot) -> Made:
    """Swimming through gusts, shear, a vortex street and turbulence."""
    preset = ("gust", "shear", "vortex_street", "default", "gust", "fine")[k % 6]
    direction = 2 * pi * float(u[5])
    flow = Flow(
        speed=within(u[4], 0.1, 0.35),
        direction=direction,
        turbulence=preset,
        intensity=within(u[3], 0.05, 0.25),
        seed=int(1e6 * u[7]),
    )
    heading = (0.0, 0.0, direction + pi + radians(within(u[6], -60, 60)))
    return {"drive": _wave(u, 0.0), "flow": flow, "pose": heading}


def steered(k: int, u, robot: Robot, helms: tuple[Made, ...]) -> Made:
    """A controller or policy on its way to a target 1.4 m off and at it, from any heading, in a turbulent stream."""
    speed, direction, far = within(u[0], 0.0, 0.35), 2 * pi * float(u[1]), constant("protocol", "distance")
    near = 0.2 if k % 3 == 2 else 1.0  # of the distance: every third episode begins close to the target
    where = 2 * pi * float(u[2])
    target = (near * far * cos(where), near * far * sin(where))
    flow = Flow(
        speed=speed,
        direction=direction,
        turbulence=("default", "gust")[k // 2 % 2],
        intensity=within(u[4], 0.0, 0.1),
        seed=int(1e6 * u[5]),
    )
    drive = {"kind": "policy", "target": target, "seed": int(1e6 * u[6])}
    return {"drive": drive | helms[k % len(helms)], "flow": flow, "pose": _heading(u[3])}


def flapping(k: int, u, robot: Robot) -> Made:
    """A held fish that goes through a gait to the letter, at rest or in a stream from ahead: what its beat pushes with."""
    wave = {"frequency": within(u[0], 0.5, 1.8), "amplitude": radians(within(u[1], 10, 32)), "lag": radians(within(u[2], 30, 90))}
    drive = {"kind": "gait", "held": True, "bias": 0.0 if k % 3 else radians(within(u[3], -25, 25))}
    flow = Flow(speed=(0.0, 0.15, 0.3)[(k + k // 3) % 3], direction=pi)
    return {"drive": drive | wave, "flow": flow, "pose": (0.0, 0.0, radians(within(u[4], -15, 15))), "settle": SETTLE / 2}


def _wave(u, bias: float) -> Made:
    wave = {"frequency": within(u[0], 0.4, 2.0), "amplitude": radians(within(u[1], 6, 35)), "lag": radians(within(u[2], 30, 90))}
    return {"kind": "gait", "bias": bias} | wave


def _current(u: float) -> float:
    """Half still water, half up to 0.45 m/s."""
    return 0.0 if u < 0.5 else 0.9 * (float(u) - 0.5)


def _heading(u: float) -> tuple[float, float, float]:
    return 0.0, 0.0, 2 * pi * float(u)


BLOCKS: dict[str, Callable[..., Made]] = {
    "static": static,
    "oscillation": oscillation,
    "chirp": chirp,
    "gait": gait,
    "straight": straight,
    "turning": turning,
    "random": random,
    "manoeuvre": manoeuvre,
    "uneven": uneven,
    "policy": steered,
    "flapping": flapping,  # draws go by the place in this table: a new block comes last
}
