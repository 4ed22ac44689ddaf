"""Radio and bus: a queue of command packets, each with its own delay; telemetry of the joints.

A packet that is sent at t_k reaches the servos at t_k + latency + jitter, unless it is lost; a late packet may be overtaken, and
then the older command comes last and stays until the next one. Stamps are the sender's.
"""

import heapq
from typing import NamedTuple

import numpy as np

from fishmj.virtual_robot import draws
from fishmj.virtual_robot.constants import Network, Odd
from fishmj.virtual_robot.motion import Recording


class Delivery(NamedTuple):
    """What reaches the servos. times (K,) s rising, commands (K, 3) rad."""

    times: np.ndarray
    commands: np.ndarray


def deliver(network: Network, odd: Odd, sent: np.ndarray, commands: np.ndarray, seed: int, trial: int, noise: float) -> Delivery:
    """Send commands (K, 3) at `sent` (K,) and take them out of the queue in order of arrival."""
    n = len(sent)
    base = draws.gamma_jitter(draws.stream(seed, "radio", trial), n)
    tail = draws.gamma_jitter(draws.stream(seed, "radio tail", trial), n)
    lost = draws.stream(seed, "loss", trial).random(n) < network.loss
    delay = network.latency + network.delay + noise * network.jitter * base + network.sigma * tail
    if odd.busy > 0.0:  # the bus is slower while the joints are asked to be fast
        speed = np.abs(np.gradient(commands, network.period, axis=0)).max(1)
        delay = delay + odd.busy * speed
    queue = [(float(t), k) for k, t in enumerate(sent + np.maximum(delay, 0.001)) if not lost[k]]
    heapq.heapify(queue)
    arrived = [heapq.heappop(queue) for _ in range(len(queue))]
    order = [k for _, k in arrived]
    return Delivery(np.array([t for t, _ in arrived]), commands[order].reshape(-1, 3))


def telemetry(network: Network, zero: np.ndarray, record: Recording, seed: int, trial: int, noise: float) -> dict:
    """Table `joint`: the hinges' own sensors, read every period, reported for the stamped time but `joint_delay` old."""
    rng = draws.stream(seed, "joint", trial)
    t = np.arange(0.0, record.t[-1], network.period)
    stamps = t + noise * network.stamp_jitter * rng.uniform(0.0, 1.0, len(t))
    angle = record.at(stamps - network.joint_delay, "j1", "j2", "j3") - zero
    angle = angle + noise * network.angle_noise * rng.standard_normal(angle.shape)
    angle = np.round(angle / network.angle_step) * network.angle_step
    return {"t": stamps, **{f"j{k + 1}": angle[:, k] for k in range(3)}}
