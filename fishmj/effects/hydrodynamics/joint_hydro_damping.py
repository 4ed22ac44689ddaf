"""Water brakes the joints with the square of their rate."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def gear(xp, p, g, memory, h):
    """tau = -c |w| w in water, as its secant, taken implicitly."""
    return g._replace(resist=g.resist + p.coefficient * xp.abs(g.rate) * g.wet), memory


EFFECT = Effect(
    name="joint_hydro_damping",
    stage="hydrodynamics",
    about="folds and gaps at the joints pump water: damping with the square of the rate, in water only",
    formula="tau = -c |w| w (in water)",
    source="paper, calibration of the servos in air and water; 0.005 to 0.05 N m s2",
    parameters=(Parameter(name="coefficient", unit="N m s2", low=0.0, high=0.5, typical=(0.005, 0.05)),),
    shows=("joint", "power"),
    confusions=(
        Confusion("viscous_friction", "not in air", ("chirp", "square")),
        Confusion("crossflow_drag", "does not push the body", ("gait", "tow_sideways")),
    ),
    gear=gear,
)
