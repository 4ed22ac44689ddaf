"""Effects of the stage `inertia`: masses, centres of mass, added masses."""

import numpy as np

from fishmj.effects.effect import Confusion, Effect, Parameter, RobotForm


def body_mass_fish(xp, p, c):
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


def body_mass_fields(site, p):
    """m' = m + dm, inertia alike, the centre where it is."""
    m = site.m
    m.body_inertia[site.body] *= 1.0 + p.mass / m.body_mass[site.body]
    m.body_mass[site.body] += p.mass


BODY_MASS = Effect(
    name="body_mass",
    stage="inertia",
    about="water under the skin, spread over the links by their share, or a payload at the head's reference point",
    formula="m_i' = m_i (1 + k dm/m), head + (1 - k) dm",
    source="a flooded skin holds 0.05 to 0.3 kg",
    parameters=(
        Parameter(name="mass", unit="kg", low=-0.5, high=1.5, typical=(0.05, 0.3), of="mass"),
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
    fish=body_mass_fish,
    robot=RobotForm(
        site="body",
        scale="mass",
        parameters=(Parameter(name="mass", unit="kg", low=-0.9, high=5.0, typical=(0.1, 0.5)),),
        fields=body_mass_fields,
    ),
)


def com_offset_fish(xp, p, c):
    """s_0' = s_0 + x: the head link's centre of mass, which carries battery and electronics."""
    return c._replace(chain=c.chain._replace(com=(c.chain.com[0] + p.x, *c.chain.com[1:])))


def com_offset_fields(site, p):
    """Place of a body's centre of mass in the body's frame."""
    site.m.body_ipos[site.body] += p.x, p.y, p.z


COM_OFFSET = Effect(
    name="com_offset",
    stage="inertia",
    about="battery moved: the head link's centre of mass lies ahead (x > 0) or behind; yaw and sway couple",
    formula="s_head' = s_head + x (whole fish: x m_head/m)",
    source="battery of a quarter of the weight moved by 2 to 6 cm: 5 to 15 mm",
    parameters=(Parameter(name="x", unit="m", low=-0.1, high=0.1, typical=(0.008, 0.03), of="length"),),
    shows=("position", "heading"),
    native="body ipos",
    confusions=(
        Confusion("body_lift", "no speed needed: flap on the spot", ("impulse", "turn_left")),
        Confusion("munk_moment", "no speed needed: flap on the spot", ("impulse", "tow_oblique")),
        Confusion("marker_offset", "the joints' commands move it", ("spin", "impulse")),
    ),
    fish=com_offset_fish,
    robot=RobotForm(
        site="body",
        scale="length",
        parameters=tuple(Parameter(name=n, unit="m", low=-1.0, high=1.0, typical=(0.03, 0.2)) for n in "xyz"),
        fields=com_offset_fields,
    ),
)


def link_inertia_fields(site, p):
    """All three principal inertias about the link's own centre of mass."""
    site.m.body_inertia[site.body] *= 1.0 + p.share


LINK_INERTIA = Effect(
    name="link_inertia",
    stage="inertia",
    about="the inertia of a link about its centre of mass, as from a drawing without screws and cables, is off",
    formula="I' = (1 + s) I",
    source="drawings against bifilar pendulums: 5 to 30 %",
    native="body inertial",
    robot=RobotForm(
        site="body",
        parameters=(Parameter(name="share", unit="1", low=-0.9, high=5.0, typical=(0.2, 1.0)),),
        fields=link_inertia_fields,
        confusions=(Confusion("rotor_inertia", "a rotor does not turn with the joints before it: move those alone"),),
    ),
)


def payload_fields(site, p):
    """The mass sits twice as far from the body's frame as the centre of mass; inertia by the parallel axes."""
    m, b = site.m, site.body
    apart = m.body_ipos[b].copy()
    own = m.body_mass[b]
    share = p.mass / (own + p.mass)
    m.body_inertia[b] += own * share * (apart @ apart - along_principal_axes(m, b, apart) ** 2)
    m.body_ipos[b] += share * apart
    m.body_mass[b] = own + p.mass


def along_principal_axes(m, b, place):
    """(3,) components of a vector of the body's frame along its principal axes."""
    w, x, y, z = m.body_iquat[b]
    axes = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(axes) @ place


PAYLOAD = Effect(
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
        fields=payload_fields,
        confusions=(Confusion("body_mass", "weigh the link, and balance it on an edge"),),
    ),
)


