"""Friction that grows with the load on the teeth."""

from fishmj.effects.dry_friction import AT_REST, apply_dry_friction
from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """Friction of at most K |tau_m|, sticking at rest; tau_m = drive - k_b w is the motor's torque on the teeth."""
    load = xp.abs(g.drive - g.kb * g.rate)
    return apply_dry_friction(xp, lambda speed: p.ratio * load, g, memory, h)


def law(joint, memory, ratio):
    """Limit of the friction under the present torque of the actuator."""
    return 0.0, ratio * abs(joint.drive)


EFFECT = Effect(
    name="load_friction",
    stage="actuator",
    about="teeth under load rub harder: lifting costs more than lowering gives back, holding has a hysteresis",
    formula="tau = -K |tau_motor| sign(w)",
    source="Rhoban BAM M3; 0.1 to 0.3, 0.15 on an XL330",
    parameters=(Parameter(name="ratio", unit="1", low=0.0, high=1.0, typical=(0.1, 0.3)),),
    shows=("joint", "power"),
    confusions=(
        Confusion("coulomb_friction", "vary the load at equal speed", ("hold_angles", "slow_triangle")),
        Confusion("voltage_sag", "vary the speed at equal load", ("chirp", "steps")),
        Confusion("servo_gain", "acts on the moving joint only", ("staircase", "chirp")),
    ),
    memory=AT_REST,
    gear=gear,
    robot=RobotForm(
        site="actuator",
        parameters=(Parameter(name="ratio", unit="1", low=0.0, high=1.0, typical=(0.05, 0.3)),),
        law=law,
        confusions=(
            Confusion("coulomb_friction", "grows with the load: vary the load at equal speed"),
            Confusion("servo_gain", "acts on the moving joint only: hold a load, then lift and lower it"),
        ),
    ),
)
