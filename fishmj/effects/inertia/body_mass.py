"""The fish is heavier: trapped water, payload."""

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fish(xp, p, c):
    """m_i' = m_i (1 + k dm / sum m), inertia alike; q = (1 - k) dm at the head's origin leaves its other moments as they are."""
    share, q = 1.0 + p.spread * p.mass / sum(c.chain.mass), (1.0 - p.spread) * p.mass
    m, com, inertia = share * c.chain.mass[0], c.chain.com[0], share * c.chain.inertia[0]
    less = q / (m + q)
    chain = c.chain._replace(
        mass=(m + q, *c.chain.mass[1:]),
        com=(com * (1.0 - less), *c.chain.com[1:]),
        inertia=(inertia + m * com * com * less, *c.chain.inertia[1:]),
    )
    head, *others = c.swimmer.mass
    return c._replace(chain=chain, swimmer=c.swimmer._replace(mass=[head, *(share * x for x in others)]))


def fields(site, p):
    """m' = m + dm, inertia alike, the centre where it is."""
    m = site.m
    m.body_inertia[site.body] *= 1.0 + p.mass / m.body_mass[site.body]
    m.body_mass[site.body] += p.mass


EFFECT = Effect(
    name="body_mass",
    stage="inertia",
    about="water under the skin, spread over the links by their share, or a payload at the head's reference point",
    formula="m_i' = m_i (1 + k dm/m), head + (1 - k) dm",
    source="a flooded skin holds 0.05 to 0.3 kg",
    parameters=(
        Parameter(name="mass", unit="kg", low=-0.5, high=1.5, typical=(0.05, 0.3)),
        Parameter(
            name="spread", unit="1", null=1.0, low=-0.5, high=1.5, typical=(0.0, 1.0), shape=True, about="k: 1 spread, 0 payload"
        ),
    ),
    shows=("position", "heading", "joint"),
    native="body mass",
    confusions=(
        Confusion(
            "surge_added_mass",
            "weigh it; a fast turn needs m u r, added mass in surge does not",
            ("burst_and_coast", "turn_left"),
        ),
        Confusion("quadratic_drag", "steady speed is the same", ("gait", "burst_and_coast")),
    ),
    fish=fish,
    robot=RobotForm(
        site="body",
        scale="mass",
        parameters=(Parameter(name="mass", unit="kg", low=-0.9, high=5.0, typical=(0.1, 0.5)),),
        fields=fields,
    ),
)
