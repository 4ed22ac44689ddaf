"""More water goes along in surge."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """Kirchhoff with X = dm: on accelerations seen from the world, f = -dm (a_x + w r), -dm u r, +dm u w."""
    m = b.wet * p.mass
    return b._replace(mx=b.mx + m, fx=b.fx - m * b.w * b.r, fy=b.fy - m * b.u * b.r, n=b.n + m * b.u * b.w), memory


EFFECT = Effect(
    name="surge_added_mass",
    stage="inertia",
    about="water that is accelerated with the fish when it speeds up or slows down",
    formula="fx = -dm (du/dt), and Kirchhoff's terms fy = -dm u r, n = dm u w",
    source="slender body: 0.06 to 0.16 kg; flooded nose and fins add to it",
    parameters=(Parameter(name="mass", unit="kg", low=-0.3, high=2.0, typical=(0.06, 0.3)),),
    shows=("position",),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion(
            "body_mass", "weigh it; a fast turn needs m u r, added mass in surge does not", ("burst_and_coast", "turn_left")
        ),
        Confusion("quadratic_drag", "speeding up against coasting", ("tow_ahead", "burst_and_coast")),
    ),
    body=body,
)
