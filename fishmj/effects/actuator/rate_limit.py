"""The firmware limits how fast a command may move."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def command(xp, p, value, memory, h):
    """|c'_k - c'_{k-1}| <= h / s."""
    (last,) = memory
    most = h / xp.where(p.slowness > 0.0, p.slowness, 1.0)
    near = last + xp.minimum(xp.maximum(value - last, -most), most)
    moved = xp.where(p.slowness > 0.0, near, value)
    return moved, (moved,)


EFFECT = Effect(
    name="rate_limit",
    stage="actuator",
    about="large moves become ramps of one slope, whatever the load",
    formula="|dc'/dt| <= 1/s",
    source="servo firmware: 2 to 8 rad/s",
    parameters=(Parameter(name="slowness", unit="s/rad", low=0.0, high=2.0, typical=(0.15, 0.5)),),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("speed_limit", "does not depend on load, air against water", ("square", "steps")),
        Confusion("move_time_ramp", "one slope for every step size", ("staircase", "steps")),
        Confusion("torque_saturation", "small fast moves stay whole", ("steps", "chirp")),
    ),
    memory=(0.0,),
    command=command,
    rank=3,
)
