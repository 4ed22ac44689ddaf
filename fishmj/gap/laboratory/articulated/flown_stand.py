"""Quadrotor session: reference flights, flight controller, cameras that measure the pose, and logs.

    reference   sums of sines of position and yaw, and faster ones of roll and pitch, which excite the inertia
    control     position -> acceleration -> thrust and attitude -> rotor thrusts, for the described robot; rates from a gyro
    commands    delayed, held, lost or rounded, as for an arm (robot_stand.py)
    pose        position and quaternion with noise and delay; one stamp for commands and pose

Random forces and torques, redrawn every 60 ms, are as large as data/calib/robot.toml allows for a healthy robot.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fishmj.gap.laboratory.articulated.flown_faults import FLOWN
from fishmj.gap.laboratory.articulated.flown_plant import FlownMujoco
from fishmj.gap.laboratory.articulated.hidden_faults import Hidden, UsualMotion, with_hidden
from fishmj.gap.laboratory.articulated.robot_plan import GRAVITY, RobotPlan, tolerances, within_tolerance
from fishmj.gap.laboratory.articulated.robot_stand import SLOW, Channel, over_scatter, pushes, pushes_at, replay, timing_of

REACH, TONES = 0.7, (0.12, 0.6)  # m; Hz of positions
WIGGLE, QUICK = 0.12, (0.8, 2.2)  # rad; Hz of roll and pitch
SLOW_LOOP, FAST_LOOP = 1.6, 7.0  # rad/s, of position and of attitude
LEAK, MOST = 0.5, 6.0  # 1/s, integral gain of the position error; m/s2
AWAY = 20.0  # largest state of a valid flight, in m, m/s and rad/s
GYRO = 0.01  # rad/s
UPRIGHT = np.array([0.0, 0.0, 1.0])


class FlownStand(NamedTuple):
    """Controller and cameras. tick: s. place [m], turn [rad]: standard deviations of the pose."""

    tick: float
    place: float
    turn: float
    seconds: float
    logs: int


class FlownLog(NamedTuple):
    """One log: stamps (K,) s, commands (K, A) N, readings (K, 7); clean: readings without noise; true states (K, 13)."""

    t: np.ndarray
    commands: np.ndarray
    readings: np.ndarray
    clean: np.ndarray
    states: np.ndarray
    wrench: np.ndarray  # (K, 6) of the rotors' commands: N in the world, N m in the body


def draw_flown_stand(rng: np.random.Generator, logs: int, seconds: float) -> FlownStand:
    """Draws cameras at 100 to 250 Hz."""
    return FlownStand(
        float(rng.choice((0.004, 0.005, 0.01))), float(rng.uniform(2e-4, 8e-4)), float(rng.uniform(1e-3, 3e-3)), seconds, logs
    )


class FlightReference:
    """Position, yaw, roll and pitch of one log as functions of time: sums of sines that start at rest."""

    def __init__(self, rng: np.random.Generator, reach: float):
        self.pulse = 2.0 * np.pi * np.concatenate([rng.uniform(*TONES, (4, 3)), rng.uniform(*QUICK, (2, 3))])
        self.size = rng.dirichlet(np.ones(3), 6) * reach * np.array([REACH, REACH, REACH, 0.8, WIGGLE, WIGGLE])[:, None]
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """(6,) x, y, z, yaw, roll, pitch and their rates."""
        arc, ramp = self.pulse * t + self.phase, min(t / 1.0, 1.0)
        value = np.sum(self.size * (np.sin(arc) - np.sin(self.phase)), 1)
        slope = np.sum(self.size * self.pulse * np.cos(arc), 1)
        return ramp * value, ramp * slope + (value if ramp < 1.0 else 0.0)


class FlightController:
    """Controller of one log, tuned to the described robot."""

    def __init__(self, plan: RobotPlan, reference: FlightReference, tick: float):
        self.reference, self.tick, self.body = reference, tick, plan.limbs[0]
        place, turn = plan.of_rotors("place"), plan.of_rotors("turn")
        lever = np.stack([np.cross(p, UPRIGHT) + c * UPRIGHT for p, c in zip(place, turn, strict=True)], 1)
        self.mix = np.concatenate([np.ones((1, len(place))), lever])  # rotor thrusts -> thrust and torque
        self.limit = plan.of_rotors("limit")
        self.last_position: np.ndarray | None = None
        self.rate, self.integral = np.zeros(3), np.zeros(3)

    def command(self, t: float, pose: np.ndarray, gyro: np.ndarray) -> np.ndarray:
        """Thrusts (A,) at one tick, from the measured pose (7,) and the gyro (3,)."""
        target, slope = self.reference.at(t)
        if self.last_position is not None:
            self.rate += 0.25 * ((pose[:3] - self.last_position) / self.tick - self.rate)
        self.last_position = pose[:3]
        error = target[:3] - pose[:3]
        self.integral += LEAK * error * self.tick
        acceleration = SLOW_LOOP**2 * (error + self.integral) + 1.8 * SLOW_LOOP * (slope[:3] - self.rate)
        force = self.body.mass * (np.clip(acceleration, -MOST, MOST) + GRAVITY * UPRIGHT)
        turn = Rotation.from_quat(pose[3:], scalar_first=True)
        up = force / np.linalg.norm(force)
        ahead = np.array([np.cos(target[3]), np.sin(target[3]), 0.0])
        left = np.cross(up, ahead)
        left /= np.linalg.norm(left)
        wanted = Rotation.from_matrix(np.stack([np.cross(left, up), left, up], 1)) * Rotation.from_rotvec([*target[4:], 0.0])
        off = (turn.inv() * wanted).as_rotvec()
        spin = FAST_LOOP**2 * off - 1.7 * FAST_LOOP * gyro
        torque = np.array(self.body.inertia) * spin + np.cross(self.body.centre, [0.0, 0.0, self.body.mass * GRAVITY])
        thrust = float(force @ turn.apply(UPRIGHT))
        return np.clip(np.linalg.solve(self.mix, [thrust, *torque]), 0.0, self.limit)


def fly(plant: Any, described: RobotPlan, reference: FlightReference, stand: FlownStand, hidden: Hidden, push, rng) -> FlownLog:
    """Flies one log. plant: true robot. push: random wrenches (n, 6), one per spacing. Raises FloatingPointError."""
    h, every = plant.h, round(stand.tick / plant.h)
    timing = timing_of(hidden, len(described.rotors))
    rows = round(stand.seconds / stand.tick)
    ticks = rows + int(SLOW * rows) + 2
    pilot, channel = FlightController(described, reference, stand.tick), Channel(timing, rng)
    plant.start(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(6))
    grid = h * np.arange(ticks * every + 1)
    disturbance = pushes_at(push, grid)
    states = np.zeros((len(grid), 13))
    states[0, 3] = 1.0
    noise = rng.standard_normal((ticks, 6)) * np.repeat([stand.place, stand.turn], 3)
    sent, wrench = [], []
    for k in range(ticks):
        place = max(0, k * every - round(timing.seen_late / h))
        gyro = states[k * every, 10:] + GYRO * rng.standard_normal(3)
        u = pilot.command(k * stand.tick, _with_noise(states[place, :7], noise[k]), gyro)
        sent.append(u)
        force = pilot.mix @ u
        up = Rotation.from_quat(states[k * every, 3:7], scalar_first=True).apply(UPRIGHT)
        wrench.append([*(force[0] * up), *force[1:]])
        channel.send(k * stand.tick, u)
        for n in range(k * every, (k + 1) * every):
            plant.step(channel.delivered(n * h), disturbance[n])
            states[n + 1] = *plant.q, *plant.v
        if not np.all(np.abs(states[n + 1]) < AWAY):
            raise FloatingPointError("the robot flew away")
    stamps = stand.tick * np.arange(rows)
    when = np.maximum(stamps / timing.rate - timing.seen_late, 0.0)
    logged = np.stack([np.interp(when, grid, column) for column in states.T], 1)
    logged[:, 3:7] /= np.linalg.norm(logged[:, 3:7], axis=1, keepdims=True)
    readings = _with_noise(logged[:, :7], noise[:rows])
    return FlownLog(stamps, np.array(sent[:rows]), readings, logged[:, :7], logged, np.array(wrench[:rows]))


def _with_noise(pose: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Pose (.., 7) with noise (.., 6) of position and rotation vector."""
    turn = Rotation.from_quat(pose[..., 3:], scalar_first=True) * Rotation.from_rotvec(noise[..., 3:])
    return np.concatenate([pose[..., :3] + noise[..., :3], turn.as_quat(scalar_first=True)], -1)


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Difference of poses (K, 6): m, and rotation vectors, rad."""
    a, b = (Rotation.from_quat(pose[:, 3:], scalar_first=True) for pose in (one, other))
    return np.concatenate([one[:, :3] - other[:, :3], (b.inv() * a).as_rotvec()], 1)


Build = Callable[[RobotPlan, Hidden], Any]


def usual_flight(described: RobotPlan, seed: int, stand: FlownStand) -> UsualMotion:
    """90th percentiles of the wrenches, rates and commands in flights of the described robot."""
    nothing = np.zeros((int(1.1 * stand.seconds / tolerances()["spacing"]) + 2, 6))
    logs = [
        fly(FlownMujoco(described, {}), described, reference, stand, {}, nothing, np.random.default_rng([seed, 36]))
        for reference in references(seed, min(2, stand.logs))
    ]
    size = lambda parts: np.percentile(np.abs(np.concatenate(parts)), 90, axis=0)
    return UsualMotion(size([x.wrench for x in logs]), size([x.states[:, 7:] for x in logs]), size([x.commands for x in logs]))


def references(seed: int, logs: int) -> list[FlightReference]:
    """Reference of each log of a session."""
    reaches = np.linspace(0.6, 1.1, logs)
    return [FlightReference(np.random.default_rng([seed, 31, i]), reach) for i, reach in enumerate(reaches)]


def flown_session(
    build: Build, described: RobotPlan, hidden: Hidden, stand: FlownStand, usual: UsualMotion, seed: int
) -> list[FlownLog]:
    """Logs of a robot drawn within the tolerances of `described`, with `hidden` in it. Raises FloatingPointError."""
    true = with_hidden(within_tolerance(described, np.random.default_rng([seed, 32])), hidden, FLOWN)
    out = []
    for i, reference in enumerate(references(seed, stand.logs)):
        rng = np.random.default_rng([seed, 33, i])
        push = pushes(usual, stand.seconds, rng)
        out.append(fly(build(true, hidden), described, reference, stand, hidden, push, rng))
    return out


def flown_visibility(
    build: Build, described: RobotPlan, stand: FlownStand, usual: UsualMotion, seed: int, logs: list[FlownLog]
) -> float:
    """Mean square of the hidden effects over noise and the scatter of healthy robots; largest over the coordinates."""
    noise = np.repeat([stand.place, stand.turn], 3) ** 2
    replayed = lambda plan, log, push: replay(build(plan, {}), log, stand, push, lambda state: (state[:7], state[7:]))
    return over_scatter(replayed, apart, noise, described, stand.seconds, usual, seed, logs)
