"""A point mass at the end of a link."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def fields(site, p):
    """The mass sits twice as far from the body's frame as the centre of mass; inertia by the parallel axes."""
    m, b = site.m, site.body
    apart = m.body_ipos[b].copy()
    own = m.body_mass[b]
    share = p.mass / (own + p.mass)
    m.body_inertia[b] += own * share * (apart @ apart - along(m, b, apart) ** 2)
    m.body_ipos[b] += share * apart
    m.body_mass[b] = own + p.mass


def along(m, b, place):
    """(3,) components of a vector of the body's frame along its principal axes."""
    w, x, y, z = m.body_iquat[b]
    axes = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(axes) @ place


EFFECT = Effect(
    name="payload",
    stage="inertia",
    about="a gripper, a tool or what it carries is not in the description",
    formula="m' = m + dm at 2 r",
    source="tools of small arms: 5 to 50 % of the last link",
    native="body inertial",
    robot=RobotForm(
        site="body",
        scale="mass",
        parameters=(Parameter(name="mass", unit="kg", low=0.0, high=5.0, typical=(0.05, 0.5)),),
        fields=fields,
        confusions=(Confusion("body_mass", "weigh the link, and balance it on an edge"),),
    ),
)
