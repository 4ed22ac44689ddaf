"""Turning is braked harder."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """n = -c |r| r."""
    return b._replace(n=b.n - b.wet * p.coefficient * xp.abs(b.r) * b.r), memory


EFFECT = Effect(
    name="yaw_drag",
    stage="hydrodynamics",
    about="the head's turning is braked with the square of its rate: side fins, masts",
    formula="n = -c |r| r",
    source="plates on a hull of 0.54 m: 0.01 to 0.3 N m s2",
    parameters=(Parameter(name="coefficient", unit="N m s2", low=0.0, high=1.0, typical=(0.005, 0.05)),),
    shows=("heading", "position"),
    confusions=(
        Confusion("crossflow_drag", "does not show in a side drift", ("tow_sideways", "twirl")),
        Confusion("yaw_added_mass", "end of a turn against its start", ("twirl", "spin")),
    ),
    body=body,
)
