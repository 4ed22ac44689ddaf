"""The tracked spot is not the reference point."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """(x, y)' = (x, y) + d (cos yaw, sin yaw)."""
    return seen._replace(x=seen.x + p.x * xp.cos(seen.yaw), y=seen.y + p.x * xp.sin(seen.yaw))


EFFECT = Effect(
    name="marker_offset",
    stage="measurement",
    about="the spot that the camera follows lies ahead of the reference point (x > 0) or behind: sway seems to go with yaw",
    formula="(x, y)' = (x, y) + d (cos yaw, sin yaw)",
    source="colour blobs on the head: 10 to 40 mm",
    parameters=(Parameter(name="x", unit="m", low=-0.15, high=0.15, typical=(0.01, 0.04)),),
    shows=("position",),
    confusions=(
        Confusion("camera_latency", "goes with heading, not with rate", ("spin", "turn_left")),
        Confusion("com_offset", "does not act on the motion", ("spin", "impulse")),
    ),
    measure=measure,
)
