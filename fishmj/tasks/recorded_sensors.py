"""What the sensors write down of a swim whose truth is known: the tables `joint` and `pose` of a log, as late and as noisy as the
task's own observations.

    joint    encoders at the end of every bus tick, through the robot's measurement effects and joint delay, plus noise
    pose     the tracker's frame that arrives at the end of every bus tick: the pose of `camera` ticks before, through the robot's
             measurement effects, plus noise; before the first frame arrives the fish is seen at its start

An observation holds other draws of the same noise: it is made of a frame in the body's axes, once a control step.
"""

from math import radians

import numpy as np

from fishmj.calib import constant
from fishmj.log import numbered
from fishmj.mjcf.description import Robot
from fishmj.tasks.sensing import Sensors, readings

NOTE = (
    "simulated; joint: encoders, pose: the tracker's frame that arrives at each stamp, with the task's noise and camera latency"
    " (sigma, latency); power and truth: exact; obs: what the controller saw, other draws of the same noise"
)


def sigmas(joints: int, strength: float = 1.0) -> dict[str, float]:
    """Standard deviation of the noise of every column, in its unit; strength: factor on the task's."""
    get = lambda key: strength * constant("noise", key)
    angle, rate = radians(get("joint_deg")), get("joint_rate")
    each = {f"{letter}{i + 1}": value for letter, value in (("j", angle), ("w", rate)) for i in range(joints)}
    return {"x": get("position"), "y": get("position"), "yaw": get("yaw"), **each}


def sensed(
    robot: Robot,
    t: np.ndarray,
    pose: np.ndarray,
    joint: np.ndarray,
    rate: np.ndarray,
    *,
    start: np.ndarray,
    camera: int,
    effects: np.ndarray,
    random: np.random.Generator,
    strength: float = 1.0,
) -> dict[str, dict[str, np.ndarray]]:
    """Tables `joint` and `pose` of one swim.

    Args:
        t: (T,) s, ends of the bus ticks. pose: (T, 3) m, rad; joint, rate: (T, J) rad, rad/s, then.
        start: (3,) where the fish was before the first tick, straight and at rest. camera: its latency in bus ticks.
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


def clocks(tables) -> dict[str, str]:
    """Which clock stamped what: one, the simulation's; the tracker stamps a frame when it arrives."""
    return {name: "simulation, frame received" if name == "pose" else "simulation" for name in tables}
