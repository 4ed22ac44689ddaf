"""Coulomb friction of the gear train."""

from fishmj.effects.dry_friction import AT_REST, apply_dry_friction
from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """Friction of at most F_c, sticking at rest."""
    return apply_dry_friction(xp, lambda speed: p.torque, g, memory, h)


def fields(site, p):
    """MuJoCo's own dry friction."""
    site.m.dof_frictionloss[site.dof] += p.torque


EFFECT = Effect(
    name="coulomb_friction",
    stage="actuator",
    about="dry friction in the gears: a torque against the motion whose size does not depend on speed",
    formula="tau = -F_c sign(w)",
    source="Rhoban BAM M1; a bus servo of this size has 0.03 to 0.2 N m",
    parameters=(Parameter(name="torque", unit="N m", low=0.0, high=0.8, typical=(0.03, 0.2)),),
    shows=("joint", "power"),
    native="joint frictionloss",
    confusions=(
        Confusion("viscous_friction", "friction error does not depend on amplitude or speed", ("slow_triangle", "chirp")),
        Confusion("servo_deadband", "a dead band's error does not depend on load or direction", ("staircase", "slow_triangle")),
    ),
    memory=AT_REST,
    gear=gear,
    robot=RobotForm(
        site="joint",
        scale="torque",
        parameters=(Parameter(name="torque", unit="N m", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=fields,
        confusions=(Confusion("viscous_friction", "friction error does not depend on speed: move slowly, then fast"),),
    ),
)
