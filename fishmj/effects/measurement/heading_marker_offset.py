"""The marker for heading sits askew."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """yaw' = yaw + d."""
    return seen._replace(yaw=seen.yaw + p.angle)


EFFECT = Effect(
    name="heading_marker_offset",
    stage="measurement",
    about="heading is off by a constant, the track is not: it seems to slip sideways",
    formula="yaw' = yaw + d",
    source="paper, red head and yellow neck by eye: 1 to 5 deg",
    parameters=(Parameter(name="angle", unit="rad", low=-0.3, high=0.3, typical=(0.017, 0.087)),),
    handed=("angle",),
    shows=("heading",),
    confusions=(
        Confusion("camera_yaw", "the track keeps its direction", ("tow_oblique", "gait")),
        Confusion("com_offset", "the same at rest", ("drift_east", "turn_left")),
    ),
    measure=measure,
    rank=4,
)
