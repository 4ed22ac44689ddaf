"""The centre of mass lies elsewhere along the head."""

from fishmj.effects.effect import Confusion, Effect, Parameter


def fish(xp, p, c):
    """s_0' = s_0 + x: the head link's centre of mass, which carries battery and electronics."""
    return c._replace(chain=c.chain._replace(com=(c.chain.com[0] + p.x, *c.chain.com[1:])))


EFFECT = Effect(
    name="com_offset",
    stage="inertia",
    about="battery moved: the head link's centre of mass lies ahead (x > 0) or behind; yaw and sway couple",
    formula="s_head' = s_head + x (whole fish: x m_head/m)",
    source="battery of a quarter of the weight moved by 2 to 6 cm: 5 to 15 mm",
    parameters=(Parameter(name="x", unit="m", low=-0.1, high=0.1, typical=(0.008, 0.03)),),
    shows=("position", "heading"),
    native="body ipos",
    confusions=(
        Confusion("body_lift", "no speed needed: flap on the spot", ("impulse", "turn_left")),
        Confusion("munk_moment", "no speed needed: flap on the spot", ("impulse", "tow_oblique")),
        Confusion("marker_offset", "the joints' commands move it", ("spin", "impulse")),
    ),
    fish=fish,
)
