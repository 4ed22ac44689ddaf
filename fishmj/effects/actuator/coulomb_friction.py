"""Coulomb friction of the gear train."""

from fishmj.effects.effect import Confusion, Effect, Parameter

CREEP = 0.02  # rad/s, below which friction grows linearly: a hundredth of a beat's fastest rate


def gear(xp, p, g, memory, h):
    """tau = -F_c w / sqrt(w^2 + w_c^2), as its secant F_c / sqrt(w^2 + w_c^2), taken implicitly."""
    return g._replace(resist=g.resist + p.torque / xp.sqrt(g.rate * g.rate + CREEP * CREEP)), memory


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
        Confusion(
            other="viscous_friction",
            separates="friction error does not depend on amplitude or speed",
            excitations=("slow_triangle", "chirp"),
        ),
        Confusion(
            other="servo_deadband",
            separates="a dead band's error does not depend on load or direction",
            excitations=("staircase", "slow_triangle"),
        ),
    ),
    gear=gear,
)
