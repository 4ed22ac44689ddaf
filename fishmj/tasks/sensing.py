"""Sensor models of a robot, measurement effects, delays and noise, and logs of their readings.

    poses     frames of the camera as the tracker reports them: camera_scale, marker_offset, ..
    joints    encoder readings: offset, and the delay of the clock `joint`, linear between bus ticks
    ticks     delays of the clocks `pose` and `velocity` [s], rounded up to whole bus ticks like the camera's latency

Without such effects every function returns its input. Rewards, terminations and true-state logs do not use this module.
"""

from math import ceil, radians

import numpy as np

from fishmj.base.calib import constant
from fishmj.effects import EffectStack
from fishmj.effects.sites import SensorReadings
from fishmj.engines.extensions import Extensions
from fishmj.log import numbered
from fishmj.mjcf.description import Robot

NOTE = (
    "simulated; joint: encoders, pose: the tracker's frame that arrives at each stamp, with the task's noise and camera latency"
    " (sigma, latency); power and truth: exact; obs: observations of the controller, with other draws of the same noise"
)


def slope_weights(window: int, dt: float) -> np.ndarray:
    """Weights (W,), 1/s, oldest first, that turn W equally spaced samples into the slope of their line fit."""
    t = (np.arange(window) - (window - 1) / 2) * dt
    return t / np.sum(t * t)


def estimate(xp, poses, dt: float):
    """Pose and velocity from camera poses (..., W, 3) [m, m, rad; yaw unwrapped], oldest first, dt [s] apart.

    A straight line is fitted to the last W poses at t_k = k dt (least squares; a first-order Savitzky-Golay filter):
        v = sum_k (t_k - mean t) p_k / sum_k (t_k - mean t)^2
    Its estimate is late by (W - 1) dt / 2; the newest pose itself is not smoothed. The same code runs beside the tank.

    Returns:
        pose (..., 3) and velocity (..., 3), world frame, m, rad, m/s, rad/s.
    """
    weights = xp.asarray(slope_weights(poses.shape[-2], dt), dtype=poses.dtype)
    return poses[..., -1, :], xp.sum(poses * weights[:, None], -2)


def delayed(xp, history, frames, window: int):
    """The `window` newest poses that have arrived, of history (B, H, 3), newest last, with delay `frames` (B,) int ticks."""
    rows = xp.arange(history.shape[0])[:, None]
    columns = history.shape[1] - window - frames[:, None] + xp.arange(window)[None, :]
    return history[rows, columns]


class Sensors:
    """The sensors of `robot`.

    Attributes:
        behind: number of older encoder readings to keep, bus ticks.
        frames: number of additional camera frames to keep.
    """

    def __init__(self, robot: Robot):
        self.added, self.tick = Extensions.of(robot), robot.timing.bus_dt
        whole = lambda seconds: ceil(seconds / self.tick - 1e-6)
        self.behind = whole(self.added.latest("joint"))
        self.slow = whole(self.added.latest("velocity"))
        self.frames = whole(self.added.latest("pose")) + self.slow
        active = self.added.active
        self.measured = active if active is not None and any(e.measure for e in active.effects) else None

    def ticks(self, xp, seconds, rows, clock: str):
        """Latency (B,) s plus the effects' delay with parameters `rows` (B, P), in whole ticks, at least 0."""
        return xp.maximum(xp.ceil((seconds + self.added.late(xp, rows, clock)) / self.tick - 1e-6), 0.0).astype("int32")

    def poses(self, xp, rows, history):
        """Poses (B, H, 3) as the tracker reports them."""
        if self.measured is None:
            return history
        zero = 0.0 * history[..., 0]
        seen = measure(
            self.measured, xp, rows, SensorReadings(zero, history[..., 0], history[..., 1], history[..., 2], history * 0.0, zero)
        )
        return xp.stack([seen.x + zero, seen.y + zero, seen.yaw + zero], -1)

    def joints(self, xp, rows, recent):
        """Joint angles and rates (B, J) as the encoders report them now, from `recent` (B, behind + 1, 2 J), newest last."""
        joints = recent.shape[-1] // 2
        now = recent[:, -1]
        if self.behind:
            late = xp.minimum(xp.maximum(self.added.late(xp, rows, "joint") / self.tick, 0.0), float(self.behind))
            older = xp.minimum(xp.floor(late), self.behind - 1.0)
            share = (late - older)[:, None]
            row = xp.arange(recent.shape[0])
            newer = recent.shape[1] - 1 - older.astype("int32")
            now = (1.0 - share) * recent[row, newer] + share * recent[row, newer - 1]
        angle, rate = now[:, :joints], now[:, joints:]
        if self.measured is not None:
            zero = 0.0 * angle[:, None, 0]
            angle = measure(self.measured, xp, rows, SensorReadings(zero, zero, zero, zero, angle[:, None], zero)).joint[:, 0]
        return angle, rate


