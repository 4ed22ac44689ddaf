"""Generator `ellipsoid`: added mass of one ellipsoid, quadratic damping of each link, and a lifting tail fin.

    inertia    hull of semi-axes a, b (height), c (width): k_1 = a0 / (2 - a0) along, k_2 = g0 / (2 - g0) across,
               J = 4/15 pi rho a b c (a^2 - c^2)^2 (g0 - a0) / (2 (a^2 - c^2) + (a^2 + c^2) (a0 - g0)),
               a0 = a b c int_0^inf ds / ((a^2 + s) D),  D = sqrt((a^2 + s)(b^2 + s)(c^2 + s)), g0 with c^2   Lamb 1932, art. 114
               cut into the links' stretches: across k_2 rho pi b c (1 - x^2/a^2) per length, along and J by the same shares.
               Kirchhoff's terms make the Munk moment (m_y - m_x) u v; fin: rho pi/4 h^2 c / sqrt(1 + (h/c)^2), Brennen 1982
    damping    each link at its middle: f_t = -(X + X_q |u|) u,  f_n = -Y |w| w - Y_l |u| w,  moment -N |r| r
               second-order modulus of underwater vehicles: Fossen 1994, ch. 2; Prestero 2001 (MIT); shares by side area
               Y_l: vortex lift of a slender hull at the base of the head, Hoerner and Borst 1975, ch. 19
    fin        thin foil of finite span, a plate at large angles:  C_L = C_La g sin a p + C_90 (1 - g) sin a cos a,
               C_D = C_0 + (C_La g sin a p)^2 / (pi e A) + C_90 (1 - g) sin^2 a,
               C_La = 2 pi A / (A + 2), Prandtl 1921,  g = q^4 / (q^4 + sin^4 a),
               p = (1 + u / sqrt(u^2 + (w / 3)^2)) / 2 is 1 ahead, 0 astern, where the trailing edge leads (chosen form);
               velocity and force at the quarter chord, lift along (V x t) x V
               Mason and Burdick 2000, ISER VI; Harper, Berkemeier and Grace 1998, IEEE J. Oceanic Eng. 23

The water has no memory. Lift is at a right angle to the quarter chord's motion and does no work; other terms dissipate energy.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.laboratory.generators.family import Coefficient, Family, RobotWater
from fishmj.gap.laboratory.generators.link_chain import finish, move
from fishmj.gap.laboratory.generators.outline import fin_of, is_fin, stations_of
from fishmj.gap.laboratory.generators.water_compiler import entry, inlined
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of

NODES = 200  # of Lamb's integrals
OSWALD = 0.8  # e, planform

COEFFICIENTS = {
    "along": Coefficient(1.10, 0.10, "1", "of the ellipsoid's k_1; mounts and gaps carry a little more (chosen)"),
    "across": Coefficient(1.00, 0.07, "1", "of the ellipsoid's k_2"),
    "turning": Coefficient(1.00, 0.10, "1", "of the ellipsoid's J"),
    "fin_mass": Coefficient(0.95, 0.10, "1", "of the plate's"),
    "laminar": Coefficient(0.06, 0.20, "N s/m", "small vehicles have a linear term (Fossen 1994); chosen"),
    "form": Coefficient(0.25, 0.12, "1", "drag on the frontal area, bluff-nosed bodies 0.2 to 0.5 (Hoerner 1965)"),
    "side": Coefficient(1.15, 0.12, "1", "broadside on the side area 1.0 to 1.3 (Hoerner 1965)"),
    "spin": Coefficient(1.40, 0.15, "1", "turning on side area times length cubed over 64; chosen"),
    "lift_hull": Coefficient(
        0.35, 0.20, "1", "on the head's frontal area, slender hulls 0.2 to 1 per rad (Hoerner and Borst 1975)"
    ),
    "lift_fin": Coefficient(0.95, 0.08, "1", "of the finite wing's slope"),
    "stall": Coefficient(0.85, 0.06, "1", "q, sine of the angle at which half of the lift is lost; low aspect ratios stall late"),
    "broad_fin": Coefficient(1.60, 0.12, "1", "plate broadside 1.2 to 2 (Hoerner 1965)"),
}
FRICTION_FIN = 0.02  # C_0


class EllipsoidLaw(NamedTuple):
    """Damping of the links at their middles, (N,), and the fin."""

    x: np.ndarray  # m
    laminar: np.ndarray  # N s/m
    form: np.ndarray  # N s2/m2
    side: np.ndarray  # N s2/m2
    spin: np.ndarray  # N m s2
    lift: np.ndarray  # N s2/m2
    base: float  # x on the head where its lift acts, m
    fin: float  # 1/2 rho S, N s2/m2
    quarter: float  # m
    slope: float
    induced: float
    stall: float
    broad: float


def lamb(a: float, b: float, c: float) -> tuple[float, float]:
    """(a0, g0) of an ellipsoid's semi-axes, along a and along c, by Gauss points in s = c^2 ((1 + t) / (1 - t))^2."""
    t, weight = np.polynomial.legendre.leggauss(NODES)
    ratio = (1.0 + t) / (1.0 - t)
    s, ds = c * c * ratio**2, weight * c * c * 2.0 * ratio * 2.0 / (1.0 - t) ** 2
    root = np.sqrt((a * a + s) * (b * b + s) * (c * c + s))
    return float(a * b * c * np.sum(ds / ((a * a + s) * root))), float(a * b * c * np.sum(ds / ((c * c + s) * root)))


