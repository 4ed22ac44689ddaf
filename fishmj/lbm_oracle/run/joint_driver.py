"""Who moves the joints of a fish through one tick of the solver: the robot's own servos, or whoever has these four."""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from fishmj.lbm_oracle.immersed.coupling import FluidStructure

if TYPE_CHECKING:
    from fishmj.lbm_oracle.run.run import Run


class JointDriver(Protocol):
    """Made anew for every tick, and for every time that it is done again with finer steps."""

    @property
    def power(self) -> float:
        """Mean W that the servos drew."""

    def drive(self, step: int) -> tuple:
        """Push the joints in this step of the tick; returns what `FluidStructure.tell` is given."""

    def begun(self) -> None:
        """The step's equation stands and its launches are under way."""

    def finished(self) -> None:
        """MuJoCo has taken the step."""


class Servos:
    """The servos of the model, or joints that follow a function of time to the letter."""

    def __init__(self, run: "Run", coupled: FluidStructure, factor: int):
        self.run, self.body, self.factor = run, coupled.body, factor
        self.torques: list[np.ndarray] = []
        self.rates: list[np.ndarray] = []

    def drive(self, step: int) -> tuple:
        run = self.run
        if run.prescribed is None:
            self.body.data.ctrl[:] = run.arrived(run.ticks * run.steps + step // self.factor)
        return run.held(self.body.dt)

    def begun(self) -> None:
        self.rates.append(self.run.rates())  # and torques, of the step's begin
        self.torques.append(self.body.data.actuator_force.copy())

    def finished(self) -> None:
        """Nothing to follow."""

    @property
    def power(self) -> float:
        """P = sum max(tau (tau - k_b w) / k_b, 0), mean over the steps."""
        torque, rate, kb = np.array(self.torques), np.array(self.rates), self.run.robot.servo.kb
        return float(np.maximum(torque * (torque - kb * rate) / kb, 0.0).sum()) / len(torque)
