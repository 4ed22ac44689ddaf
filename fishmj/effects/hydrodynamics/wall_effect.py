"""Water forces grow near the walls."""

from fishmj.calib import constant
from fishmj.effects.effect import Confusion, Effect, Parameter

HALF = constant("tank", "size")[0] / 2  # m, the tank's walls are at x, y = +-HALF
LENGTH = constant("robot", "length")  # m, over which a wall is felt


def water(xp, p, w, memory, h):
    """f' = f (1 + a e^(-d / L)), d the distance to the nearest wall; forces but those of the added mass."""
    gap = xp.maximum(HALF - xp.maximum(xp.abs(w.x), xp.abs(w.y)), 0.0)
    more = p.gain * xp.exp(-gap / LENGTH)
    near = [
        tuple(f + more * (f - i) for f, i in zip(pair[0], pair[1], strict=True)) for pair in zip(w.forces, w.instant, strict=True)
    ]
    return w._replace(forces=near), memory


EFFECT = Effect(
    name="wall_effect",
    stage="hydrodynamics",
    about="drag and push of the tail rise within a body length of a wall",
    formula="f' = f (1 + a e^(-d/L)), d to the nearest wall",
    source="blockage in tanks: 5 to 30 % within half a length",
    parameters=(Parameter(name="gain", unit="1", low=-0.5, high=2.0, typical=(0.1, 0.5)),),
    shows=("position", "heading"),
    confusions=(
        Confusion(
            other="current_shear",
            separates="the same in both directions of travel",
            excitations=("out_and_back", "station_left", "station_right"),
        ),
        Confusion(other="lens_distortion", separates="acts on the motion, not on a resting fish", excitations=("out_and_back",)),
        Confusion(other="quadratic_drag", separates="not in the middle of the tank", excitations=("out_and_back", "gait")),
    ),
    water=water,
)
