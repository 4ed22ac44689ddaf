"""The water turns about the middle of the tank."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def flow(xp, p, place):
    """(u, v)' = (u - O y, v + O x): solid rotation about the tank's centre."""
    return place._replace(u=place.u - p.rate * place.y, v=place.v + p.rate * place.x)


EFFECT = Effect(
    name="swirl",
    stage="environment",
    about="pumps set the whole tank turning: a floating fish circles and turns with the water",
    formula="(u, v)' = (u - O y, v + O x)",
    source="pumped tanks: 0.01 to 0.05 rad/s",
    parameters=(Parameter(name="rate", unit="rad/s", low=-0.3, high=0.3, typical=(0.01, 0.05)),),
    handed=("rate",),
    shows=("position", "heading"),
    confusions=(
        Confusion("current_shear", "cross drift at other x", ("station_left", "station_right", "drift_north")),
        Confusion("steady_current", "vanishes at the centre", ("station_left", "station_right")),
    ),
    flow=flow,
)
