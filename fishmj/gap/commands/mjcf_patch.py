"""Writes effects that MuJoCo has attributes for into its model, for simulators without fishmj's hooks.

    difference(parent, robot)       a unified diff of the two models' MJCF
    hooked(robot)                   effects that need a hook (or belong to sensors), without an attribute in MJCF

fishmj's own models never get these attributes: their hooks act instead, and an effect must not act twice.
"""

import difflib
from dataclasses import replace

import mujoco
import numpy as np

from fishmj.mjcf import passive_slot
from fishmj.mjcf.description import Robot
from fishmj.mjcf.model import build_spec


def _friction(spec, robot, p) -> None:
    for joint in _hinges(spec, robot):
        joint.frictionloss += p["torque"]
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # MuJoCo's dry friction is a constraint


def _viscous(spec, robot, p) -> None:
    for joint in _hinges(spec, robot):
        joint.damping = np.asarray(joint.damping) + [p["damping"], 0, 0]


def _stiffness(spec, robot, p) -> None:
    for joint in _hinges(spec, robot):
        joint.stiffness = np.asarray(joint.stiffness) + [p["stiffness"], 0, 0]


def _saturation(spec, robot, p) -> None:
    for actuator in spec.actuators:
        actuator.forcerange = [-min(p["limit"], robot.servo.torque), min(p["limit"], robot.servo.torque)]


def _gain(spec, robot, p) -> None:
    for actuator in spec.actuators:
        gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
        gain[0], bias[:3] = (1 + p["gain"]) * gain[0], (1 + p["gain"]) * bias[:3]
        actuator.gainprm, actuator.biasprm = gain, bias


def _command_gain(spec, robot, p) -> None:
    for actuator in spec.actuators:
        gain = np.array(actuator.gainprm)
        gain[0] *= 1 + p["gain"]
        actuator.gainprm = gain


def _latency(spec, robot, p) -> None:
    """Sets the extra latency; fishmj keeps the model's own on the bus, outside MJCF."""
    late = robot.timing.command_latency + p["delay"]
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = late, int(np.ceil(late / robot.timing.physics_dt)) + 1


def _mass(spec, robot, p) -> None:
    """Adds mass as the effect `body_mass` does: a part over the links, the rest at the head's origin."""
    spread = p.get("spread", 1.0)
    share, load = 1 + spread * p["mass"] / robot.mass, (1 - spread) * p["mass"]
    for link in robot.links:
        body = spec.body(link.name)
        body.mass, body.inertia = share * body.mass, share * np.array(body.inertia)
    head = spec.body(robot.links[0].name)
    place, m = np.array(head.ipos), head.mass
    less = load / (m + load)
    head.mass, head.ipos = m + load, (1 - less) * place
    head.inertia = head.inertia + m * less * (place @ place - place**2)


NATIVE = {
    "coulomb_friction": _friction,
    "viscous_friction": _viscous,
    "skin_stiffness": _stiffness,
    "torque_saturation": _saturation,
    "servo_gain": _gain,
    "command_gain_error": _command_gain,
    "command_latency": _latency,
    "body_mass": _mass,
}


def mjcf(robot: Robot) -> str:
    """MJCF of the robot with every effect that has an attribute."""
    spec = build_spec(replace(robot, effects=()), bare=True)
    for fitted in robot.effects:
        if fitted.name in NATIVE:
            NATIVE[fitted.name](spec, robot, {name: interval.value for name, interval in fitted.parameters.items()})
    return passive_slot.xml_of(spec)


def difference(parent: Robot, robot: Robot) -> str:
    """Unified diff of MJCF; "" where no attribute differs."""
    before, after = (mjcf(one).splitlines(keepends=True) for one in (parent, robot))
    return "".join(difflib.unified_diff(before, after, "parent.xml", "patched.xml", n=1))


def hooked(robot: Robot) -> list[str]:
    """Effects of the robot that its MJCF cannot hold."""
    return [fitted.name for fitted in robot.effects if fitted.name not in NATIVE]


def _hinges(spec, robot):
    return [joint for joint in spec.joints if joint.name in {f"j{i + 1}" for i in range(robot.n_joints)}]
