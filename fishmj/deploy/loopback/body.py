"""Interface of a body that the loopback robot moves: joints, hull, water and battery behind the servo bus.

A body knows nothing of datagrams, cameras or watchdogs. `bodies.make` builds one by name.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.mjcf.description import Robot

MILLISECOND = 0.001  # s, the loopback's finest step
Effects = Mapping[str, Mapping[str, float]]


class Sensors(NamedTuple):
    """What the electronics inside the body read now."""

    joint: np.ndarray  # (J,) rad, servo readings before they are rounded to counts
    voltage: float  # V, battery lead
    current: float  # A, battery lead


class Body(Protocol):
    """Joints in water. Time begins at 0 and moves with `advance` alone."""

    robot: Robot

    @property
    def time(self) -> float:
        """s since the body began."""

    def send(self, command: Sequence[float] | np.ndarray) -> None:
        """The microcontroller puts joint angles (J,) [rad] on the servo bus now."""

    def advance(self, seconds: float) -> None:
        """Move on by whole milliseconds."""

    def sensors(self) -> Sensors:
        """Readings of now."""

    def truth(self) -> np.ndarray:
        """(3 + J,): x, y [m], yaw [rad] of the reference point, hinge angles [rad]."""

    def seen(self) -> tuple[float, np.ndarray]:
        """What a camera that exposes now makes of the body, without noise: its stamp [s], and as `truth` with what is planted in
        the camera."""

    def torque(self, on: bool) -> None:
        """Switch the servos' torque."""

    def supply(self, volts: float | None) -> None:
        """Feed the servos from this open-circuit voltage [V]; None: from the battery as it is."""

    def jam(self, joint: int, stuck: bool) -> None:
        """Make the gears of a joint (0 at the head) bind where they are, or let them go."""


def bus_delay(robot: Robot, radio: float) -> float:
    """s from the microcontroller to the servo: what the radio leaves of the nominal command latency, 0 at least."""
    return max(robot.timing.command_latency - radio, 0.0)


def whole_milliseconds(seconds: float) -> int:
    """How many.

    Raises:
        ConfigError: none, or a part of one.
    """
    whole = round(seconds / MILLISECOND)
    if whole < 1 or abs(whole * MILLISECOND - seconds) > 1e-6:
        raise ConfigError(f"loopback: advance({seconds}); expected whole milliseconds, 0.001 s at least")
    return whole
