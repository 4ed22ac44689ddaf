"""A controller of your own against a shipped one, on the same trials.

    python examples/own_controller.py

A controller has `reset(n)` and `__call__(obs)`. It sees the 11 observations of n trials (target and velocity in the fish's own
axes, yaw rate, joint angles and rates; noisy and late) and answers with the bus commands until the next look, in rad.
On the command line: `fishmj evaluate examples/own_controller.py:Chase pd`.
"""

import numpy as np

from fishmj import evaluate
from fishmj.mjcf import load_robot


class Chase:
    """A travelling wave of 1 Hz whose mean bends the fish towards its target; slower when near."""

    name = "chase"

    def __init__(self, robot):
        self.joints, self.dt = robot.n_joints, robot.timing.bus_dt
        self.ticks = round(robot.timing.control_dt / self.dt)

    def reset(self, n):
        self.time = 0.0

    def __call__(self, obs):
        t = self.time + self.dt * np.arange(1, self.ticks + 1)
        self.time = t[-1]
        wave = np.sin(2 * np.pi * t[:, None] - np.radians(60) * np.arange(self.joints))  # (T, J)
        distance, sight = np.hypot(obs[:, 0], obs[:, 1]), np.arctan2(obs[:, 1], obs[:, 0])  # (B,) m, rad
        amplitude = np.clip(0.25 + 0.3 * distance, 0.25, 0.45)
        bend = -0.3 * np.clip(sight, -1, 1)
        return amplitude[:, None, None] * wave + bend[:, None, None]  # (B, T, J) rad


if __name__ == "__main__":
    robot = load_robot("fish")
    trials = evaluate.trials(speeds=[0.1], los_deg=[0, 90, 270], repeats=1, duration=30.0)
    for controller in (Chase(robot), "pd"):
        result = evaluate.run(controller, robot, trials)
        first, last = result.distance[:, 0].mean(), result.distance[:, -500:].mean()
        print(f"{result.controller:<6} {first:.2f} m off at first, {last:.2f} m in the last 10 s, {result.power.mean():.2f} W")
