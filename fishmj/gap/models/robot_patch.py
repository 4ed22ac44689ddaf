"""The difference between two MjModels of one robot, written into its MJCF.

    patched(robot, model) -> str        MJCF text of the description with the fields of `model`

An effect changes an MjModel only (fishmj/effects); this table says which attribute of MJCF holds which field.
"""

import difflib
from typing import Any

import mujoco
import numpy as np

from fishmj.gap.models import joint_laws
from fishmj.gap.models.robot_description import RobotDescription

JOINT = ("stiffness", "jnt_stiffness", "jnt_stiffnesspoly"), ("damping", "dof_damping", "dof_dampingpoly")
BODY = ("mass", "inertia", "ipos", "iquat")


def patched(robot: RobotDescription, model: Any, delay: float = 0.0) -> str:
    """MJCF of the description with the fields of a changed model. delay: s that all commands come later."""
    spec, before = robot.spec.copy(), robot.model
    moving = [joint for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    for joint, known in zip(moving, robot.joints, strict=True):
        for name, first, more in JOINT:
            place = known.joint if first.startswith("jnt") else known.dof
            now, then = ([float(getattr(x, first)[place]), *getattr(x, more)[place].tolist()] for x in (model, before))
            if now != then:
                setattr(joint, name, now)
        for name in ("frictionloss", "armature"):
            field = f"dof_{name}"
            if getattr(model, field)[known.dof] != getattr(before, field)[known.dof]:
                setattr(joint, name, float(getattr(model, field)[known.dof]))
    if model.jnt_user.any():  # laws of joint_laws.py
        spec.nuserdata = max(spec.nuserdata, joint_laws.remembered(robot.model.njnt))
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    if any(model.dof_frictionloss > before.dof_frictionloss):
        off = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
        spec.option.disableflags &= ~int(off)  # MuJoCo's dry friction is a constraint
    for a, actuator in enumerate(spec.actuators):
        for name in ("gainprm", "biasprm", "gear", "forcerange", "ctrlrange"):
            values = getattr(model, f"actuator_{name}")[a]
            if not np.array_equal(values, getattr(before, f"actuator_{name}")[a]):
                setattr(actuator, name, values)
        if model.actuator_biastype[a] != before.actuator_biastype[a]:
            actuator.biastype = mujoco.mjtBias(int(model.actuator_biastype[a]))
        if model.actuator_forcelimited[a] != before.actuator_forcelimited[a]:
            actuator.forcelimited = int(model.actuator_forcelimited[a])
        if delay:
            actuator.delay = float(robot.delays[a] + delay)
            actuator.nsample = int(np.ceil(actuator.delay / model.opt.timestep)) + 1
    for name, b in robot.bodies.items():
        if any(not np.array_equal(getattr(model, f"body_{f}")[b], getattr(before, f"body_{f}")[b]) for f in BODY):
            body = spec.body(name) or spec.bodies[b]
            body.explicitinertial, body.fullinertia = True, [np.nan] * 6
            body.mass = float(model.body_mass[b])
            body.inertia, body.ipos, body.iquat = (getattr(model, f"body_{f}")[b] for f in BODY[1:])
    for name in ("gravity", "wind", "density"):
        if not np.array_equal(getattr(model.opt, name), getattr(before.opt, name)):
            setattr(spec.option, name, getattr(model.opt, name))
    spec.compile()
    return spec.to_xml()


def difference(robot: RobotDescription, text: str) -> str:
    """Unified diff from the MJCF of the description to `text`."""
    spec = robot.spec.copy()
    spec.compile()
    before, after = (part.splitlines(keepends=True) for part in (spec.to_xml(), text))
    return "".join(difflib.unified_diff(before, after, robot.path.name, "patched.xml", n=1))
