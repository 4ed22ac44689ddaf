"""The tail pushes harder or less than the model's."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """(c_n of the last link, k_e)' = (1 + g) (c_n, k_e)."""
    water, more = c.swimmer.water, 1.0 + p.gain
    water = water._replace(cn=[*water.cn[:-1], more * water.cn[-1]], ke=more * water.ke)
    return c._replace(swimmer=c.swimmer._replace(water=water))


EFFECT = Effect(
    name="tail_normal_force",
    stage="hydrodynamics",
    about="normal force and shed momentum of the tail fin: thrust and recoil in one",
    formula="(c_n, k_e)_tail' = (1 + g) (c_n, k_e)_tail",
    source="compliant and printed fins: 30 % either way",
    parameters=(Parameter(name="gain", unit="1", low=-0.95, high=2.0, typical=(0.1, 0.3)),),
    shows=("position", "heading", "power"),
    confusions=(
        Confusion("quadratic_drag", "one steady speed cannot tell thrust from drag: coast down", ("burst_and_coast", "gait")),
        Confusion("crossflow_drag", "not on the head", ("tow_sideways", "gait")),
        Confusion("wake_memory", "the same at every frequency", ("chirp", "gait")),
    ),
    fish=fish,
)
