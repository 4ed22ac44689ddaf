"""Passive drift: joints at zero. The null model of every comparison."""

import numpy as np

from fishmj.engines import ticks_per
from fishmj.mjcf.description import Robot


class Passive:
    """Controller with all joints at zero, for any robot."""

    name = "drift"

    def __init__(self, robot: Robot):
        self.shape = (ticks_per(robot)[1], robot.n_joints)

    def reset(self, n: int) -> None:
        """Does nothing: there is no memory."""

    def __call__(self, obs) -> np.ndarray:
        """Zeros, (B, T, J)."""
        return np.zeros((len(obs), *self.shape))


def build(robot: Robot, name: str, gains: dict) -> Passive:
    """Makes the controller for a robot; it has no gains."""
    return Passive(robot)
