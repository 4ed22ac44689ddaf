"""The power meter has an offset."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """P' = P + P_0."""
    return seen._replace(power=seen.power + p.power)


EFFECT = Effect(
    name="power_offset",
    stage="measurement",
    about="radio, lamps or the meter itself add a constant to the power",
    formula="P' = P + P_0",
    source="idle draw of boards: 0.1 to 0.5 W",
    parameters=(Parameter(name="power", unit="W", low=-2.0, high=3.0, typical=(0.1, 0.5)),),
    shows=("power",),
    confusions=(Confusion("skin_stiffness", "the same at every angle", ("idle", "hold_angles")),),
    measure=measure,
)
