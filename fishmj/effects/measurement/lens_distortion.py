"""The lens bends straight lines."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """(x, y)' = (x, y) (1 + k_1 (x^2 + y^2)), about the tank's centre."""
    wide = 1.0 + p.k1 * (seen.x * seen.x + seen.y * seen.y)
    return seen._replace(x=wide * seen.x, y=wide * seen.y)


EFFECT = Effect(
    name="lens_distortion",
    stage="measurement",
    about="lengths at the edge of the picture come out too long or too short",
    formula="(x, y)' = (x, y) (1 + k_1 r^2)",
    source="wide lenses: 1 to 2 % at the edge, 1.8 m from the centre",
    parameters=(Parameter(name="k1", unit="1/m2", low=-0.1, high=0.1, typical=(0.003, 0.01)),),
    shows=("position",),
    confusions=(
        Confusion("camera_scale", "none at the centre", ("station_left", "station_right", "out_and_back")),
        Confusion("wall_effect", "bends a resting grid", ("out_and_back",)),
    ),
    measure=measure,
    rank=1,
)
