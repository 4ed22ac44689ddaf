"""Bodies of the loopback robot: one small interface for the second robot, MuJoCo and the flow solver.

A body is everything on the servo bus: joints, hull, water, battery. It knows nothing of datagrams, cameras or watchdogs.

    body = make("virtual", effects={"command_latency": {"delay": 0.02}}, seed=3)
    body.send((0.3, 0.2, 0.1))          # leaves the microcontroller now; the servos have it after the bus's delay
    body.advance(0.02)
    body.sensors().joint                # the servos' readings
    body.truth()                        # x, y, yaw, j1 ..: for the camera's picture and for scoring

The nominal command latency of a description runs from the host to the servo. The loopback's radio causes a part of it, so every
body gets the rest (`bus_delay`): no delay is applied twice.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.mjcf.description import Robot, load_robot
from fishmj.water.flow import Flow

VIRTUAL, FITTED, STRUCTURED, SOLVER = "virtual", "fitted", "structured", "lbm"
NAMES: Mapping[str, str] = {
    VIRTUAL: "the second, independently written robot, in which effects may be hidden (default)",
    FITTED: "one fish in the water that was fitted to the flow solver",
    STRUCTURED: "one fish in the strip water of the description",
    SOLVER: "the flow solver itself; in lockstep only, it is slower than real time on a CPU",
}
MUJOCO, COMPILED = ENGINES = ("mujoco", "compiled")
MILLISECOND = 0.001  # s, the loopback's finest step
Effects = Mapping[str, Mapping[str, float]]


class Sensors(NamedTuple):
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

    def sensors(self) -> Sensors:
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
    """Number of milliseconds in `seconds`.

    Raises:
        ConfigError: less than one, or a fraction.
    """
    whole = round(seconds / MILLISECOND)
    if whole < 1 or abs(whole * MILLISECOND - seconds) > 1e-6:
        raise ConfigError(f"loopback: advance({seconds}); expected whole milliseconds, 0.001 s at least")
    return whole


def make(
    name: str = VIRTUAL, *, robot: "str | Robot" = "fish", effects: Effects | None = None, seed: int = 0, noise: float = 1.0,
    nuisance: float = 0.1, start: tuple[float, float, float] = (0.0, 0.0, 0.0), flow: Flow | None = None, radio: float = 0.0,
    engine: str = MUJOCO, domain: str = "paper",
) -> Body:  # fmt: skip
    """Makes the body of this name.

    Args:
        robot: description, TOML path or shipped name.
        effects: {name: {parameter: value}} hidden in the second robot, SI.
        seed, noise, nuisance: as `virtual_robot.trials.generate`; for the second robot only.
        start: x, y [m], yaw [rad], at rest over ground, straight. flow: background flow, still by default.
        radio: part of the nominal command latency that the caller applies itself, s.
        engine: of the waters fitted and structured, "mujoco" or, for hours in lockstep, "compiled", which is equal to it.
        domain: of the flow solver, `lbm_oracle.run.domain.preset`.

    Raises:
        UnknownName: no such body or effect. ConfigError: effects or turbulence that this body does not support.
    """
    if name not in NAMES:
        raise UnknownName("body", name, NAMES)
    if engine not in ENGINES:
        raise UnknownName("engine of a loopback body", engine, ENGINES)
    described, stream = load_robot(robot), flow or Flow()
    if name == VIRTUAL:
        from fishmj.deploy.loopback.virtual_body import VirtualBody

        return VirtualBody(described, dict(effects or {}), seed, noise, nuisance, start, stream, radio)
    if effects:
        hidden = ", ".join(effects)
        raise ConfigError(
            f"loopback body {name!r}: --effect {hidden} hides in the second robot alone (body virtual); for MuJoCo write"
            " [[effect]] blocks in the description and pass that as the robot"
        )
    from fishmj.deploy.loopback.engine_bodies import CompiledBody, MujocoBody, SolverBody

    if name == SOLVER:
        return SolverBody(described, start, stream, radio, domain)
    return (CompiledBody if engine == COMPILED else MujocoBody)(described, name, start, stream, radio)
