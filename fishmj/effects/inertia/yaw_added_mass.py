"""More water goes along in yaw."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """n = -dI dr/dt; rotation alone has no velocity terms."""
    return b._replace(mn=b.mn + b.wet * p.inertia), memory


EFFECT = Effect(
    name="yaw_added_mass",
    stage="inertia",
    about="water that is turned with the head: recoil and turns get slower, in water only",
    formula="n = -dI (dr/dt)",
    source="strips of this hull: about 0.05 kg m2; 10 to 30 % of it",
    parameters=(Parameter(name="inertia", unit="kg m2", low=-0.005, high=0.2, typical=(0.004, 0.02)),),
    shows=("heading",),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion("yaw_inertia", "not in air", ("impulse", "chirp")),
        Confusion("yaw_drag", "start of a turn against its end", ("twirl", "spin")),
    ),
    body=body,
)
