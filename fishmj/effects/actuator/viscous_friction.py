"""Viscous friction of the gear train."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def gear(xp, p, g, memory, h):
    """tau = -D w, taken implicitly."""
    return g._replace(resist=g.resist + p.damping), memory


EFFECT = Effect(
    name="viscous_friction",
    stage="actuator",
    about="grease and back-EMF beyond the model's: a torque against the motion in proportion to speed",
    formula="tau = -D w",
    source="Rhoban BAM M1; 0.01 to 0.3 N m s/rad",
    parameters=(Parameter(name="damping", unit="N m s/rad", low=0.0, high=1.0, typical=(0.02, 0.15)),),
    shows=("joint", "power"),
    native="joint damping",
    confusions=(
        Confusion(other="coulomb_friction", separates="error grows with speed", excitations=("slow_triangle", "chirp")),
        Confusion(
            other="joint_hydro_damping", separates="the same in air and water; linear in speed", excitations=("chirp", "square")
        ),
        Confusion(other="speed_limit", separates="acts at every torque, not only near the limit", excitations=("chirp", "steps")),
    ),
    gear=gear,
)
