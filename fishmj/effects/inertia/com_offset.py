"""The centre of mass lies elsewhere along the head."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fish(xp, p, c):
    """s_0' = s_0 + x: the head link's centre of mass, which carries battery and electronics."""
    return c._replace(chain=c.chain._replace(com=(c.chain.com[0] + p.x, *c.chain.com[1:])))


def fields(site, p):
    """Place of a body's centre of mass in the body's frame."""
    site.m.body_ipos[site.body] += p.x, p.y, p.z


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
    robot=RobotForm(
        site="body",
        scale="length",
        parameters=tuple(Parameter(name=n, unit="m", low=-1.0, high=1.0, typical=(0.03, 0.2)) for n in "xyz"),
        fields=fields,
    ),
)
