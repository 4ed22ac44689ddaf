"""Checks that a described fish is possible: weight, trim and servos, and a swim in its prior water until its speed is steady."""

from typing import NamedTuple

import numpy as np

from fishmj.base.errors import SimDiverged
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.priors import displaced

BEAT = 1.0  # Hz
LONGEST = 60  # beats of swimming; a light fish needs 15 to 35 until it is within 1 % of its last speed, a heavy one 20
STEADY, BEATS = 0.01, 5  # spread of the mean speeds of the last beats over the last of them, below which the swim ends
BEND, LARGEST = np.radians(90.0), np.radians(30.0)  # of all joints together; of one
WAVE, LAG = np.radians(120.0), np.radians(60.0)  # from the first joint to the last; between neighbours at most
GOOD, WRONG = (0.8, 1.25), (0.5, 2.0)  # factor on the widths
FAST, FASTEST = 0.7, 1.0  # peak rate of the beat over the no-load speed
STRONG = 0.7  # peak drive over the stall torque
SLOW = 0.05  # body lengths a second, below which it does not swim
SPEED = "beat slower or smaller, or take a faster servo"
TORQUE = "beat slower or smaller, or take a stronger servo; at a drive of the stall torque the joints lag behind"
STRONGER = "a servo far too strong for so light a fish shakes it to pieces at 4 ms a step; check both"
HEIGHT = "see the servo's lines; is the tail fin as high as it says?"
OK, LOOK, FALSE = "ok", "look", "wrong"


class SwimCheck(NamedTuple):
    """One line of the table of checks."""

    what: str
    found: str
    expected: str
    verdict: str  # ok, look (unusual), wrong
    advice: str = ""


class StillWaterSwim(NamedTuple):
    """A gait in still water, until it is steady."""

    frequency: float  # Hz
    amplitude: float  # rad, of every joint
    speed: float  # m/s ahead, mean over the last beat
    seconds: float  # s that it swam
    steady: bool  # whether the speed had settled by then
    drive: float  # greatest of any joint, N m: up to the stall torque, and what the motor's back-EMF takes is part of it
    torque: float  # greatest at any joint, N m: the drive without the back-EMF
    finite: bool


def checks(robot: Robot, swim: StillWaterSwim) -> list[SwimCheck]:
    """All checks of a description and its swim."""
    g, servo, length = geometry_of(robot), robot.servo, robot.length
    raw = displaced(robot.links, robot.density_water).sum()
    gap = float(np.abs(g.mass - g.displaced).max())
    trim = -float(np.sum(g.displaced * (g.origin + g.buoyancy)) / robot.mass)
    depth = float(-np.sum(g.mass * g.com[:, 2]) / robot.mass)
    rate = 2 * np.pi * swim.frequency * swim.amplitude / servo.speed_no_load
    load, pace = swim.drive / servo.torque, swim.speed / length
    ahead = f"{swim.speed:.3g} m/s, {pace:.2f} lengths/s {'steady' if swim.steady else 'still changing'} at {swim.seconds:g} s"
    beat = f"servo speed, {swim.frequency:g} Hz and {np.degrees(swim.amplitude):.3g} deg"
    torque = f"{swim.torque:.3g} N m, drive {100 * load:.0f} % of {servo.torque:.4g} N m stall at {servo.voltage:g} V"
    weight = f"{robot.mass:.4g} kg, the mass"
    share, tilt = _graded(gap / robot.mass, (0, 1e-3)), _graded(abs(trim) / length, (0, 0.01))
    return [
        _line("width scale", f"{g.width_scale:.3f}", "0.8 to 1.25", _graded(g.width_scale, GOOD, WRONG)),  # a note says more
        _line("hull as measured displaces", f"{raw:.4g} kg", weight, _graded(raw / robot.mass, GOOD, WRONG)),
        _line("link weighs what it displaces", f"within {1000 * gap:.1g} g", "within 0.1 %", share),
        _line("trim: mass ahead of buoyancy", f"{round(1000 * trim, 1) + 0.0:.1f} mm", "within 1 % of length", tilt),
        _line("mass below buoyancy", f"{1000 * depth:.3g} mm", "above 0", OK if depth > 0 else FALSE, "add ballast low"),
        _line(beat, f"{100 * rate:.0f} % of no-load", "below 70 %", _graded(rate, (0, FAST), (0, FASTEST)), SPEED),
        _line("joint torque as it swims", torque, "drive below 70 %", _graded(load, (0, STRONG)), TORQUE),
        _line("stays finite", "yes" if swim.finite else "no", "yes", OK if swim.finite else FALSE, STRONGER),
        _line("swims ahead", ahead, f"above {SLOW:g} lengths/s", OK if pace > SLOW else FALSE, HEIGHT),
    ]


def _line(what: str, found: str, expected: str, verdict: str, advice: str = "") -> SwimCheck:
    """A line of the table; advice only for an unexpected value."""
    return SwimCheck(what, found, expected, verdict, "" if verdict == OK else advice)


def swim_of(sim) -> StillWaterSwim:
    """Swims a `fishmj.sim.Sim` at rest with a travelling wave until its speed is steady, for a minute at most."""
    robot, dt = sim.robot, sim.robot.timing.bus_dt
    joints = np.arange(robot.n_joints)
    amplitude = float(min(LARGEST, BEND / robot.n_joints, robot.servo.range))
    lag = min(LAG, WAVE / max(robot.n_joints - 1, 1))
    track, speeds, drive, torque, steady = [sim.pose[:3]], [], 0.0, 0.0, False
    beat = round(1 / BEAT / dt)  # ticks
    try:
        while not steady and len(speeds) < LONGEST:
            for i in range(len(speeds) * beat, (len(speeds) + 1) * beat):
                t = i * dt
                sim.step(min(t, 1.0) * amplitude * np.sin(2 * np.pi * BEAT * t - lag * joints))
                track.append(sim.pose[:3])
                force = sim.data.actuator_force
                drive = max(drive, float(np.abs(force).max()))
                torque = max(torque, float(np.abs(force - sim.swimmer.kb * sim.data.qvel[-sim.model.nu :]).max()))
            speeds.append(_ahead(np.array(track[-1 - beat :])) / (beat * dt))
            floor = max(abs(speeds[-1]), SLOW * robot.length)
            steady = len(speeds) >= BEATS and float(np.ptp(speeds[-BEATS:])) <= STEADY * floor
    except SimDiverged:
        return StillWaterSwim(BEAT, amplitude, float("nan"), len(track) * dt, False, drive, torque, False)
    finite = bool(np.isfinite(track).all())
    return StillWaterSwim(BEAT, amplitude, speeds[-1], len(speeds) * beat * dt, steady, drive, torque, finite)


def _ahead(poses: np.ndarray) -> float:
    """Way [m] along the mean heading of a beat; poses (T, 3) m, m, rad."""
    heading = poses[1:, 2].mean()
    return float((poses[-1, :2] - poses[0, :2]) @ [np.cos(heading), np.sin(heading)])


def _graded(value: float, good: tuple[float, float], possible: tuple[float, float] = (-np.inf, np.inf)) -> str:
    return OK if good[0] <= value <= good[1] else LOOK if possible[0] <= value <= possible[1] else FALSE
