"""Passive drift: joints at zero. The null model of every comparison."""

import numpy as np

from fishmj.engines import ticks_per
from fishmj.mjcf.description import Robot


class Passive:
    """Does nothing, for any robot."""

    name = "drift"

    def __init__(self, robot: Robot):
        self.shape = (ticks_per(robot)[1], robot.n_joints)

    def reset(self, n: int) -> None:
        """Nothing to forget."""

    def __call__(self, obs) -> np.ndarray:
        """Zeros, (B, T, J)."""
        return np.zeros((len(obs), *self.shape))


def build(robot: Robot, name: str, gains: dict) -> Passive:
    return Passive(robot)
