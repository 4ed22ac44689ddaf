"""Faults outside the catalogue, in any family: a search should leave them unexplained.

Each changes the robot's constants, or MuJoCo's model during the swim. None occurs in the second robot.
"""

from collections.abc import Callable
from functools import wraps

import mujoco
import numpy as np

from fishmj.effects import Parameter
from fishmj.gap.laboratory.generators.mujoco_robot import LOOSE, SLOSH
from fishmj.gap.laboratory.generators.robot_parameters import HiddenEntry, RobotParameters


def at(hook: str) -> Callable:
    """Decorator: turns a change of the swim into a fault, which appends it, with the fault's values, to a list of the robot.

    hook: the list, `each_step`, `seen` or `read`; its arguments come between the robot and the fault's values.
    """

    def fault(change: Callable) -> Callable:
        @wraps(change)
        def act(fish: RobotParameters, **values) -> None:
            getattr(fish, hook).append(lambda *given: change(fish, *given, **values))

        return act

    return fault


def loose_tail(fish: RobotParameters, compliance):
    """A second hinge at the tail, a soft spring that no encoder sees."""
    if compliance <= 0.0:
        return

    def hinge(spec):
        body = spec.body(fish.robot.links[-1].name)
        joint = body.add_joint(name=LOOSE, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        joint.stiffness, joint.damping, joint.armature = [1.0 / compliance, 0, 0], [0.02, 0, 0], 2e-4

    fish.specs.append(hinge)


@at("each_step")
def one_sided_sticking(fish: RobotParameters, run, t, torque):
    """Dry friction on the left half of every joint's range only."""
    left = run.data.qpos[run.hinges] > 0.0
    run.model.dof_frictionloss[run.hinges] = fish.friction + torque * left


@at("each_step")
def leaking_hull(fish: RobotParameters, run, t, rate):
    """The head takes on water: mass and inertia grow from the start of each trial."""
    head = run.model.body(fish.robot.links[0].name).id
    mass, inertia = run.own.setdefault("head", (float(run.model.body_mass[head]), run.model.body_inertia[head].copy()))
    grown = 1.0 + rate * t / mass
    run.model.body_mass[head], run.model.body_inertia[head] = mass * grown, inertia * grown


@at("each_step")
def turning_force(fish: RobotParameters, run, t, force, rate):
    """A force on the head that turns steadily in the tank's frame, as of a stuck thruster that hunts."""
    run.push[0], run.push[1] = force * np.cos(rate * t), force * np.sin(rate * t)


@at("each_step")
def brown_outs(fish: RobotParameters, run, t, depth, frequency):
    """The supply dips with a period of its own: gains and torque of all servos together."""
    run.share[:] = 1.0 - depth * (np.sin(2 * np.pi * frequency * t) > 0.5)


@at("each_step")
def one_sided_servo(fish: RobotParameters, run, t, loss):
    """Servos that pull less to the left than to the right."""
    wanted = run.data.ctrl - (run.data.qpos[run.hinges] - fish.zero)
    run.share[:] = np.where(wanted > 0.0, 1.0 - loss, 1.0)


@at("each_step")
def cold_grease(fish: RobotParameters, run, t, torque, time):
    """Dry friction that is there at the start of a trial and is worked out of the gears."""
    run.model.dof_frictionloss[run.hinges] = fish.friction + torque * np.exp(-t / time)


def sloshing_ballast(fish: RobotParameters, mass, frequency):
    """A part of the head's mass slides along it on a spring: MuJoCo's slide joint."""
    if mass <= 0.0:
        return

    def slide(spec):
        head = spec.body(fish.robot.links[0].name)
        own = float(head.mass)
        head.mass, head.inertia = own - mass, np.asarray(head.inertia) * (own - mass) / own
        ball = head.add_body(name=SLOSH, pos=np.asarray(head.ipos))
        ball.mass, ball.inertia, ball.ipos, ball.explicitinertial = mass, np.full(3, 1e-6), np.zeros(3), True
        joint = ball.add_joint(name=SLOSH, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
        stiff = mass * (2 * np.pi * frequency) ** 2
        joint.stiffness, joint.damping = [stiff, 0, 0], [0.1 * np.sqrt(stiff * mass), 0, 0]

    fish.specs.append(slide)


@at("seen")
def stale_frames(fish: RobotParameters, t, x, y, yaw, record, frames):
    """The tracker keeps up with every n-th frame only and repeats itself in between."""
    many = int(round(frames)) + 1
    rows = np.arange(len(t)) // many * many
    return x[rows], y[rows], yaw[rows]


@at("seen")
def slow_when_fast(fish: RobotParameters, t, x, y, yaw, record, time):
    """The tracker's search window grows with the fish's speed: its delay does too, in seconds per m/s."""
    speed = np.hypot(record.rate[:, 0], record.rate[:, 1])
    then = t - time * np.interp(t, record.t, speed)
    x0, y0, yaw0 = (record.at(t, k) for k in range(3))
    x1, y1, yaw1 = (record.at(then, k) for k in range(3))
    return x + x1 - x0, y + y1 - y0, yaw + yaw1 - yaw0


@at("seen")
def bending_mast(fish: RobotParameters, t, x, y, yaw, record, compliance):
    """The marker stands on a mast that bends against the head's acceleration across, in metres per m/s^2."""
    step = record.t[1] - record.t[0]
    ax, ay = (np.gradient(record.rate[:, k], step) for k in range(2))
    smooth = np.ones(15) / 15
    across = np.convolve(ay * np.cos(record.q[:, 2]) - ax * np.sin(record.q[:, 2]), smooth, "same")
    off = -compliance * np.interp(t, record.t, across)
    return x - off * np.sin(yaw), y + off * np.cos(yaw), yaw


@at("read")
def slack_encoder(fish: RobotParameters, t, angles, half_gap):
    """The encoder hangs on the joint with play: it reads late at every turn, the joint itself does not."""
    out = angles.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], angles[k] - half_gap, angles[k] + half_gap)
    return out


