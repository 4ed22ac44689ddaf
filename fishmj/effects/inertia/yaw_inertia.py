"""The links' own inertia in yaw is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """I_i' = I_i (1 + dI / sum I): own inertia of every link about its centre of mass."""
    share = 1.0 + p.inertia / sum(c.chain.inertia)
    return c._replace(chain=c.chain._replace(inertia=tuple(share * i for i in c.chain.inertia)))


EFFECT = Effect(
    name="yaw_inertia",
    stage="inertia",
    about="mass sits further out on the links: recoil and turns get slower, in air as in water",
    formula="I_i' = I_i (1 + dI/I)",
    source="20 to 30 % of a fish of 1.1 kg and 0.54 m, whose total is 0.02 kg m2",
    parameters=(Parameter(name="inertia", unit="kg m2", low=-0.002, high=0.05, typical=(0.002, 0.008)),),
    shows=("heading", "joint"),
    native="body diaginertia",
    confusions=(
        Confusion(
            other="yaw_added_mass", separates="acts in air, and on each link's own turning", excitations=("impulse", "chirp")
        ),
        Confusion(other="sway_added_mass", separates="sway is the same", excitations=("impulse", "turn_left")),
    ),
    fish=fish,
)
