"""Radio and bus: a queue of command packets, each with its own delay; telemetry of the joints.

A packet sent at t_k reaches the servos at t_k + latency + jitter, unless it is lost. Packets may overtake each other: an older
command that arrives last holds until the next one. Normal jitter has zero mean, since the nominal latency includes it; the hidden
effect only delays. Stamps are the sender's.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.instruments import order_of_arrival, read_encoders
from fishmj.gap.laboratory.virtual_robot.constant_groups import NetworkConstants, UncataloguedEffects
from fishmj.gap.laboratory.virtual_robot.simulate import StateRecording


class Delivery(NamedTuple):
    """Commands at the servos. times (K,) s rising, commands (K, J) rad."""

    times: np.ndarray
    commands: np.ndarray


class CommandRadio:
    """Draws the arrival time of each command packet at the servos."""

    def __init__(self, network: NetworkConstants, odd: UncataloguedEffects, seed: int, trial: int, noise: float):
        self.network, self.odd, self.noise = network, odd, noise
        self._streams = [random_streams.stream(seed, purpose, trial) for purpose in ("radio", "radio tail", "loss")]
        self._last: np.ndarray | None = None

    def arrival(self, sent: float, command: np.ndarray) -> float | None:
        """Time of arrival [s] of a command (J,) sent at `sent`; None when it is lost."""
        n, (base, tail, loss) = self.network, self._streams
        delay = (
            n.latency + n.delay + self.noise * n.jitter * random_streams.jitter(base) + n.sigma * random_streams.lateness(tail)
        )
        if self.odd.busy > 0.0:  # fast changes of the command slow the bus
            last = command if self._last is None else self._last
            delay += self.odd.busy * float(np.max(np.abs(command - last))) / n.period
        self._last = np.array(command)
        return None if loss.random() < n.loss else sent + max(delay, 0.001)


def deliver(
    network: NetworkConstants,
    odd: UncataloguedEffects,
    sent: np.ndarray,
    commands: np.ndarray,
    seed: int,
    trial: int,
    noise: float,
) -> Delivery:
    """Sends commands (K, J) at times `sent` (K,) s; returns the received ones in order of arrival."""
    radio = CommandRadio(network, odd, seed, trial, noise)
    times = np.array([radio.arrival(float(t), command) for t, command in zip(sent, commands, strict=True)], float)
    order = order_of_arrival(times)
    return Delivery(times[order], commands[order])


def telemetry(
    net: NetworkConstants, zero: np.ndarray, record: StateRecording, t: np.ndarray, rng: np.random.Generator, noise: float
) -> dict:
    """Table `joint`: joint sensors read at t (K,) s; each value is `joint_delay` s older than its stamp."""
    stamps = t + noise * net.stamp_jitter * rng.uniform(0.0, 1.0, len(t))
    names = [f"j{k + 1}" for k in range(len(zero))]
    angle = record.at(stamps - net.joint_delay, *names) - zero
    return {"t": stamps, **read_encoders(net, angle, rng, noise)}