def hull(a: float, b: float, c: float, rho: float) -> tuple[float, float, float]:
    """Added mass along and across [kg] and added inertia in yaw [kg m2] of an ellipsoid, semi-axes a > c, b upright, m."""
    a0, g0 = lamb(a, b, c)
    mass = 4.0 / 3.0 * np.pi * rho * a * b * c
    gap = a * a - c * c
    turning = mass / 5.0 * gap**2 * (g0 - a0) / (2.0 * gap + (a * a + c * c) * (a0 - g0))
    return mass * a0 / (2.0 - a0), mass * g0 / (2.0 - g0), float(turning)


def build(robot: Robot, values) -> RobotWater:
    """Builds the water of one robot."""
    geometry, rho, n = geometry_of(robot), robot.density_water, len(robot.links)
    stations = stations_of(robot, geometry)
    fin = fin_of(robot, stations)
    solid = [~is_fin(stations, fin, i) for i in range(n)]
    nose, end = float(geometry.span[0, 1]), float(geometry.origin[-1] + fin.front)  # of the straight fish
    middle, a = (nose + end) / 2, (nose - end) / 2
    volume = sum(float(np.sum((np.pi / 4 * s.height * s.width * s.ds)[keep])) for s, keep in zip(stations, solid, strict=True))
    b = max(float(s.height[keep].max()) for s, keep in zip(stations, solid, strict=True) if keep.any()) / 2
    c = min(volume / (4.0 / 3.0 * np.pi * a * b), 0.99 * a)
    along, across, turning = (v * values[k] for v, k in zip(hull(a, b, c, rho), ("along", "across", "turning"), strict=True))
    added, side, spin = np.zeros((n, 3, 3)), np.zeros(n), np.zeros(n)
    weights, whole = [], 0.0
    for i, (s, keep) in enumerate(zip(stations, solid, strict=True)):
        place = geometry.origin[i] + s.x - middle  # in the ellipsoid
        share = np.where(keep, np.maximum(1.0 - (place / a) ** 2, 0.0), 0.0) * s.ds * 0.75 / a
        weights.append(share)
        moments = [float(np.sum(share * s.x**k)) for k in range(3)]
        added[i, 0, 0] = along * moments[0]
        added[i, 1, 1], added[i, 2, 2] = across * moments[0], across * moments[2]
        added[i, 1, 2] = added[i, 2, 1] = across * moments[1]
        whole += across * float(np.sum(share * place**2))
        area, length = float(np.sum((s.height * s.ds)[keep])), float(geometry.span[i, 1] - geometry.span[i, 0])
        side[i] = 0.5 * rho * values["side"] * area
        spin[i] = 0.5 * rho * values["spin"] * area * length**3 / 64
    for i, share in enumerate(weights):
        added[i, 2, 2] = max(added[i, 2, 2] + (turning - whole) * float(share.sum()), _least(added[i]))
    plate = values["fin_mass"] * rho * np.pi / 4 * fin.span**2 * fin.chord / np.sqrt(1.0 + (fin.span / fin.chord) ** 2)
    mid, chord = (fin.front + fin.rear) / 2, fin.front - fin.rear
    added[-1, 1, 1] += plate
    added[-1, 1, 2] += plate * mid
    added[-1, 2, 1] += plate * mid
    added[-1, 2, 2] += plate * (mid**2 + chord**2 / 16)
    head = np.zeros(n)
    head[0] = 1.0
    frontal = 0.5 * rho * geometry.frontal
    law = EllipsoidLaw(
        x=geometry.span.mean(1),
        laminar=values["laminar"] * head,
        form=values["form"] * frontal * head,
        side=side,
        spin=spin,
        lift=values["lift_hull"] * frontal * head,
        base=float(geometry.span[0, 0]),
        fin=0.5 * rho * fin.area,
        quarter=fin.front - 0.25 * chord,
        slope=values["lift_fin"] * 2.0 * np.pi * fin.aspect / (fin.aspect + 2.0),
        induced=1.0 / (np.pi * OSWALD * fin.aspect),
        stall=values["stall"],
        broad=values["broad_fin"],
    )
    return RobotWater(added, law, 0)


