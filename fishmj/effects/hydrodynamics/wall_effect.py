"""Water forces grow near the walls."""

from fishmj.base.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter

HALF = constant("tank", "size")[0] / 2  # m, the tank's walls are at x, y = +-HALF
LENGTH = constant("robot", "length")  # m, over which a wall is felt


def more(xp, p, x, y):
    """a e^(-d / L), d the distance from the reference point to the nearest wall [m]."""
    gap = xp.maximum(HALF - xp.maximum(xp.abs(x), xp.abs(y)), 0.0)
    return p.gain * xp.exp(-gap / LENGTH)


def water(xp, p, w, memory, h):
    """f' = f (1 + a e^(-d / L)) for drag and trailing edge."""
    share = more(xp, p, w.x, w.y)
    pairs = zip(w.forces, w.instant, strict=True)
    near = [tuple(f + share * (f - i) for f, i in zip(force, instant, strict=True)) for force, instant in pairs]
    return w._replace(forces=near), memory


def body(xp, p, b, memory, h):
    """m_a' = m_a (1 + a e^(-d / L)): the added mass alike."""
    return b._replace(added=b.added + more(xp, p, b.x, b.y)), memory


EFFECT = Effect(
    name="wall_effect",
    stage="hydrodynamics",
    about="drag, push of the tail and added mass rise within a body length of a wall",
    formula="(f, m_a)' = (f, m_a) (1 + a e^(-d/L)), d to the nearest wall",
    source="blockage in tanks: 5 to 30 % within half a length",
    parameters=(Parameter(name="gain", unit="1", low=-0.5, high=5.0, typical=(0.1, 0.5)),),
    shows=("position", "heading"),
    confusions=(
        Confusion("current_shear", "the same in both directions of travel", ("out_and_back", "station_left", "station_right")),
        Confusion("lens_distortion", "acts on the motion, not on a resting fish", ("out_and_back",)),
        Confusion("quadratic_drag", "not in the middle of the tank", ("out_and_back", "gait")),
    ),
    water=water,
    body=body,
)
