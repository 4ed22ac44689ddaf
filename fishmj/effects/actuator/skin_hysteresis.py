"""The skin creeps: a spring whose rest angle follows."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def gear(xp, p, g, memory, h):
    """Maxwell branch: tau = -k (angle - z), z' = (angle - z) / T, advanced exactly for a held angle."""
    (rest,) = memory
    rest = g.angle + (rest - g.angle) * xp.exp(-h / p.time)
    return g._replace(torque=g.torque - p.stiffness * (g.angle - rest), resist=g.resist + h * p.stiffness), (rest,)


EFFECT = Effect(
    name="skin_hysteresis",
    stage="actuator",
    about="a viscoelastic skin: resists change, then gives way; creep after a step, loops at any speed",
    formula="tau = -k (angle - z), z' = (angle - z)/T",
    source="silicone: loss factor 0.1 to 0.3",
    parameters=(
        Parameter(name="stiffness", unit="N m/rad", low=0.0, high=6.0, typical=(0.2, 1.0)),
        Parameter(name="time", unit="s", null=0.5, low=0.02, high=10.0, typical=(0.1, 1.0), shape=True),
    ),
    shows=("joint", "position", "power"),
    confusions=(
        Confusion("skin_stiffness", "relaxes while an angle is held", ("hold_angles", "square")),
        Confusion("coulomb_friction", "recovers without drift, loops depend on rate", ("slow_triangle",)),
        Confusion("wake_memory", "the same in air", ("square", "hold_angles")),
    ),
    memory=(0.0,),
    gear=gear,
)
