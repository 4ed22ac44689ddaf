"""A trained policy as a controller: 11 numbers in, three joint angles out, on the robot's command path."""

import numpy as np

from fishmj.mjcf.description import Robot
from fishmj.policy import Policy
from fishmj.tasks import station_hold as task


class Learned:
    """Wraps `fishmj.policy.Policy`."""

    def __init__(self, robot: Robot, policy: Policy, name: str):
        self.robot, self.policy, self.name = robot, policy, name

    def reset(self, n: int) -> None:
        """n episodes: the policy's memory is empty, the last command zero."""
        self.policy.reset(n)
        self.command = np.zeros((n, self.robot.n_joints))

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        self.action = np.asarray(self.policy(obs), float)
        commands = task.chunk(np, self.robot, self.command, self.action)
        self.command = commands[:, -1]
        return commands
