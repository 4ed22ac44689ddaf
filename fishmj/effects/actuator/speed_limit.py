"""The torque left at speed falls faster than the model's."""

from math import copysign

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """Torque after back-EMF, drive - k_b w, along the motion <= limit (1 - s |w|). A line above the model's own has no effect.

    On the line its slope is taken implicitly: a damping, and a torque that makes up for it at the present rate.
    """
    ahead = xp.where(g.drive >= 0.0, 1.0, -1.0)
    steeper = xp.maximum(p.slowness * g.limit - g.kb, 0.0)  # N m s/rad, than back-EMF
    line = xp.maximum(g.limit - steeper * xp.maximum(g.rate * ahead, 0.0), 0.0)
    over = g.drive * ahead >= line
    slope = xp.where(over, steeper, 0.0)
    drive = xp.where(over, ahead * line, g.drive)
    return g._replace(drive=drive, torque=g.torque + slope * g.rate, resist=g.resist + slope), memory


def law(joint, memory, slowness):
    """Torque beyond the line is taken off. Its slope is a damping, so the excess is that at the end of the step."""
    ahead = copysign(1.0, joint.drive)
    line = max(joint.limit * (1.0 - slowness * max(ahead * joint.rate, 0.0)), 0.0)
    over = max(ahead * joint.drive - line, 0.0)
    return -ahead * over / (1.0 + joint.step * joint.limit * slowness / joint.inertia), 0.0


EFFECT = Effect(
    name="speed_limit",
    stage="actuator",
    about="a steeper torque-speed line: fast joints lose torque, a large fast sine becomes a triangle",
    formula="torque <= limit (1 - s |w|) along the motion; 1/s is the speed at which nothing is left",
    source="paper: 0.2 s per 60 deg without load; low voltage and stiff grease halve it",
    parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=2.0, typical=(0.21, 0.5)),),
    shows=("joint", "position", "power"),
    native="actuator dcmotor",
    confusions=(
        Confusion("torque_saturation", "a speed limit is the same in air and in water", ("square", "chirp")),
        Confusion("rate_limit", "load dependent: same move in air and water", ("steps", "square")),
        Confusion(
            "move_time_ramp", "the same slope for every step size; a ramp's slope grows with the step", ("steps", "staircase")
        ),
    ),
    gear=gear,
    robot=RobotForm(
        site="actuator",
        scale="time",
        parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=4.0, typical=(0.2, 0.8)),),
        law=law,
        confusions=(
            Confusion("torque_saturation", "cuts off at speed only: stall the joint, then move it fast"),
            Confusion("viscous_friction", "acts near the limit only: move fast with a small torque"),
        ),
    ),
)
