"""A controller that steers a segment: it sees the numbers that it would see anywhere, noisy and late, every control step."""

from dataclasses import replace
from math import ceil

import numpy as np

from fishmj import controllers
from fishmj.campaign.data.segment import Segment
from fishmj.engines import nominal_params, ticks_per
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import SensorWindow
from fishmj.tasks.sensing import Sensors


class ClosedLoop:
    """Called as (tick, run) once every bus tick, in order; returns the command (J,) rad.

    Raises:
        UnknownName, ConfigError: no such controller, or none for this robot.
    """

    def __init__(self, segment: Segment, robot: Robot, controller: str, target, seed: int, noise: float):
        # A segment is the swim of the nominal body: the flow solver and the surrogate have no place for effects, and a segment's
        # identity (run_segments.fingerprint) leaves them out. Sensors with effects would make one segment two swims.
        self.robot = replace(robot, effects=())
        self.target = np.asarray(target, float)[None]
        self.controller = controllers.make(controller, robot)
        self.controller.reset(1)
        self.ticks = ticks_per(robot)[1]
        self.sensors, self.params = Sensors(self.robot), nominal_params(self.robot, 1)
        self.camera = np.array([ceil(robot.timing.camera_latency / robot.timing.bus_dt - 1e-6)])
        self.rng, self.noise = np.random.default_rng([11, seed]), noise
        self.window = SensorWindow.at_rest(self.robot, self.sensors, np.asarray(segment.pose, float)[None])

    def __call__(self, tick: int, run) -> np.ndarray:
        pose = run.pose[None, None, :3] if tick else self.window.pose[:, -1:]  # the camera has not seen how the fish was nudged
        self.window = self.window.after(pose, run.angles()[None, None], run.rates()[None, None])
        step = tick % self.ticks
        if step == 0:
            noise = self.noise * self.rng.standard_normal((1, 5 + 2 * self.robot.n_joints))
            senses = (self.window.pose, self.camera, self.window.joint)
            obs = task.observe_with_sensors(np, self.robot, self.sensors, self.params, *senses, self.target, noise)
            self.commands = np.asarray(self.controller(obs), float)[0]
        return self.commands[step]
