"""A trained policy as a controller: 11 numbers in, three joint angles out, on the robot's command path."""

from hashlib import sha256
from pathlib import Path

import numpy as np

from fishmj.errors import ConfigError
from fishmj.mjcf.description import Robot
from fishmj.policy import FOLDER, Policy
from fishmj.tasks import station_hold as task


class Learned:
    """Wraps `fishmj.policy.Policy`; `action` is its last answer, `sha256` the file's.

    Args:
        source: path of a policy file, or the name of a shipped one.

    Raises:
        UnknownName, StoreError, ConfigError: no such policy, a damaged file, or one for another robot.
    """

    def __init__(self, robot: Robot, source: str):
        self.robot, self.policy = robot, Policy.load(source)
        path = Path(source)
        self.name = path.stem if path.is_file() else source
        self.sha256 = sha256((path if path.is_file() else FOLDER / f"{source}.safetensors").read_bytes()).hexdigest()
        wanted = (5 + 2 * robot.n_joints, robot.n_joints)
        if (self.policy.n_obs, self.policy.n_act) != wanted:
            raise ConfigError(
                f"policy {source}: takes {self.policy.n_obs} observations and gives {self.policy.n_act} actions; "
                f"robot {robot.name} has {wanted[0]} and {wanted[1]}"
            )

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
