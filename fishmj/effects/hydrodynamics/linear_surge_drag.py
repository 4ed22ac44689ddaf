"""Drag in proportion to speed."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """fx = -c u."""
    return b._replace(fx=b.fx - b.wet * p.coefficient * b.u), memory


EFFECT = Effect(
    name="linear_surge_drag",
    stage="hydrodynamics",
    about="laminar drag along the body: what is left of a coast when it is slow",
    formula="fx = -c u",
    source="boundary layer of a body of 0.5 m: 0.1 to 0.8 N s/m",
    parameters=(Parameter(name="coefficient", unit="N s/m", low=0.0, high=5.0, typical=(0.1, 0.8)),),
    shows=("position",),
    native="option viscosity",
    confusions=(
        Confusion("quadratic_drag", "speeds of 3 to 1, coast to rest", ("tow_ahead", "burst_and_coast")),
        Confusion("steady_current", "coast in two headings", ("burst_and_coast", "out_and_back")),
        Confusion("tether", "does not depend on where the fish is", ("out_and_back",)),
    ),
    body=body,
)
