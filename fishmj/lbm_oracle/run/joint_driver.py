"""Who moves the joints of a fish through one tick of the solver: the robot's own servos, or whoever has these four."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.mjcf.description import Robot


class JointDriver(Protocol):
    """Made anew for every tick, and for every time that it is done again with finer steps."""

    @property
    def power(self) -> float:
        """Mean W that the servos drew."""

    def actuate(self, step: int) -> tuple:
        """Set the joints' torque in this step of the tick; returns `fixed` and `value` of `FluidStructure.solve`."""

    def record(self) -> None:
        """The step's equation stands and its launches are under way."""

    def follow(self) -> None:
        """MuJoCo has taken the step."""


class CommandPath(Protocol):
    """What the servos know of a run."""

    robot: Robot
    prescribed: Callable[[float], np.ndarray] | None
    ticks: int
    steps: int

    def servo_target(self, step: int) -> np.ndarray: ...

    def prescribed_velocity(self, dt: float) -> tuple: ...

    def rates(self) -> np.ndarray: ...


class Servos:
    """The servos of the model, or joints that follow a function of time to the letter."""

    def __init__(self, path: CommandPath, coupled: FluidStructure, factor: int):
        self.path, self.body, self.factor = path, coupled.body, factor
        self.torques: list[np.ndarray] = []
        self.rates: list[np.ndarray] = []

    def actuate(self, step: int) -> tuple:
        path = self.path
        if path.prescribed is None:
            self.body.data.ctrl[:] = path.servo_target(path.ticks * path.steps + step // self.factor)
        return path.prescribed_velocity(self.body.dt)

    def record(self) -> None:
        self.rates.append(self.path.rates())  # and torques, of the step's begin
        self.torques.append(self.body.data.actuator_force.copy())

    def follow(self) -> None:
        """Nothing to follow."""

    @property
    def power(self) -> float:
        """P = sum max(tau (tau - k_b w) / k_b, 0), mean over the steps."""
        torque, rate, kb = np.array(self.torques), np.array(self.rates), self.path.robot.servo.kb
        return float(np.maximum(torque * (torque - kb * rate) / kb, 0.0).sum()) / len(torque)
