"""Usual sizes of a robot's torques, rates, commands and forces, from its logs: the scales of its effects."""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.gap.models.robot_description import RobotDescription, thrust_of
from fishmj.gap.records.shooting import RobotRecord

USUAL = 90  # percentile over the starts of all segments


class RobotSizes(NamedTuple):
    """Usual size of a torque [N m] and a rate [rad/s] of each channel (J,), and of each actuator's command and force (A,)."""

    torque: np.ndarray
    rate: np.ndarray
    command: np.ndarray
    force: np.ndarray


def sizes_of(robot: RobotDescription, records: Sequence[RobotRecord]) -> RobotSizes:
    """Usual torques and rates at the starts of all segments.

    A torque is the larger of that from inverse dynamics and that of the actuators for the commands: a light leg with much
    friction needs little torque but gets much.
    """
    m, d = robot.model, mujoco.MjData(robot.model)
    dofs = robot.dofs
    needed, given, rate, force = [], [], [], []
    command = np.stack([np.percentile(np.abs(r.commands - r.commands.mean(0)), USUAL, axis=0) for r in records]).mean(0)
    for record in records:
        held = np.maximum(np.searchsorted(record.sent, record.starts, side="right") - 1, 0)
        states = robot.qpos(record.angles, record.start_turns)
        for q, v, a, u in zip(states, record.rates, record.accelerations, record.commands[held], strict=True):
            d.qpos[:], d.qvel[dofs], d.qacc[dofs], d.ctrl[:] = q, v, a, u
            mujoco.mj_inverse(m, d)
            needed.append(np.abs(d.qfrc_inverse[dofs]))
            mujoco.mj_fwdActuation(m, d)
            given.append(np.abs(d.qfrc_actuator[dofs]))
            rate.append(np.abs(v))
            force.append(np.abs(d.actuator_force))
    torque, driven, usual, thrust = (np.percentile(part, USUAL, axis=0) for part in (needed, given, rate, force))
    thrust *= [thrust_of(m, a) if a in robot.thrusters.values() else 1.0 for a in range(m.nu)]
    return RobotSizes(np.maximum(torque, driven), usual, command, thrust)
