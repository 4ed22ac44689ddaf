"""Extra friction at creep speed."""

from math import exp

from fishmj.effects.dry_friction import AT_REST, apply_dry_friction
from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """Friction of at most F_s exp(-(w / w_s)^2), sticking at rest."""
    return apply_dry_friction(xp, lambda speed: p.torque * xp.exp(-((speed / p.speed) ** 2)), g, memory, h)


def law(joint, memory, torque, speed):
    """Limit of the friction at the present rate."""
    return 0.0, torque * exp(-((joint.rate / speed) ** 2))


EFFECT = Effect(
    name="stribeck",
    stage="actuator",
    about="friction that is higher at creep speed than in motion: stick and slip",
    formula="tau = -F_s exp(-(w/w_s)^2) sign(w)",
    source="Stribeck curve as in LuGre and Rhoban BAM M2; half to one and a half times Coulomb friction",
    parameters=(
        Parameter(name="torque", unit="N m", low=0.0, high=0.8, typical=(0.03, 0.2)),
        Parameter(name="speed", unit="rad/s", null=0.1, low=0.01, high=1.0, typical=(0.05, 0.2), shape=True),
    ),
    shows=("joint", "power"),
    confusions=(
        Confusion("coulomb_friction", "vanishes at speed: needs a decade of low speeds", ("creep", "slow_triangle", "chirp")),
        Confusion("servo_deadband", "depends on speed at small error", ("slow_triangle",)),
    ),
    memory=AT_REST,
    gear=gear,
    robot=RobotForm(
        site="joint",
        scale=("torque", ""),
        parameters=(
            Parameter(name="torque", unit="N m", low=0.0, high=1.0, typical=(0.03, 0.2)),
            Parameter(name="speed", unit="rad/s", null=0.1, low=0.01, high=5.0, typical=(0.05, 2.0), shape=True),
        ),
        law=law,
        confusions=(
            Confusion("coulomb_friction", "vanishes at speed: creep, then move fast"),
            Confusion("load_friction", "does not depend on the load: vary it at creep speed"),
        ),
    ),
)
