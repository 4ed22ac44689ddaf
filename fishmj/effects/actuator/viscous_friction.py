"""Viscous friction of the gear train."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def gear(xp, p, g, memory, h):
    """tau = -D w, taken implicitly."""
    return g._replace(resist=g.resist + p.damping), memory


def fields(site, p):
    """MuJoCo's own linear damping."""
    site.m.dof_damping[site.dof] += p.damping


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
        Confusion("coulomb_friction", "error grows with speed", ("slow_triangle", "chirp")),
        Confusion("joint_hydro_damping", "the same in air and water; linear in speed", ("chirp", "square")),
        Confusion("speed_limit", "acts at every torque, not only near the limit", ("chirp", "steps")),
    ),
    gear=gear,
    robot=RobotForm(
        site="joint",
        scale="damping",
        parameters=(Parameter(name="damping", unit="N m s/rad", low=0.0, high=1.0, typical=(0.02, 0.15)),),
        fields=fields,
        confusions=(Confusion("coulomb_friction", "error grows with speed: move slowly, then fast"),),
    ),
)
