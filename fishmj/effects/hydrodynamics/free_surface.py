"""Waves at the surface cost drag."""

from fishmj.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter
from fishmj.units import G

AT = 0.1  # Froude number at which the gain is the drag added over the drag there was
SPEED2 = AT * AT * G * constant("robot", "length")  # m2/s2, its speed squared


def body(xp, p, b, memory, h):
    """fx = -g c (Fr / 0.1)^2 |u| u, Fr^2 = u^2 / (g L), c the base model's surge drag."""
    return b._replace(fx=b.fx - b.wet * p.gain * b.drag * (b.u * b.u / SPEED2) * xp.abs(b.u) * b.u), memory


EFFECT = Effect(
    name="free_surface",
    stage="hydrodynamics",
    about="a fish close under the surface makes waves: drag that grows with the fourth power of speed",
    formula="fx = -g c (Fr/0.1)^2 |u| u, Fr^2 = u^2/(g L)",
    source="hulls close under the surface; Froude numbers here are 0.04 to 0.2",
    parameters=(Parameter(name="gain", unit="1", low=0.0, high=20.0, typical=(0.2, 1.0)),),
    shows=("position",),
    confusions=(
        Confusion(other="quadratic_drag", separates="only at speed; two depths", excitations=("burst_and_coast", "gait")),
        Confusion(other="wall_effect", separates="the same everywhere in the tank", excitations=("out_and_back",)),
    ),
    body=body,
)
