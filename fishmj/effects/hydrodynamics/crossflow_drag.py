"""Drag across the body is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """c_n' = (1 + g) c_n on every link."""
    water = c.swimmer.water
    return c._replace(swimmer=c.swimmer._replace(water=water._replace(cn=[(1.0 + p.gain) * cn for cn in water.cn])))


EFFECT = Effect(
    name="crossflow_drag",
    stage="hydrodynamics",
    about="every link is harder or easier to push sideways: turns, side slip",
    formula="c_n' = (1 + g) c_n, all links",
    source="cross-flow coefficients of ellipses and plates: 1.1 to 2; this hull has 30 N s2/m2",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.4)),),
    shows=("position", "heading"),
    confusions=(
        Confusion("yaw_drag", "shows in a side drift without turning", ("tow_sideways", "twirl")),
        Confusion("body_lift", "no speed ahead needed", ("tow_sideways", "burst_and_coast")),
        Confusion("tail_normal_force", "acts on the head as on the tail", ("tow_sideways", "gait")),
    ),
    fish=fish,
)
