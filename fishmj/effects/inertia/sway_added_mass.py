"""More water goes along in sway."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """Kirchhoff with Y = dm: on accelerations seen from the world, f = dm w r, -dm (a_y - u r), -dm u w."""
    m = b.wet * p.mass
    return b._replace(my=b.my + m, fx=b.fx + m * b.w * b.r, fy=b.fy + m * b.u * b.r, n=b.n - m * b.u * b.w), memory


EFFECT = Effect(
    name="sway_added_mass",
    stage="inertia",
    about="water that is accelerated with the fish when it moves sideways; shallow water raises it",
    formula="fy = -dm (dw/dt), and Kirchhoff's terms fx = dm w r, n = -dm u w",
    source="strips of this hull: 2.2 kg; tens of per cent more in shallow water",
    parameters=(Parameter(name="mass", unit="kg", low=-0.8, high=5.0, typical=(0.2, 0.8)),),
    shows=("position", "heading"),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion("munk_moment", "needs acceleration, not speed", ("impulse", "burst_and_coast")),
        Confusion("yaw_inertia", "side push without turning", ("tow_sideways", "impulse")),
        Confusion("crossflow_drag", "start of a side push against its end", ("tow_sideways", "turn_left")),
    ),
    body=body,
)
