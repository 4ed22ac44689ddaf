"""A cable pulls towards a point."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """F = -k (position - anchor), world, on the reference point."""
    fx, fy = -p.stiffness * (b.x - p.x), -p.stiffness * (b.y - p.y)
    c, s = xp.cos(b.heading), xp.sin(b.heading)
    return b._replace(fx=b.fx + (c * fx + s * fy), fy=b.fy + (c * fy - s * fx)), memory


EFFECT = Effect(
    name="tether",
    stage="environment",
    about="a cable or its buoy holds the fish back towards a point of the tank",
    formula="F = -k (position - anchor)",
    source="thin cables on floats: 0.05 to 1 N/m",
    parameters=(
        Parameter(name="stiffness", unit="N/m", low=0.0, high=5.0, typical=(0.05, 0.4)),
        Parameter(name="x", unit="m", low=-1.8, high=1.8, typical=(-1.0, 1.0), shape=True),
        Parameter(name="y", unit="m", low=-1.8, high=1.8, typical=(-1.0, 1.0), shape=True),
    ),
    handed=("y",),
    shows=("position",),
    confusions=(
        Confusion("steady_current", "changes sign beyond the anchor", ("out_and_back", "drift_east")),
        Confusion("linear_surge_drag", "pulls a resting fish", ("drift_east", "out_and_back")),
    ),
    body=body,
)
