"""Drag with the square of speed."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """fx = -c |u| u."""
    return b._replace(fx=b.fx - b.wet * p.coefficient * xp.abs(b.u) * b.u), memory


EFFECT = Effect(
    name="quadratic_drag",
    stage="hydrodynamics",
    about="form drag along the body beyond the model's: mounts, cables, gaps in the skin",
    formula="fx = -c |u| u",
    source="this hull has 1.5 N s2/m2, half as much again with mounts and gaps; paper tunes it as a slip ratio",
    parameters=(Parameter(name="coefficient", unit="N s2/m2", low=-1.0, high=10.0, typical=(0.3, 1.0)),),
    shows=("position",),
    native="option density with fluidcoef",
    confusions=(
        Confusion("tail_normal_force", "one steady speed cannot tell thrust from drag: coast down", ("burst_and_coast", "gait")),
        Confusion("linear_surge_drag", "speeds of 3 to 1, coast to rest", ("tow_ahead", "burst_and_coast")),
        Confusion("free_surface", "grows with the square of speed, not faster", ("burst_and_coast", "gait")),
        Confusion("camera_scale", "a run of known length", ("out_and_back",)),
    ),
    body=body,
)
