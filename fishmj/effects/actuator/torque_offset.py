"""A constant torque of the drive."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """Constant force of an actuator with affine bias; b0 / gear."""
    m, a = site.m, site.actuator
    m.actuator_biastype[a] = max(m.actuator_biastype[a], 1)
    m.actuator_biasprm[a, 0] += p.torque / site.gear


EFFECT = Effect(
    name="torque_offset",
    stage="actuator",
    about="the current sensor's zero is off, or a cable pulls: a torque that is there without a command",
    formula="tau' = tau + o",
    source="quasi-direct drive of a pendulum: -0.076 N m (torque_limited_simple_pendulum)",
    native="actuator biasprm",
    robot=RobotForm(
        site="actuator",
        scale="torque",
        parameters=(Parameter(name="torque", unit="N m", low=-1.0, high=1.0, typical=(0.02, 0.15)),),
        fields=fields,
        confusions=(Confusion("joint_zero_offset", "a wrong zero turns gravity: an offset is the same at every angle"),),
    ),
)
