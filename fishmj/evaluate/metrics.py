"""What a judgement yields: the time series of every trial, and of them one figure a trial for each key, NaN where it has none.

    arrival             1 if the fish enters 0.1 m within 30 s
    approach_time       s, of the first entry
    rmse_after_arrival  m, sqrt(mean d^2) from first entry to 30 s; without arrival 10 to 30 s
    rmse_last20, rmse_total     m, over 40 to 60 s and 0 to 30 s
    power               W, electrical, idle included
    energy_per_metre    J/m of way through the water;  cost_of_transport = that / (m g)
    rheotactic_index    mean of cos(psi - upstream) over 30 to 60 s; rheotactic_index_linear = 1 - mean |psi - upstream| / 90 deg

psi and the speed through the water are averaged over 1 s, so that the beat does not count as turning or as way. A trial
that leaves the domain keeps its distance from there on; power, way and heading count until it leaves.
"""

from typing import NamedTuple

import numpy as np

from fishmj.calib import constant
from fishmj.evaluate.protocol import Trials
from fishmj.mjcf.description import Robot
from fishmj.units import G, wrap

BEAT = 1.0  # s, averaging window
UNITS = {
    "arrival": "1",
    "approach_time": "s",
    "rmse_after_arrival": "m",
    "rmse_last20": "m",
    "rmse_total": "m",
    "power": "W",
    "energy_per_metre": "J/m",
    "cost_of_transport": "1",
    "rheotactic_index": "1",
    "rheotactic_index_linear": "1",
}


class Result(NamedTuple):
    """What n trials did; T bus ticks of 20 ms, row 0 is the start; K control steps."""

    controller: str
    policy_sha256: str  # of a policy's file, else ""
    robot: Robot
    trials: Trials
    engine: str
    t: np.ndarray  # (T + 1,) s
    target: np.ndarray  # (n, 2) m
    pose: np.ndarray  # (n, T + 1, 3) m, m, rad; tank frame, yaw not wrapped
    velocity: np.ndarray  # (n, T + 1, 3) true rates
    joint: np.ndarray  # (n, T + 1, J) rad
    rate: np.ndarray  # (n, T + 1, J) rad/s
    power: np.ndarray  # (n, T) W, servos and idle, mean over a tick
    command: np.ndarray  # (n, T, J) rad, on the bus
    obs: np.ndarray  # (n, K, 5 + 2 J)
    action: np.ndarray | None  # (n, K, J) of policies
    distance: np.ndarray  # (n, T + 1) m, frozen where a trial left the domain
    left: np.ndarray  # (n,) tick at which the trial left, T + 1 if it did not

    @property
    def water(self) -> str:
        """`lbm` for the flow solver, else the robot's model: `structured`, `surrogate` or the file of a fitted one."""
        return "lbm" if self.engine.startswith("tanks") else str(self.robot.water.get("model", "structured"))


def arrival_tick(result: Result) -> np.ndarray:
    """(n,) tick of the first entry into the arrival radius within the arrival time; -1 where there is none."""
    limit = round(constant("protocol", "arrival_time") / result.robot.timing.bus_dt)
    inside = (result.distance <= constant("protocol", "arrival_radius"))[:, : limit + 1]
    inside &= np.arange(inside.shape[1]) < result.left[:, None]
    return np.where(inside.any(1), inside.argmax(1), -1)


def figures(r: Result) -> dict[str, np.ndarray]:
    """Key -> (n,) one figure a trial."""
    window = lambda key: constant("protocol", key)
    end = window("arrival_time")
    first = arrival_tick(r)
    arrived = first >= 0
    since = np.where(arrived, r.t[first], window("missed_window")[0])
    way, energy = _way(r), _until_left(r, r.power).sum(1) * r.robot.timing.bus_dt
    per_metre = energy / np.maximum(way, 1e-6)
    cosine, linear = rheotaxis(r)
    return {
        "arrival": arrived.astype(float),
        "approach_time": np.where(arrived, r.t[first], np.nan),
        "rmse_after_arrival": rms(r, since, end),
        "rmse_last20": rms(r, *window("steady_window")),
        "rmse_total": rms(r, 0.0, end),
        "power": energy / (np.maximum(np.minimum(r.left, r.power.shape[1]), 1) * r.robot.timing.bus_dt),
        "energy_per_metre": per_metre,
        "cost_of_transport": per_metre / (r.robot.mass * G),
        "rheotactic_index": cosine,
        "rheotactic_index_linear": linear,
    }


def rms(r: Result, start, end: float) -> np.ndarray:
    """Root mean square distance from `start` ((n,) or one number) to `end` [s]; NaN where the run is shorter than that."""
    start = np.broadcast_to(start, (len(r.trials),))[:, None]
    inside = (r.t >= start - 1e-9) & (r.t <= end + 1e-9)
    mean = np.sum(r.distance**2 * inside, 1) / np.maximum(inside.sum(1), 1)
    return np.where((r.t[-1] >= end - 1e-9) & inside.any(1), np.sqrt(mean), np.nan)


def rheotaxis(r: Result) -> tuple[np.ndarray, np.ndarray]:
    """(RI_cos, RI_lin) over the hold phase, each (n,)."""
    start, end = constant("protocol", "rheotaxis_window")
    heading = beat_mean(r.pose[:, :, 2], r.robot.timing.bus_dt)
    off = wrap(np, heading - r.trials.upstream)
    inside = (r.t >= start) & (r.t <= end + 1e-9) & (np.arange(len(r.t)) < r.left[:, None])
    count = np.where((r.t[-1] >= end - 1e-9) & inside.any(1), inside.sum(1), np.nan)
    mean = lambda x: np.sum(x * inside, 1) / count
    return mean(np.cos(off)), 1 - mean(np.abs(off)) / (np.pi / 2)


def beat_mean(x, dt: float):
    """Centred moving average over one beat along axis 1 of (n, T); shorter at the ends."""
    half = round(BEAT / dt / 2)
    total = np.concatenate([np.zeros((len(x), 1)), np.cumsum(x, 1)], 1)
    i = np.arange(x.shape[1])
    low, high = np.maximum(i - half, 0), np.minimum(i + half + 1, x.shape[1])
    return (total[:, high] - total[:, low]) / (high - low)


def _way(r: Result) -> np.ndarray:
    """Way through the undisturbed stream until the trial ends or leaves, (n,) m."""
    mean = np.array([f.mean[:2] for f in r.trials.flows()])
    relative = r.velocity[:, 1:, :2] - mean[:, None]
    dt = r.robot.timing.bus_dt
    speed = np.hypot(beat_mean(relative[..., 0], dt), beat_mean(relative[..., 1], dt))
    return _until_left(r, speed).sum(1) * dt


def _until_left(r: Result, x) -> np.ndarray:
    """x (n, T) with zeros after the trial has left the domain."""
    return x * (np.arange(x.shape[1]) < r.left[:, None])
