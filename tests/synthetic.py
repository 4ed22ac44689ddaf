"""Made-up and simulated trials for tests. Synthetic, all of it."""

import math

import numpy as np

from fishmj import log
from fishmj.mjcf import load_robot
from fishmj.water.dynamics import planar_chain


def whole_trial(seconds=4.0, joints=3, **meta):
    """A smooth made-up trial with every table of the schema."""
    t = np.arange(0, seconds, 0.02)
    slow = t[::10]
    angles = 0.5 * np.sin(2 * math.pi * t[:, None] - np.arange(joints))
    rates = 0.5 * 2 * math.pi * np.cos(2 * math.pi * t[:, None] - np.arange(joints))
    pose = {"x": 0.1 * t - 0.7, "y": 0.02 * np.sin(t), "yaw": 0.2 * np.sin(2 * math.pi * t)}
    tables = {
        "cmd": {"t": t, **log.numbered("c#", angles)},
        "joint": {"t": t + 0.004, **log.numbered("j#", angles), **log.numbered("w#", rates)},
        "pose": {"t": t + 0.03, **pose},
        "power": {"t": t, "V": np.full_like(t, 7.4), "I": 0.4 + 0.1 * np.sin(t)},
        "gait": {"t": slow, "amplitude": np.full_like(slow, 0.5), "bias": np.zeros_like(slow), "frequency": np.ones_like(slow)},
        "velocity": {"t": t, "surge": np.full_like(t, 0.1), "sway": 0.01 * np.cos(t), "yaw_rate": 0.4 * np.cos(t)},
        "imu": {"t": t, "ax": 0.1 * np.sin(t), "ay": 0.1 * np.cos(t), "wz": 0.4 * np.cos(t)},
        "markers": {
            "t": t,
            **log.numbered("p#x", 0.1 * t[:, None] + 0.1 * np.arange(joints)),
            **log.numbered("p#y", 0.1 * angles),
        },
        "truth": {
            "t": t,
            **pose,
            "vx": np.full_like(t, 0.1),
            "vy": 0.02 * np.cos(t),
            "wz": 0.4 * np.cos(t),
            **log.numbered("j#", angles),
            **log.numbered("k#", rates),
        },
        "obs": {"t": slow, **log.numbered("o#", np.ones((len(slow), 11)) * slow[:, None])},
        "action": {"t": slow, **log.numbered("a#", np.zeros((len(slow), 3)))},
        "target": {"t": np.array([0.0]), "x": np.array([0.7]), "y": np.array([0.0])},
        "flow": {
            "t": t,
            **log.numbered("u#x", np.full((len(t), joints + 1), -0.2)),
            **log.numbered("u#y", np.zeros((len(t), joints + 1))),
        },
        "wrench": {"t": t, **{name: 0.1 * t for i in range(1, joints + 2) for name in (f"f{i}x", f"f{i}y", f"m{i}")}},
    }
    return log.Trial({"origin": "synthetic", "robot": "swift", "flow": {"speed": 0.2, "direction": math.pi}, **meta}, tables)


LAG = math.radians(60)  # between neighbouring joints


def swim(seconds=4.0, amplitude=0.5, lag=LAG, current=(-0.15, 0.0), start=(-0.7, 0.1, 0.0)):
    """The nominal fish in the strip water, open loop at 1 Hz, integrated by the closed-form chain."""
    robot = load_robot()
    ch, swimmer = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    q, v, attached = [*start, 0.0, 0.0, 0.0], [0.0] * 6, 1.0
    rows = []
    for k in range(round(seconds / ch.dt)):
        t = k * ch.dt
        command = [amplitude * math.sin(2 * math.pi * t - j * lag) * min(1.0, t) for j in range(3)]
        step = planar_chain.step(np, ch, swimmer, q, v, attached, command, [current] * ch.n, (0.0, 0.0))
        if k % 5 == 0:
            rows.append([t, *q, *v, step.power + robot.servo.idle_power, *command])
        q, v, attached = step.q, step.v, step.attached
    a = np.array(rows)
    t, volts = a[:, 0], robot.servo.voltage
    tables = {
        "truth": {
            "t": t,
            **dict(zip(("x", "y", "yaw"), a[:, 1:4].T, strict=True)),
            **dict(zip(("vx", "vy", "wz"), a[:, 7:10].T, strict=True)),
            **log.numbered("j#", a[:, 4:7]),
            **log.numbered("k#", a[:, 10:13]),
        },
        "cmd": {"t": t, **log.numbered("c#", a[:, 14:17])},
        "power": {"t": t, "V": np.full_like(t, volts), "I": a[:, 13] / volts},
        "target": {"t": np.zeros(1), "x": np.array([0.7]), "y": np.zeros(1)},
        "flow": {
            "t": t,
            **log.numbered("u#x", np.full((len(t), 4), current[0])),
            **log.numbered("u#y", np.full((len(t), 4), current[1])),
        },
    }
    speed, direction = math.hypot(*current), math.atan2(current[1], current[0])
    meta = {
        "origin": "synthetic",
        "robot": "swift",
        "controller": "open loop 1 Hz",
        "flow": {"speed": speed, "direction": direction},
    }
    return log.Trial(meta, tables, name="swim")
