"""The camera's scale is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """(x, y)' = (1 + s) (x, y)."""
    return seen._replace(x=(1.0 + p.scale) * seen.x, y=(1.0 + p.scale) * seen.y)


EFFECT = Effect(
    name="camera_scale",
    stage="measurement",
    about="all lengths come out too long or too short: height of the camera, refraction",
    formula="(x, y)' = (1 + s) (x, y)",
    source="overhead camera 3 m above water: 1 to 4 %",
    parameters=(Parameter(name="scale", unit="1", low=-0.2, high=0.2, typical=(0.01, 0.04)),),
    shows=("position",),
    confusions=(Confusion("quadratic_drag", "a run of known length", ("out_and_back",)),),
    measure=measure,
    rank=2,
)
