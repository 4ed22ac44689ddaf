"""Friction of a joint that grows with the square of its rate."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """Second coefficient of MuJoCo's polynomial damping."""
    site.m.dof_dampingpoly[site.dof, 0] += p.drag


EFFECT = Effect(
    name="quadratic_friction",
    stage="actuator",
    about="churning grease, a fan on the shaft, or a link that stirs air or water",
    formula="tau = -D |w| w",
    source="seals and fans: a few per cent of the torque at full speed",
    native="joint damping, its second number",
    robot=RobotForm(
        site="joint",
        scale="drag",
        parameters=(Parameter(name="drag", unit="N m s2/rad2", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=fields,
        confusions=(Confusion("viscous_friction", "error grows with the square of speed: move slowly, then fast"),),
    ),
)
