"""A trained policy as a controller: 11 numbers in, three joint angles out, on the robot's command path."""

import os
from hashlib import sha256

import numpy as np

from fishmj.errors import ConfigError
from fishmj.mjcf.description import Robot, load_robot
from fishmj.mjcf.identity import observation_of, structure_of
from fishmj.names import nearest
from fishmj.policy import FOLDER, Policy, PolicyBody, file_of, fit
from fishmj.tasks import station_hold as task

SHIPPED_ROBOTS = ("fish", "tendon_fish")
OTHERS = "the controller drift serves any robot, and fishmj train --robot FILE makes a policy for this one"


class LearnedController:
    """Wraps `fishmj.policy.Policy`; `action` is its last answer, `sha256` the file's, `notes` what is worth a line.

    Args:
        source: path of a policy file or of a training's folder, or the name of a shipped one.
        any_command_path: the robot's command path was asked for, also where the policy was trained on another.

    Raises:
        UnknownName, StoreError, ConfigError: no such policy, a damaged file, or one for another robot or command path.
    """

    def __init__(self, robot: Robot, source: str, any_command_path: bool = False):
        self.robot, self.policy = robot, Policy.load(source)
        path, of_a_run = file_of(source), os.path.isdir(source)
        self.name = (
            source if path.parent == FOLDER else nearest(path.parent.resolve().name if of_a_run else path.stem) or "policy"
        )
        self.sha256 = sha256(path.read_bytes()).hexdigest()
        wanted = (5 + 2 * robot.n_joints, robot.n_joints)
        if (self.policy.n_obs, self.policy.n_act) != wanted:
            raise ConfigError(
                f"policy {source}: takes {self.policy.n_obs} observations and gives {self.policy.n_act} actions; "
                f"robot {robot.name} has {wanted[0]} and {wanted[1]}; {OTHERS}"
            )
        found = fit(self.policy.meta, body_of(robot), any_path=any_command_path, known=shipped_structures())
        if found.refused:
            raise ConfigError(f"policy {source} cannot steer robot {robot.name}: {'; '.join(found.refused)}; {OTHERS}")
        taken = (f"taken from {path}",) if of_a_run and path.parent != FOLDER else ()
        self.notes = tuple(f"policy {self.name}: {note}" for note in (*taken, *found.notes))

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


def body_of(robot: Robot) -> PolicyBody:
    """What the header of a policy is compared with."""
    timing = robot.timing
    return PolicyBody(robot.name, structure_of(robot), observation_of(robot.n_joints), timing.command_path, timing.control_dt)


def shipped_structures() -> dict[str, dict]:
    """Structures of the robots that come with fishmj, by name: for policies whose header only names one of them."""
    return {robot.name: structure_of(robot) for robot in map(load_robot, SHIPPED_ROBOTS)}