def measure(active: EffectStack, xp, rows, seen: SensorReadings) -> SensorReadings:
    """Records (B, T) after the measurement effects with parameters `rows` (B, P)."""
    return active.measure(xp, [rows[:, i : i + 1] for i in range(rows.shape[1])], seen)


def readings(xp, joint, rate):
    """Encoder readings (B, T, 2 J) of a trace."""
    return xp.concatenate([joint, rate], -1)


def sigmas(joints: int, strength: float = 1.0) -> dict[str, float]:
    """Standard deviation of the noise of every column, in its unit; strength: factor on the task's."""
    get = lambda key: strength * constant("noise", key)
    angle, rate = radians(get("joint_deg")), get("joint_rate")
    each = {f"{letter}{i + 1}": value for letter, value in (("j", angle), ("w", rate)) for i in range(joints)}
    return {"x": get("position"), "y": get("position"), "yaw": get("yaw"), **each}


def sensed(
    robot: Robot, t, pose, joint, rate, *, start, camera: int, effects, random: np.random.Generator, strength: float = 1.0
) -> dict[str, dict[str, np.ndarray]]:
    """Tables `joint` and `pose` of one swim, with the latency and noise of the task's observations.

    joint: encoders at the end of every bus tick. pose: the tracker's frame that arrives then, taken `camera` ticks before; the
    start pose until the first frame arrives. Observations have other draws of the same noise, in body axes, once per control
    step.

    Args:
        t: (T,) s, ends of the bus ticks. pose: (T, 3) m, rad; joint, rate: (T, J) rad, rad/s, then.
        start: (3,) pose before the first tick, of a straight fish at rest. camera: latency in bus ticks.
        effects: (P,) parameters of the robot's effects. random: draws the noise. strength: factor on the task's noise.
    """
    sensors, count, joints = Sensors(robot), len(t), robot.n_joints
    rows = np.broadcast_to(effects, (count, len(effects)))
    frames = np.concatenate([np.broadcast_to(start, (camera, 3)), pose])[:count]
    seen = np.asarray(sensors.poses(np, effects[None], frames[None]))[0]
    before = np.zeros((sensors.behind, 2 * joints))
    kept = np.concatenate([before, readings(np, joint[None], rate[None])[0]])
    recent = np.stack([kept[k : k + count] for k in range(sensors.behind + 1)], 1)  # (T, behind + 1, 2 J), newest last
    angle, turning = sensors.joints(np, rows, recent)
    sigma = sigmas(joints, strength)
    noise = random.standard_normal((count, 3 + 2 * joints))
    seen = seen + noise[:, :3] * [sigma["x"], sigma["y"], sigma["yaw"]]
    angle = angle + noise[:, 3 : 3 + joints] * sigma["j1"]
    turning = turning + noise[:, 3 + joints :] * sigma["w1"]
    return {
        "joint": {"t": t, **numbered("j#", angle), **numbered("w#", turning)},
        "pose": {"t": t, "x": seen[:, 0], "y": seen[:, 1], "yaw": seen[:, 2]},
    }


def logged(robot: Robot, begun, t, command, pose, velocity, joint, rate, power, fish, camera, **sensing) -> dict:
    """Tables `cmd`, `joint`, `pose`, `power` and `truth` of one swim.

    Args:
        begun, t: (T,) s, starts and ends of the bus ticks. command: (T, J) rad. power: (T,) W, with idle.
        pose, velocity: (T, 3) m, rad, m/s, rad/s; joint, rate: (T, J) rad, rad/s, at `t`.
        fish, camera: `FishParams` and latency (1,) in bus ticks. sensing: start, random, strength of `sensed`.
    """
    volts, names = robot.servo.voltage, ("x", "y", "yaw", "vx", "vy", "wz")
    known = {"camera": int(camera[0]), "effects": np.asarray(fish.effects[0], float), **sensing}
    exact = dict(zip(names, (*pose.T, *velocity.T), strict=True))
    return {
        "cmd": {"t": begun, **numbered("c#", command)},
        **sensed(robot, t, pose, joint, rate, **known),
        "power": {"t": t, "V": np.full(len(t), volts), "I": power / volts},
        "truth": {"t": t, **exact, **numbered("j#", joint), **numbered("k#", rate)},
    }


def logged_meta(robot: Robot, tables, fish, camera, start, strength: float) -> dict:
    """Metadata in the log of a swim from rest at `start` (3,): noise, clocks, latencies; `fish` and `camera` as in `logged`."""
    received = {"pose": "simulation, frame received"}  # one clock, the simulation's; the tracker stamps a frame when it arrives
    pose, command = float(camera[0]) * robot.timing.bus_dt, float(np.asarray(fish.delay)[0]) * robot.timing.physics_dt
    return {
        "replicate_of": "",
        "start": start.tolist(),
        "push": [0.0, 0.0, 0.0],
        "sigma": sigmas(robot.n_joints, strength),
        "clock": {name: received.get(name, "simulation") for name in tables},
        "latency": {"pose": pose, "command": command},
    }
