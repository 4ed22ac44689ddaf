"""Waves at the surface cost drag."""

from fishmj.base.calib import constant
from fishmj.base.units import G
from fishmj.effects.effect import Confusion, Effect, Parameter

GRAVITY_LENGTH = G * constant("robot", "length")  # m2/s2: Froude number 1


def body(xp, p, b, memory, h):
    """fx = -c Fr^2 |u| u, Fr^2 = u^2 / (g L)."""
    return b._replace(fx=b.fx - b.wet * p.gain * (b.u * b.u / GRAVITY_LENGTH) * xp.abs(b.u) * b.u), memory


EFFECT = Effect(
    name="free_surface",
    stage="hydrodynamics",
    about="a fish close under the surface makes waves: drag that grows with the fourth power of speed",
    formula="fx = -c Fr^2 |u| u, Fr^2 = u^2/(g L)",
    source="hulls close under the surface; Froude numbers here are 0.04 to 0.2",
    parameters=(Parameter(name="gain", unit="N s2/m2", low=0.0, high=1000.0, typical=(20.0, 150.0)),),
    shows=("position",),
    confusions=(
        Confusion("quadratic_drag", "only at speed; two depths", ("burst_and_coast", "gait")),
        Confusion("wall_effect", "the same everywhere in the tank", ("out_and_back",)),
    ),
    body=body,
)
