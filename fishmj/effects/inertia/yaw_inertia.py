"""The head's inertia in yaw is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """I_0' = I_0 + dI: the head link about its centre of mass; it carries two thirds of the mass."""
    return c._replace(chain=c.chain._replace(inertia=(c.chain.inertia[0] + p.inertia, *c.chain.inertia[1:])))


EFFECT = Effect(
    name="yaw_inertia",
    stage="inertia",
    about="mass sits further out in the head: recoil and turns get slower, in air as in water",
    formula="I_head' = I_head + dI",
    source="20 to 30 % of a fish of 1.1 kg and 0.54 m, whose total is 0.02 kg m2",
    parameters=(Parameter(name="inertia", unit="kg m2", low=-0.002, high=0.05, typical=(0.002, 0.008)),),
    shows=("heading", "joint"),
    native="body diaginertia",
    confusions=(
        Confusion("yaw_added_mass", "acts in air too", ("impulse", "chirp")),
        Confusion("sway_added_mass", "sway is the same", ("impulse", "turn_left")),
    ),
    fish=fish,
)
