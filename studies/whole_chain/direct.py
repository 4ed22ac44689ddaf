"""The direct simulation of a trial, with the measured noise of a camera tracker instead of the task's noise.

A line fit over W poses, dt apart, with errors of autocovariance c_m, one frame apart from the next, gives

    position   var = c_0
    velocity   var = sum_ij a_i a_j c_|i-j|,      a: weights of the fit (tasks.sensing.slope_weights)

The readings of a joint are whole counts of the servo: var = count^2 / 12, white, with a fit over the host's window.
"""

from collections import deque
from dataclasses import dataclass, fields
from math import sqrt

import numpy as np

from fishmj.control.learned import LearnedController
from fishmj.deploy.loop.observation import RATE_WINDOW
from fishmj.deploy.loopback import bodies
from fishmj.deploy.loopback.loopback_body import MILLISECOND
from fishmj.deploy.loopback.virtual_body import VirtualBody
from fishmj.deploy.protocols import servo_counts
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.sensing import slope_weights
from studies.whole_chain.chain import SECONDS, figures


@dataclass(frozen=True, kw_only=True)
class AsSensed(Trials):
    """Trials whose observations have a measured noise. sigma: (5 + 2 J,) standard deviations of the observation, SI."""

    sigma: tuple[float, ...]

    @classmethod
    def of(cls, trials: Trials, sigma: np.ndarray) -> "AsSensed":
        """Trials with this noise."""
        return cls(sigma=tuple(sigma.tolist()), **{field.name: getattr(trials, field.name) for field in fields(Trials)})

    def sensor_noise(self, robot: Robot, steps: int) -> np.ndarray:
        """Standard normal draws in units of the task's own noise, (n, steps, 5 + 2 J)."""
        return super().sensor_noise(robot, steps) * (np.array(self.sigma) / task.noise_scale(robot))


def observation_noise(covariance: np.ndarray, robot: Robot) -> np.ndarray:
    """Standard deviations (5 + 2 J,) of the observation behind a tracker.

    Args:
        covariance: (3, M), M at least the velocity window: autocovariances of its errors in x, y [m^2] and yaw [rad^2].
    """
    timing = robot.timing
    weights = slope_weights(timing.velocity_window, timing.bus_dt)
    apart = np.abs(np.subtract.outer(np.arange(len(weights)), np.arange(len(weights))))
    fitted = lambda lags: sqrt(max(float(weights @ lags[apart] @ weights), 0.0))
    place, yaw = covariance[:2].mean(0), covariance[2]
    reading = servo_counts.RAD_PER_COUNT / sqrt(12)
    rate = reading * float(np.linalg.norm(slope_weights(RATE_WINDOW, timing.bus_dt)))
    each = [sqrt(place[0]), fitted(place), fitted(yaw), reading, rate]
    return np.repeat(each, [*task.spans(robot.n_joints).values()])


def in_second_robot(item: int, trials: Trials, policy: str) -> dict:
    """Result of one trial of the second robot without its chain: {"rmse" m, "arrival" s or None}.

    The observations are exact poses with the camera's latency and exact joints, plus the trials' noise; commands have the nominal
    latency.
    """
    robot = load_robot("fish")
    (starts, targets), flow = trials.ends(), trials.flows()[item]
    body = bodies.make(bodies.VIRTUAL, robot=robot, seed=item, start=tuple(starts[item].tolist()), flow=flow)
    zero = body.plant.zero if isinstance(body, VirtualBody) else np.zeros(robot.n_joints)
    controller = LearnedController(robot, policy)
    controller.reset(1)
    noise = trials.sensor_noise(robot, task.control_steps(SECONDS, robot))[item]
    _, camera = trials.fish(robot)
    tick, late = robot.timing.bus_dt, camera[item : item + 1]
    poses = deque([starts[item]] * task.history_length(robot), maxlen=task.history_length(robot))
    joint, rate = np.zeros((2, robot.n_joints))
    path: list[tuple[float, float, float]] = []
    for draw in noise:
        seen = task.observe(np, robot, np.array(poses)[None], late, joint[None], rate[None], targets[item : item + 1], draw[None])
        for command in controller(seen)[0]:
            body.send(command)
            body.advance(tick - MILLISECOND)
            before = body.truth()[3:]
            body.advance(MILLISECOND)
            now = body.truth()
            joint, rate = now[3:] - zero, (now[3:] - before) / MILLISECOND
            poses.append(now[:3])
            path.append((body.time, float(now[0]), float(now[1])))
    return figures(np.array(path), 0.0, targets[item])
