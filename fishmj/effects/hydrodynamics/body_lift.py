"""Side force of a body at a drift angle."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """fy = -Y |u| w: against the sway whether it swims ahead or astern, so it never feeds energy."""
    return b._replace(fy=b.fy - b.wet * p.coefficient * xp.abs(b.u) * b.w), memory


EFFECT = Effect(
    name="body_lift",
    stage="hydrodynamics",
    about="a hull that moves askew sheds lift at its end: side force with speed times sway",
    formula="fy = -Y |u| w",
    source="published models of robotic fish: 5 to 30 N s2/m2",
    parameters=(Parameter(name="coefficient", unit="N s2/m2", low=0.0, high=100.0, typical=(4.0, 20.0)),),
    shows=("position", "heading"),
    native="body fluidcoef (Kutta lift)",
    confusions=(
        Confusion("munk_moment", "a force, not a moment: heading keeps", ("tow_oblique", "turn_left")),
        Confusion("crossflow_drag", "vanishes without speed ahead", ("tow_sideways", "tow_oblique")),
        Confusion("sway_added_mass", "does not need acceleration", ("impulse", "turn_left")),
    ),
    body=body,
)
