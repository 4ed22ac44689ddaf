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


class BodyReadings(NamedTuple):
    """Present readings of the electronics inside the body."""

    joint: np.ndarray  # (J,) rad, servo readings before they are rounded to counts
    voltage: float  # V, battery lead
    current: float  # A, battery lead


class Body(Protocol):
    """Interface of a body: joints in water. Time begins at 0 and moves only with `advance`."""

    robot: Robot

    @property
    def time(self) -> float:
        """Time since the body began, s."""

    def send(self, command: Sequence[float] | np.ndarray) -> None:
        """Puts joint angles (J,) [rad] on the servo bus now, like the microcontroller."""

    def advance(self, seconds: float) -> None:
        """Advances by whole milliseconds; seconds: s."""

    def sensors(self) -> BodyReadings:
        """Present readings."""

    def truth(self) -> np.ndarray:
        """(3 + J,): x, y [m], yaw [rad] of the reference point, hinge angles [rad]."""

    def seen(self) -> tuple[float, np.ndarray]:
        """The body as a camera that exposes now records it, without noise.

        Returns:
            The stamp [s], and the pose as of `truth`, with the errors that are planted in the camera.
        """

    def torque(self, on: bool) -> None:
        """Switches the servos' torque."""

    def supply(self, volts: float | None) -> None:
        """Feeds the servos from this open-circuit voltage [V]; None: from the battery."""

    def jam(self, joint: int, stuck: bool) -> None:
        """Jams the gears of a joint (0 at the head) in place, or frees them."""


def bus_delay(robot: Robot, radio: float) -> float:
    """Delay from the microcontroller to the servo, s: the nominal command latency without the radio's part, at least 0."""
    return max(robot.timing.command_latency - radio, 0.0)


def whole_milliseconds(seconds: float) -> int:
    """Number of milliseconds in `seconds`. Raises ConfigError: less than one, or a fraction."""
    whole = round(seconds / MILLISECOND)
    if whole < 1 or abs(whole * MILLISECOND - seconds) > 1e-6:
        raise ConfigError(f"loopback: advance({seconds}); expected whole milliseconds, 0.001 s at least")
    return whole
