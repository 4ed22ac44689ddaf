"""The moment that turns a body broadside is off."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def body(xp, p, b, memory, h):
    """n = -g m_sway u w, m_sway the base model's added mass in sway: turns the nose away from the direction of drift."""
    return b._replace(n=b.n - p.gain * b.sway_mass * b.u * b.w), memory


EFFECT = Effect(
    name="munk_moment",
    stage="hydrodynamics",
    about="a body that moves askew is turned further askew; viscosity leaves 0.7 to 1.1 of the ideal moment",
    formula="n = -g m_sway u w",
    source="Munk 1924; factors of 0.7 to 1.1 on hulls",
    parameters=(Parameter(name="gain", unit="1", low=-1.5, high=2.0, typical=(0.1, 0.3)),),
    shows=("heading", "position"),
    confusions=(
        Confusion("body_lift", "a moment, not a force", ("tow_oblique", "turn_left")),
        Confusion("com_offset", "needs speed", ("impulse", "tow_oblique")),
        Confusion("sway_added_mass", "needs no acceleration", ("impulse", "tow_oblique")),
    ),
    body=body,
)