def _one(name: str, unit: str, low: float, high: float, most: float) -> Parameter:
    return Parameter(name=name, unit=unit, low=0.0, high=most, typical=(low, high))


def _shape(name: str, unit: str, low: float, high: float) -> Parameter:
    return Parameter(name=name, unit=unit, null=(low * high) ** 0.5, low=low / 4, high=high * 4, typical=(low, high), shape=True)


_ROWS = (
    (loose_tail, _one("compliance", "rad/(N m)", 0.15, 0.6, 3.0)),
    (one_sided_sticking, _one("torque", "N m", 0.08, 0.3, 1.0)),
    (leaking_hull, _one("rate", "kg/s", 0.01, 0.05, 0.2)),
    (turning_force, _one("force", "N", 0.01, 0.04, 0.5), _shape("rate", "rad/s", 0.5, 2.0)),
    (brown_outs, _one("depth", "1", 0.2, 0.6, 0.95), _shape("frequency", "Hz", 0.3, 1.7)),
    (one_sided_servo, _one("loss", "1", 0.15, 0.5, 0.95)),
    (cold_grease, _one("torque", "N m", 0.1, 0.4, 1.5), _shape("time", "s", 2.0, 5.0)),
    (sloshing_ballast, _one("mass", "kg", 0.08, 0.3, 0.5), _shape("frequency", "Hz", 0.7, 2.0)),
    (stale_frames, _one("frames", "1", 3.0, 8.0, 25.0)),
    (slow_when_fast, _one("time", "s2/m", 0.1, 0.4, 2.0)),
    (bending_mast, _one("compliance", "s2", 0.01, 0.04, 0.2)),
    (slack_encoder, _one("half_gap", "rad", 0.01, 0.04, 0.2)),
)
FAULTS = tuple(
    HiddenEntry(act.__name__, ps, act, False, (act.__doc__ or "").split("\n")[0])
    for act, *given in _ROWS
    for ps in [tuple(given)]
)
