"""Is the description of a fish that can be? Its weight, trim and servos, and five seconds of swimming in its prior water."""

from typing import NamedTuple

import numpy as np

from fishmj.errors import SimDiverged
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.priors import displaced

BEAT = 1.0  # Hz
SECONDS, SETTLED = 5.0, 2.0  # of swimming; of its end, whole beats, which are measured
BEND, LARGEST = np.radians(90.0), np.radians(30.0)  # of all joints together; of one
WAVE, LAG = np.radians(120.0), np.radians(60.0)  # from the first joint to the last; between neighbours at most
GOOD, WRONG = (0.8, 1.25), (0.5, 2.0)  # factor on the widths
FAST, FASTEST = 0.7, 1.0  # peak rate of the beat over the no-load speed
STRONG = 0.7  # peak torque over the stall torque
SLOW = 0.05  # body lengths a second, below which it does not swim
OK, LOOK, FALSE = "ok", "look", "wrong"


class Check(NamedTuple):
    """One line of the table."""

    what: str
    found: str
    expected: str
    verdict: str  # ok, look (unusual), wrong
    advice: str = ""


class Swim(NamedTuple):
    """Five seconds of a gait in still water."""

    frequency: float  # Hz
    amplitude: float  # rad, of every joint
    speed: float  # m/s ahead, over the last two beats
    torque: float  # greatest drive torque of any joint, N m
    finite: bool


def checks(robot: Robot, swim: Swim) -> list[Check]:
    """All checks of a description and its swim."""
    g, servo = geometry_of(robot), robot.servo
    raw = displaced(robot.links, robot.density_water).sum()
    gap = float(np.abs(g.mass - g.displaced).max())
    trim = float(np.sum(g.displaced * (g.origin + g.buoyancy)) / robot.mass)
    depth = float(-np.sum(g.mass * g.com[:, 2]) / robot.mass)
    rate = 2 * np.pi * swim.frequency * swim.amplitude / servo.speed_no_load
    load = swim.torque / servo.torque
    length = robot.length
    pace = swim.speed / length
    widths = "mass, a height or a width is off" if not GOOD[0] <= g.width_scale <= GOOD[1] else ""
    return [
        Check("width scale", f"{g.width_scale:.3f}", "0.8 to 1.25", _graded(g.width_scale, GOOD, WRONG), widths),
        Check("hull as measured displaces", f"{raw:.4g} kg", f"the mass, {robot.mass:.4g} kg", _graded(raw / robot.mass, GOOD, WRONG)),
        Check("link weighs what it displaces", f"within {1000 * gap:.2g} g", "within 1 g", OK if gap < max(1e-3, 1e-3 * robot.mass) else LOOK),
        Check("trim: mass ahead of buoyancy", f"{-1000 * trim:.2g} mm", "within 1 % of length", OK if abs(trim) < 0.01 * length else LOOK),
        Check("mass below buoyancy", f"{1000 * depth:.3g} mm", "above 0", OK if depth > 0 else FALSE, "" if depth > 0 else "add ballast low"),
        Check(
            f"servo speed, {swim.frequency:g} Hz and {np.degrees(swim.amplitude):.3g} deg", f"{100 * rate:.0f} % of no-load",
            "below 70 %", _graded(rate, (0, FAST), (0, FASTEST)), "" if rate < FAST else "beat slower or smaller, or take a faster servo",
        ),
        Check(
            "joint torque as it swims", f"{swim.torque:.3g} N m, {100 * load:.0f} % of stall", "below 70 %",
            _graded(load, (0, STRONG), (0, np.inf)), "" if load < STRONG else "the drive saturates at times; beat slower, or a stronger servo",
        ),
        Check("stays finite", "yes" if swim.finite else "no", "yes", OK if swim.finite else FALSE),
        Check(
            "swims ahead", f"{swim.speed:.3g} m/s, {pace:.2f} lengths/s", f"above {SLOW:g} lengths/s",
            OK if pace > SLOW else FALSE, "" if pace > SLOW else "see the servo's lines; is the tail fin's height right?",
        ),
    ]  # fmt: skip


def swim_of(robot: Robot, progress=lambda seconds: None) -> Swim:
    """Build the MuJoCo model and let it swim with a travelling wave in its prior water, still. progress: called with s."""
    from fishmj.sim import Sim

    joints = np.arange(robot.n_joints)
    amplitude = float(min(LARGEST, BEND / robot.n_joints, robot.servo.range))
    lag = min(LAG, WAVE / max(robot.n_joints - 1, 1))
    sim, track, torque = Sim(robot), [], 0.0
    ticks = round(SECONDS / robot.timing.bus_dt)
    try:
        for i in range(ticks):
            t = i * robot.timing.bus_dt
            sim.step(min(t, 1.0) * amplitude * np.sin(2 * np.pi * BEAT * t - lag * joints))
            track.append(sim.pose[:3])
            torque = max(torque, float(np.abs(sim.data.actuator_force).max()))
            progress(t)
    except SimDiverged:
        return Swim(BEAT, amplitude, float("nan"), torque, False)
    start, end = track[-1 - round(SETTLED / robot.timing.bus_dt)], track[-1]
    heading = float(np.mean([pose[2] for pose in track[-round(SETTLED / robot.timing.bus_dt) :]]))
    ahead = float((end[:2] - start[:2]) @ [np.cos(heading), np.sin(heading)]) / SETTLED
    return Swim(BEAT, amplitude, ahead, torque, bool(np.isfinite(track).all()))


def _graded(value: float, good: tuple[float, float], possible: tuple[float, float]) -> str:
    return OK if good[0] <= value <= good[1] else LOOK if possible[0] <= value <= possible[1] else FALSE


__all__ = ["Check", "Swim", "checks", "swim_of"]
