"""The camera is turned against the tank."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def measure(xp, p, seen):
    """(x, y)' = R(d) (x, y), yaw' = yaw + d."""
    c, s = xp.cos(p.angle), xp.sin(p.angle)
    return seen._replace(x=c * seen.x - s * seen.y, y=c * seen.y + s * seen.x, yaw=seen.yaw + p.angle)


EFFECT = Effect(
    name="camera_yaw",
    stage="measurement",
    about="tracks and headings are turned as a whole; only an outside axis, such as the flow's, can tell",
    formula="(x, y)' = R(d) (x, y), yaw' = yaw + d",
    source="overhead camera on a beam: 1 to 5 deg",
    parameters=(Parameter(name="angle", unit="rad", low=-0.3, high=0.3, typical=(0.017, 0.087)),),
    handed=("angle",),
    shows=("position", "heading"),
    confusions=(
        Confusion("heading_marker_offset", "turns the track too", ("burst_and_coast", "gait")),
        Confusion(
            "steady_current", "a turned camera turns tracks, a current moves a resting fish", ("drift_east", "drift_north")
        ),
    ),
    measure=measure,
    rank=3,
)
