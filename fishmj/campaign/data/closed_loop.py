"""A controller at the helm of a segment: it sees the numbers that it would see anywhere, noisy and late, every control step."""

from math import ceil

import numpy as np

from fishmj import controllers
from fishmj.campaign.data.segment import Segment
from fishmj.engines import ticks_per
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task


class ClosedLoop:
    """Called as (tick, run) once every bus tick, in order; returns the command (J,) rad.

    Raises:
        UnknownName, ConfigError: no such controller, or none for this robot.
    """

    def __init__(self, segment: Segment, robot: Robot, controller: str, target, seed: int, noise: float):
        self.robot, self.target = robot, np.asarray(target, float)[None]
        self.brain = controllers.make(controller, robot)
        self.brain.reset(1)
        self.every = ticks_per(robot)[1]
        self.camera = np.array([ceil(robot.timing.camera_latency / robot.timing.bus_dt - 1e-6)])
        self.rng, self.noise = np.random.default_rng([11, seed]), noise
        self.history = np.repeat(np.asarray(segment.pose, float)[None, None], task.history_length(robot), 1)

    def __call__(self, tick: int, run) -> np.ndarray:
        if tick:
            self.history = np.concatenate([self.history[:, 1:], run.pose[None, None, :3]], 1)
        step = tick % self.every
        if step == 0:
            noise = self.noise * self.rng.standard_normal((1, 5 + 2 * self.robot.n_joints))
            seen = (run.angles()[None], run.rates()[None])
            obs = task.observe(np, self.robot, self.history, self.camera, *seen, self.target, noise)
            self.chunk = np.asarray(self.brain(obs), float)[0]
        return self.chunk[step]
