"""Generator `morison`: inertia and drag of each strip, momentum shed wherever the body narrows.

    inertia    a = c_a rho pi/4 h^2 per length across, nothing along    Morison et al. 1950, Petroleum Transactions AIME 189;
               ellipse moving across its height: Lamb 1932, art. 71; fins less by their span: / sqrt(1 + (h/c)^2), Brennen 1982
    cross-flow f_n = -1/2 rho C h V^2 g(a) sign(w),  g = b |sin a| + (1 - b) sin^2 a,  sin a = w/V         loading function of
               oblique cylinders with two terms, Casarella and Parsons 1970, Marine Technology Society Journal 4(4)
               C from a round to a flat section; a plate of finite span has 1.2 to 2, Hoerner 1965, ch. 3
    skin       f_t = -1/2 rho C_f F S |V| u on the wetted area of each link,  C_f = 0.075 / (log10 Re - 2)^2     ITTC 1957
               F = n (1 + 1.5 (d/l)^1.5 + 7 (d/l)^3) form factor of a streamlined body, Hoerner 1965, ch. 6; n: a beating body has
               a thinner boundary layer, 3 to 5 times the friction, Lighthill 1971, Proc. R. Soc. B 179
    shedding   where h falls towards the tail, a share s_b of -dm/dx leaves as a vortex sheet, at the last edge s_e of m_e:
               f_t = 1/2 m w^2,  f_n = -m u+ w      Lighthill 1970, J. Fluid Mech. 44; Wu 1971, J. Fluid Mech. 46

The water has no memory: no stall, no lag. Every term but the inertia dissipates energy in any state: the sheet because
(1/2 m w^2) u - m u w^2 <= 0 for u >= 0, and there is none for u < 0.
"""

from typing import NamedTuple

import numpy as np

from fishmj.base.units import WATER_VISCOSITY
from fishmj.gap.laboratory.generators.family import Coefficient, Family, RobotWater
from fishmj.gap.laboratory.generators.link_chain import finish, move
from fishmj.gap.laboratory.generators.outline import fin_of, is_fin, ragged, stations_of, swaying
from fishmj.gap.laboratory.generators.water_compiler import entry, inlined
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of

SLOWEST = 1.2e4  # least Reynolds number of the friction line, a ship correlation

COEFFICIENTS = {
    "inertia_body": Coefficient(0.95, 0.08, "1", "ellipse 1 (Lamb 1932), a little less at a finite length"),
    "inertia_fin": Coefficient(0.90, 0.10, "1", "of the plate's value for its span (Brennen 1982)"),
    "cross_round": Coefficient(0.90, 0.12, "1", "short cylinders 0.7 to 1.2 (Hoerner 1965)"),
    "cross_flat": Coefficient(1.55, 0.12, "1", "square plate 1.2, long plate 2.0 (Hoerner 1965)"),
    "oblique": Coefficient(0.15, 0.30, "1", "share of the linear term (Casarella and Parsons 1970 have 0 to 0.3)"),
    "swimming": Coefficient(5.0, 0.12, "1", "friction of a beating body over a towed one: 3 to 5 (Lighthill 1971)"),
    "shed_body": Coefficient(0.15, 0.25, "1", "chosen: part of the peduncle's sheet that does not reattach"),
    "shed_edge": Coefficient(0.35, 0.12, "1", "1 for a slender body (Lighthill 1970), less for a fin as high as long"),
}


class MorisonLaw(NamedTuple):
    """Stations of all links in sequence, `begin` (N + 1,) index of each link's first."""

    begin: np.ndarray
    x: np.ndarray  # (S,) m
    drag: np.ndarray  # (S,) 1/2 rho C h ds, N s2/m2
    shed: np.ndarray  # (S,) kg/m
    skin: np.ndarray  # (N,) 1/2 rho F S, N s2/m2
    centre: np.ndarray  # (N,) m
    oblique: float
    length: float  # m, of the Reynolds number
    edge: float  # x of the trailing edge, m
    edge_mass: float  # kg/m


def build(robot: Robot, values) -> RobotWater:
    """Builds the water of one robot."""
    geometry, rho = geometry_of(robot), robot.density_water
    stations = stations_of(robot, geometry)
    fin = fin_of(robot, stations)
    plate = values["inertia_fin"] / np.sqrt(1.0 + (fin.span / fin.chord) ** 2)
    per_length, drag, shed = [], [], []
    for i, s in enumerate(stations):
        on_fin = is_fin(stations, fin, i)
        share = np.where(on_fin, plate, values["inertia_body"])
        per_length.append(share * rho * np.pi / 4 * s.height**2)
        c = values["cross_round"] + (values["cross_flat"] - values["cross_round"]) * s.flatness
        drag.append(0.5 * rho * c * s.height * s.ds)
        shed.append(np.where(on_fin, 0.0, values["shed_body"]) * rho * np.pi / 4 * s.narrowing * s.ds)
    slender = np.sqrt(geometry.frontal * 4 / np.pi) / robot.length
    form = values["swimming"] * (1.0 + 1.5 * slender**1.5 + 7.0 * slender**3)
    x, begin = ragged([s.x for s in stations])
    law = MorisonLaw(
        begin=begin,
        x=x,
        drag=ragged(drag)[0],
        shed=ragged(shed)[0],
        skin=np.array([0.5 * rho * form * np.sum(s.girth * s.ds) for s in stations]),
        centre=geometry.span.mean(1),
        oblique=values["oblique"],
        length=robot.length,
        edge=geometry.tail_x,
        edge_mass=values["shed_edge"] * rho * np.pi / 4 * fin.edge**2,
    )
    return RobotWater(swaying(stations, per_length), law, 0)


@inlined
def sheet(mass, x, u, w, force):
    """Adds the force of the mass per length that is shed at x."""
    if u > 0.0:
        force[0] += 0.5 * mass * w * w
        force[1] -= mass * u * w
        force[2] -= mass * u * w * x


@inlined
def forces(law, motion, memory, h, force):
    """Writes force (N, 3): all terms but inertia. No memory."""
    n = law.skin.shape[0]
    for i in range(n):
        u, v, r, f = motion[i, 0], motion[i, 1], motion[i, 2], force[i]
        f[:] = 0.0
        for k in range(law.begin[i], law.begin[i + 1]):
            x = law.x[k]
            w = v + r * x
            speed = np.sqrt(u * u + w * w)
            normal = -law.drag[k] * w * (law.oblique * speed + (1.0 - law.oblique) * abs(w))
            f[1] += normal
            f[2] += normal * x
            if law.shed[k] > 0.0:
                sheet(law.shed[k], x, u, w, f)
        w = v + r * law.centre[i]
        speed = np.sqrt(u * u + w * w)
        line = np.log10(max(speed * law.length / WATER_VISCOSITY, SLOWEST)) - 2.0
        f[0] -= law.skin[i] * 0.075 / (line * line) * speed * u
    last = motion[n - 1]
    sheet(law.edge_mass, law.edge, last[0], last[1] + last[2] * law.edge, force[n - 1])


@entry
def step(chain, law, q, rate, flow, extra, tether, memory, h, generalised, sparse, work):
    """Evaluates the water once; see `family.Family`."""
    move(chain, q, rate, flow, work)
    forces(law, work.motion, memory, h, work.force)
    finish(chain, extra, tether, work, generalised, sparse)


FAMILY = Family("morison", "Morison strips; momentum shed wherever the body narrows", COEFFICIENTS, build, step)