def _least(added: np.ndarray) -> float:
    """Least inertia that is consistent with a link's mass and first moment, kg m2."""
    return float(added[1, 2] ** 2 / added[1, 1]) if added[1, 1] > 0.0 else 0.0


@inlined
def forces(law, motion, memory, h, force):
    """Writes force (N, 3): all terms but inertia. No memory."""
    n = law.x.shape[0]
    for i in range(n):
        u, r, f = motion[i, 0], motion[i, 2], force[i]
        w = motion[i, 1] + r * law.x[i]
        f[0] = -(law.laminar[i] + law.form[i] * abs(u)) * u
        f[1] = -law.side[i] * abs(w) * w
        f[2] = f[1] * law.x[i] - law.spin[i] * abs(r) * r
        if law.lift[i] > 0.0:
            base = -law.lift[i] * abs(u) * (motion[i, 1] + r * law.base)
            f[1] += base
            f[2] += base * law.base
    last, f = motion[n - 1], force[n - 1]
    u, w = last[0], last[1] + last[2] * law.quarter
    speed = np.sqrt(u * u + w * w)
    if speed > 1e-9:
        sine = w / speed
        held = law.stall**4 / (sine * sine * sine * sine + law.stall**4)
        foil = law.slope * held * sine * (0.5 + 0.5 * u / np.sqrt(u * u + w * w / 9.0))
        lift = foil + law.broad * (1.0 - held) * sine * u / speed
        drag = FRICTION_FIN + foil * foil * law.induced + law.broad * (1.0 - held) * sine * sine
        along, across = law.fin * speed * (lift * w - drag * u), law.fin * speed * (-lift * u - drag * w)
        f[0] += along
        f[1] += across
        f[2] += across * law.quarter


@entry
def step(chain, law, q, rate, flow, extra, tether, memory, h, generalised, sparse, work):
    """Evaluates the water once; see `family.Family`."""
    move(chain, q, rate, flow, work)
    forces(law, work.motion, memory, h, work.force)
    finish(chain, extra, tether, work, generalised, sparse)


FAMILY = Family("ellipsoid", "one ellipsoid's added mass, quadratic damping, a lifting tail fin", COEFFICIENTS, build, step)
