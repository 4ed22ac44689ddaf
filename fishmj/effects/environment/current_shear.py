"""The current differs across the tank."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def flow(xp, p, place):
    """u' = u + rate y."""
    return place._replace(u=place.u + p.rate * place.y)


EFFECT = Effect(
    name="current_shear",
    stage="environment",
    about="faster water on one side of the tank: drift depends on the station, and a slow turning",
    formula="u' = u + rate y",
    source="pumped tanks: 0.02 to 0.2 1/s",
    parameters=(Parameter(name="rate", unit="1/s", low=-0.5, high=0.5, typical=(0.02, 0.1)),),
    handed=("rate",),
    shows=("position", "heading"),
    confusions=(
        Confusion("wall_effect", "changes sign with the direction of travel", ("out_and_back",)),
        Confusion("swirl", "u only: no cross drift at other x", ("station_left", "station_right", "drift_north")),
        Confusion("steady_current", "the same run at two stations", ("station_left", "station_right")),
    ),
    flow=flow,
)
