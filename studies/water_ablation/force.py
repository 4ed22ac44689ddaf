"""The ellipsoid fluid model of MuJoCo on a planar fish, term by term; equal to `qfrc_fluid` (tests/test_hydro_ablation.py).

One ellipsoid a link, semi-axes a (along t), b (along n), c (up), centre x_c on the link's axis; with respect to the water
    u, w = w0 + Omega x_c, Omega     velocity of the centre along t and n, yaw rate;  v = (u, w)

    blunt     F = -rho |v| A v                         A = projected area along v = pi sqrt(D / P),
    slender   F = -rho |v| (A_max - A) v               P = (bc u)^2 + (ca w)^2,  D = (bc)^4 u^2 + (ca)^4 w^2
    angular   M = -rho I_z |Omega| Omega               I_z = 8/15 pi c max(a, b)^4
    slender   M = -rho (I_max - I_z) |Omega| Omega     I_max = 8/15 pi mid max^4 of the semi-axes
    kutta     F = rho A cos(alpha) (norm x v) x v      norm = ((bc)^2 u, (ca)^2 w),  cos(alpha) = P / (|v| D)
    magnus    F = rho V Omega x v                      V = 4/3 pi a b c
    viscous   F = -3 pi mu d v,  M = -pi mu d^3 Omega  d = 2/3 (a + b + c); no coefficient
    added     F_t = m_n w Omega,  F_n = -m_t u Omega,  M = (m_t - m_n) u w                          Lamb's m_t, m_n, I
    inertia   F_t -= m_t u',  F_n -= m_n w',  M -= I Omega'           rates of the components; MuJoCo leaves this part out

Source: MuJoCo's documentation, "Fluid forces: ellipsoid model", and `mj_ellipsoidFluidModel`. Forces act at the centre; moments
here are about the link's origin. Components style, as in `terms`.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from fishmj.mjcf.description import Robot

TERMS = ("blunt", "slender", "angular", "kutta", "magnus")  # MuJoCo's fluidcoef, in its order
GROUPS = ("body", "tail")  # the tail has its own
TINY = 1e-30  # keeps a fish at rest finite
COLUMNS = slice(1, 6), slice(6, 9), slice(9, 12)  # of geom_fluid: fluidcoef, virtual mass, virtual inertia


class Ellipsoids(NamedTuple):
    """Constants of N links, plain floats, read from the compiled model."""

    rho: float  # kg/m3
    viscosity: float  # Pa s
    semi: tuple  # N x 3, m
    centre: tuple  # N, m along t from the link's origin
    added: tuple  # N x 3: m_t, m_n, kg, and I, kg m2, of Lamb
    coefficients: tuple  # 5, MuJoCo's defaults in the order of TERMS


def ellipsoids_of(robot: Robot) -> Ellipsoids:
    """Ellipsoids that MuJoCo makes of the robot; `Sim(water="ellipsoid")` swims in these."""
    from fishmj import mjcf

    model = mjcf.build(robot, bare=True, ellipsoid=True)
    coefficients, mass, inertia = (model.geom_fluid[:, part] for part in COLUMNS)
    rho = float(model.opt.density)
    line = lambda values: tuple(float(v) for v in values)
    return Ellipsoids(
        rho=rho,
        viscosity=float(model.opt.viscosity),
        semi=tuple(line(row) for row in model.geom_size),
        centre=line(model.geom_pos[:, 0]),
        added=tuple(line((rho * m[0], rho * m[1], rho * i[2])) for m, i in zip(mass, inertia, strict=True)),
        coefficients=line(coefficients[0]),
    )


def parts(xp, e: Ellipsoids, i: int, u, w0, omega) -> dict:
    """Force on link i for a unit of each coefficient, for the added mass's velocity part and for the terms without coefficient.

    Returns:
        (F_t, F_n, moment about the link's origin) by name: TERMS, "added", "viscous".
    """
    (a, b, c), rho = e.semi[i], e.rho
    w = w0 + omega * e.centre[i]
    zero, speed = 0.0 * (u + w), xp.sqrt(u * u + w * w)
    long, mid, short = sorted((a, b, c), reverse=True)
    square = (b * c) ** 2 * u * u + (c * a) ** 2 * w * w
    fourth = (b * c) ** 4 * u * u + (c * a) ** 4 * w * w
    area = pi * xp.sqrt(fourth / xp.maximum(square, TINY))
    rest = pi * long * mid - area
    spin = xp.abs(omega) * omega
    own, most = (8 / 15 * pi * part for part in (c * max(a, b) ** 4, mid * long**4))
    slant = square / xp.maximum(speed * fourth, TINY)
    bound = rho * slant * area * ((b * c) ** 2 - (c * a) ** 2) * u * w
    volume, width = 4 / 3 * pi * long * mid * short, 2 / 3 * (a + b + c)
    along, across, _ = e.added[i]
    drag = 3 * pi * e.viscosity * width
    central = {
        "blunt": (-rho * speed * area * u, -rho * speed * area * w, zero),
        "slender": (-rho * speed * rest * u, -rho * speed * rest * w, -rho * (most - own) * spin),
        "angular": (zero, zero, -rho * own * spin),
        "kutta": (-bound * w, bound * u, zero),
        "magnus": (-rho * volume * omega * w, rho * volume * omega * u, zero),
        "added": (across * w * omega, -along * u * omega, (along - across) * u * w),
        "viscous": (-drag * u, -drag * w, -pi * e.viscosity * width**3 * omega),
    }
    return {name: (ft, fn, moment + e.centre[i] * fn) for name, (ft, fn, moment) in central.items()}


def link_force(xp, e: Ellipsoids, i: int, u, w0, omega, flat):
    """Force (F_t, F_n, moment) on link i without that of the acceleration; `flat` as in `names_of`."""
    unit = parts(xp, e, i, u, w0, omega)
    own = coefficients_of(flat, i == len(e.semi) - 1)
    return tuple(unit["viscous"][c] + sum(value * unit[name][c] for name, value in own.items()) for c in range(3))


def names_of() -> tuple[str, ...]:
    """Names in flat order: five coefficients and the factor on the added mass, of the body and of the tail."""
    return tuple(f"{group}_{term}" for group in GROUPS for term in (*TERMS, "added"))


def coefficients_of(flat, tail: bool) -> dict:
    """The coefficients of one link by term."""
    size = len(TERMS) + 1
    return dict(zip((*TERMS, "added"), flat[size:] if tail else flat[:size], strict=True))


def default(e: Ellipsoids) -> np.ndarray:
    """MuJoCo's defaults, (12,)."""
    return np.array([*e.coefficients, 1.0] * len(GROUPS))
