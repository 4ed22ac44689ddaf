"""Encoders read zero where the joint is not straight."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm

OFFSETS = ("offset1", "offset2", "offset3")


def of(p, joint: int):
    """Offset of one joint [rad]; joints beyond the third share its value."""
    return getattr(p, OFFSETS[min(joint, len(OFFSETS) - 1)])


def servo(xp, p, s, memory, h):
    """The controller closes its loop on the encoder: e' = e + o."""
    return s._replace(error=s.error + of(p, p.joint)), memory


def measure(xp, p, seen):
    """The log holds the encoder's reading: angle - o."""
    offsets = xp.stack([of(p, j) + 0.0 for j in range(seen.joint.shape[-1])], axis=-1)
    return seen._replace(joint=seen.joint - offsets)


def fields(site, p):
    """A controller in the motor closes its loop on the encoder."""
    if site.actuator >= 0:
        m, a = site.m, site.actuator
        m.actuator_biasprm[a, 0] -= m.actuator_biasprm[a, 1] * m.actuator_gear[a, 0] * p.offset


def reading(p):
    """Encoder: angle - o."""
    return 1.0, p.offset


EFFECT = Effect(
    name="joint_zero_offset",
    stage="actuator",
    about="a servo horn one tooth off: the fish is bent while its encoders say straight, so it turns",
    formula="hinge angle = encoder angle + o",
    source="paper randomises +-5 deg; open hardware's centre counts are 2.4 to 4.8 deg off",
    parameters=tuple(
        Parameter(name=name, unit="rad", low=-0.2, high=0.2, typical=(0.02, 0.087), joint=joint)
        for joint, name in enumerate(OFFSETS, 1)
    ),
    handed=OFFSETS,
    shows=("position", "heading"),
    native="joint ref",
    confusions=(
        Confusion("steady_current", "an offset turns with the fish, a current does not", ("drift_east", "gait_mirrored")),
        Confusion("camera_yaw", "a turned camera turns straight tracks, an offset bends them", ("gait", "gait_mirrored")),
        Confusion("servo_deadband", "does not change sign with the direction of approach", ("staircase",)),
    ),
    servo=servo,
    measure=measure,
    robot=RobotForm(
        site="joint",
        parameters=(Parameter(name="offset", unit="rad", low=-0.5, high=0.5, typical=(0.01, 0.06)),),
        fields=fields,
        reading=reading,
    ),
)