def surge_added_mass_body(xp, p, b, memory, h):
    """Kirchhoff with X = dm: on accelerations seen from the world, f = -dm (a_x + w r), -dm u r, +dm u w."""
    m = b.wet * p.mass
    return b._replace(mx=b.mx + m, fx=b.fx - m * b.w * b.r, fy=b.fy - m * b.u * b.r, n=b.n + m * b.u * b.w), memory


SURGE_ADDED_MASS = Effect(
    name="surge_added_mass",
    stage="inertia",
    about="water that is accelerated with the fish when it speeds up or slows down",
    formula="fx = -dm (du/dt), and Kirchhoff's terms fy = -dm u r, n = dm u w",
    source="slender body: 0.06 to 0.16 kg; flooded nose and fins add to it",
    parameters=(Parameter(name="mass", unit="kg", low=-0.3, high=2.0, typical=(0.06, 0.3), of="mass"),),
    shows=("position",),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion(
            "body_mass", "weigh it; a fast turn needs m u r, added mass in surge does not", ("burst_and_coast", "turn_left")
        ),
        Confusion("quadratic_drag", "speeding up against coasting", ("tow_ahead", "burst_and_coast")),
    ),
    body=surge_added_mass_body,
)


def sway_added_mass_body(xp, p, b, memory, h):
    """Kirchhoff with Y = dm: on accelerations seen from the world, f = dm w r, -dm (a_y - u r), -dm u w."""
    m = b.wet * p.mass
    return b._replace(my=b.my + m, fx=b.fx + m * b.w * b.r, fy=b.fy + m * b.u * b.r, n=b.n - m * b.u * b.w), memory


SWAY_ADDED_MASS = Effect(
    name="sway_added_mass",
    stage="inertia",
    about="water that is accelerated with the fish when it moves sideways; shallow water raises it",
    formula="fy = -dm (dw/dt), and Kirchhoff's terms fx = dm w r, n = -dm u w",
    source="strips of this hull: 2.2 kg; tens of per cent more in shallow water",
    parameters=(Parameter(name="mass", unit="kg", low=-0.8, high=5.0, typical=(0.2, 0.8), of="mass"),),
    shows=("position", "heading"),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion("munk_moment", "needs acceleration, not speed", ("impulse", "burst_and_coast")),
        Confusion("yaw_inertia", "side push without turning", ("tow_sideways", "impulse")),
        Confusion("crossflow_drag", "start of a side push against its end", ("tow_sideways", "turn_left")),
    ),
    body=sway_added_mass_body,
)


def yaw_added_mass_body(xp, p, b, memory, h):
    """n = -dI dr/dt; rotation alone has no velocity terms."""
    return b._replace(mn=b.mn + b.wet * p.inertia), memory


YAW_ADDED_MASS = Effect(
    name="yaw_added_mass",
    stage="inertia",
    about="water that is turned with the head: recoil and turns get slower, in water only",
    formula="n = -dI (dr/dt)",
    source="strips of this hull: about 0.05 kg m2; 10 to 30 % of it",
    parameters=(Parameter(name="inertia", unit="kg m2", low=-0.005, high=0.2, typical=(0.004, 0.02), of="inertia"),),
    shows=("heading",),
    native="body fluidcoef (ellipsoid model)",
    confusions=(
        Confusion("yaw_inertia", "not in air", ("impulse", "chirp")),
        Confusion("yaw_drag", "start of a turn against its end", ("twirl", "spin")),
    ),
    body=yaw_added_mass_body,
)


def yaw_inertia_fish(xp, p, c):
    """I_0' = I_0 + dI: the head link about its centre of mass; it carries two thirds of the mass."""
    return c._replace(chain=c.chain._replace(inertia=(c.chain.inertia[0] + p.inertia, *c.chain.inertia[1:])))


YAW_INERTIA = Effect(
    name="yaw_inertia",
    stage="inertia",
    about="mass sits further out in the head: recoil and turns get slower, in air as in water",
    formula="I_head' = I_head + dI",
    source="20 to 30 % of a fish of 1.1 kg and 0.54 m, whose total is 0.02 kg m2",
    parameters=(Parameter(name="inertia", unit="kg m2", low=-0.002, high=0.05, typical=(0.002, 0.008), of="inertia"),),
    shows=("heading", "joint"),
    native="body diaginertia",
    confusions=(
        Confusion("yaw_added_mass", "acts in air too", ("impulse", "chirp")),
        Confusion("sway_added_mass", "sway is the same", ("impulse", "turn_left")),
    ),
    fish=yaw_inertia_fish,
)
