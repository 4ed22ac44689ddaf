"""Controller made from a trained policy: 11 observations in, three joint angles out, on the robot's command path."""

import os
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.names import nearest
from fishmj.base.options import shown
from fishmj.control import CONTROLLERS
from fishmj.control.policy import FOLDER, Policy, file_of
from fishmj.control.policy_meta import PolicyBody, PolicyFit, fit, robot_option, structure_sha256
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import constants_of, constants_sha256, observation_of, structure_of
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold as task
from fishmj.water.water_identity import water_identity

SHIPPED_ROBOTS = ("fish", "tendon_fish")
TOLD = ("robot", "structure_sha256", "constants_sha256", "water", "command_path", "seed", "command")  # of a header
OTHERS = "train one for this robot, fishmj train --robot FILE; in simulations the controller dob steers any fish"


class LearnedController:
    """Wraps `fishmj.control.policy.Policy`. `action`: its last output; `sha256`: of its file; `notes`: remarks for the user.

    Args:
        source: path of a policy file or of a training's folder, or the name of a shipped one.
        anyway: allow another command path than that of training.

    Raises UnknownName, StoreError, ConfigError: no such policy, a damaged file, or one for another robot or command path.
    """

    def __init__(self, robot: Robot, source: str, anyway: bool = False):
        if source in CONTROLLERS:
            why = "needs the true flow, which no robot knows" if source == "privileged" else "is for simulations only"
            raise ConfigError(f"controller {source}: {why}; expected a policy: shipped, a file, or the folder of a training")
        self.robot, self.policy = robot, Policy.load(source)
        path, of_a_run = file_of(source), os.path.isdir(source)
        shipped = path.resolve().parent == FOLDER
        self.name = path.stem if shipped else nearest(path.parent.resolve().name if of_a_run else path.stem) or "policy"
        self.sha256 = sha256(path.read_bytes()).hexdigest()
        wanted = (5 + 2 * robot.n_joints, robot.n_joints)
        if (self.policy.n_obs, self.policy.n_act) != wanted:
            raise ConfigError(
                f"policy {source}: has {self.policy.n_obs} observations and {self.policy.n_act} actions; "
                f"robot {robot.name} needs {wanted[0]} and {wanted[1]}; {self._remedy(robot)}"
            )
        self.anyway = anyway
        found = self._fit(robot)
        if found.refused:
            raise ConfigError(
                f"policy {source} cannot steer robot {robot.name}: {'; '.join(found.refused)}; {self._remedy(robot)}"
            )
        taken = (f"taken from {path}",) if of_a_run and not shipped else ()
        self.notes = tuple(f"policy {self.name}: {note}" for note in (*taken, *found.notes))

    def _remedy(self, robot: Robot) -> str:
        """Advice for a policy that does not fit this robot."""
        own, option = str(self.policy.meta.get("robot", robot.name)), robot_option()
        file = next((name for name in SHIPPED_ROBOTS if load_robot(name).name == own), "FILE")
        named = f": name that robot, {option} {file}; or" if option else ";"
        return f"it was trained for {shown(own)}{named} {OTHERS}" if own != robot.name else OTHERS

    def trained(self, robot: Robot | None = None, *, in_tank: bool = False) -> dict:
        """Training of the policy and differences here, in plain types for results and logs.

        Args:
            robot: in its water; by default the robot for which the policy was made.
            in_tank: the water is that of a real tank, and is not compared.
        Returns:
            the header's values of TOLD; "differs": {what: [training, here]}; "said": the same as text; "lacks": missing keys
        """
        found = self._fit(robot or self.robot)
        told = {key: self.policy.meta[key] for key in TOLD if self.policy.meta.get(key) is not None}
        if in_tank:
            found = found._replace(differs={key: both for key, both in found.differs.items() if key != "water"})
        differs = {key: list(both) for key, both in found.differs.items()}
        return {**told, "differs": differs, "said": found.said, "lacks": list(found.lacks)}

    def _fit(self, robot: Robot) -> PolicyFit:
        meta = {**shipped_constants(self.policy.meta.get("constants_sha256")), **self.policy.meta}
        return fit(meta, body_of(robot), anyway=self.anyway, known=shipped_structures())

    def reset(self, n: int) -> None:
        """Starts n episodes: the policy's memory is empty, the last command zero."""
        self.policy.reset()
        self.command = np.zeros((n, self.robot.n_joints))

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad."""
        self.action = np.asarray(self.policy(obs), float)
        commands = task.chunk(np, self.robot, self.command, self.action)
        self.command = commands[:, -1]
        return commands


def body_of(robot: Robot) -> PolicyBody:
    """Properties of a robot with which the header of a policy is compared."""
    return PolicyBody(
        name=robot.name,
        structure=structure_of(robot),
        constants_sha256=constants_sha256(robot),
        constants=constants_of(robot),
        water=water_identity(robot),
        observation=observation_of(robot.n_joints),
        command_path=robot.timing.command_path,
        control_dt=robot.timing.control_dt,
    )


def robot_in(env: Any) -> Robot:
    """Robot of an environment, or `env` itself if it is a robot. Raises ConfigError for anything else."""
    for part in ("unwrapped", "task", "rules"):  # Gymnasium's wrappers, dm_control's task, the rules of both
        env = getattr(env, part, env)
    if not isinstance(robot := getattr(env, "robot", env), Robot):
        raise ConfigError(
            f"policy: trained in {type(env).__name__}; expected an environment of fishmj (JAX, Gymnasium, dm_control), or a Robot"
        )
    return robot


def header_of(robot: Robot) -> dict:
    """Header of a policy trained on this robot, without the keys of the network."""
    body = body_of(robot)
    return {
        "robot": body.name,
        "joints": robot.n_joints,
        "structure": body.structure,
        "structure_sha256": structure_sha256(body.structure),
        "constants_sha256": body.constants_sha256,
        "constants": body.constants,
        "water": body.water,
        "observation": body.observation,
        "action": f"joint angle over {robot.servo.range:.6f} rad",
        "control_dt": body.control_dt,
        "command_path": body.command_path,
        "command": None,  # called from Python
        "origin": "synthetic",  # trained in simulation only
    }


@cache
def shipped_constants(digest: str | None) -> dict[str, dict]:
    """Key `constants` of a header that has only their digest, where they are those of a shipped robot; else {}."""
    robots = (robot for robot in map(load_robot, SHIPPED_ROBOTS) if constants_sha256(robot) == digest)
    return next(({"constants": constants_of(robot)} for robot in robots), {})


@cache
def shipped_structures() -> dict[str, dict]:
    """Structures of the shipped robots by name, for older policies whose header has only the name."""
    return {robot.name: structure_of(robot) for robot in map(load_robot, SHIPPED_ROBOTS)}
