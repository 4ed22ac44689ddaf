"""Hydrodynamic strip forces on one link, as a sum of pure terms.

Link frame: t along the link towards the nose, n to its left. At a point x along the link, relative to the local water,
    u = t.(v - U)            the same all along the link                                  [m/s]
    w(x) = w0 + Omega x      w0 = n.(v - U) at the link's origin, Omega = yaw rate         [m/s, rad/s]

reactive     f_n = -mu (n.a - Omega u),  f_t = s mu w Omega,  c_z = -s mu w u    Lighthill 1971; Candelier et al. 2011,
             doi 10.1017/S002211201000649X; mu = k rho pi/4 h^2 per length. The part with n.a is the added mass.
             s = 1 on the head, whose nose is closed. The other links have no leading edge: s is the share that they recover
             of the leading-edge suction of a free link (Polhamus 1966, NASA TN D-3767). The two terms with s do no work
             together.
cross-flow   f_n = -1/2 rho Cn h |w| w                                        Taylor 1952, doi 10.1098/rspa.1952.0159
             on the last link (1 - h x) Cn, because attached flow does not separate (h = 0 by default)
friction     f_t = -1/2 rho Cf P sqrt(u^2 + w^2) u                            P = perimeter
head form    F_t = -1/2 rho Ca A |u| u,  Ca differs forwards and backwards
linear       F_t = -c_i u, by wetted area                                     laminar, or the Reynolds number's part of Cf
trailing     F_t = 1/2 x m_e w_e^2,  F_n = -(a + b x) m_e max(u, 0) w_e,       m_e = k_e rho pi/4 h_e^2
edge         passive for 0 <= x <= 1 if a + b x >= x / 2; w_e is evaluated at x_e: the trailing edge of a slender body
             (Lighthill), the quarter chord of a wing
attachment   x' = (x0(alpha) - x) V / (tau h_e),  x0 = logistic((alpha_s - |alpha|) / Delta)   Goman & Khrabrov 1994

Every function takes components (scalars, NumPy or JAX arrays of one shape, or traced values) and the array namespace
`xp`; none writes in place. SI units. Forces act on the link; moments are about the link's origin.
"""

from math import pi
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.mjcf.description import LIFT_ROUNDED
from fishmj.mjcf.geometry import Geometry

SHAPE = {"edge_place": 1.0, "tail_held": 0.0, "linear_drag": 0.0}  # optional keys of `[water]` for `Strips`, with defaults
NO_COEFFICIENT = ("model", "stations", "own", *SHAPE)  # keys of a `[water]` table that are no coefficients
SMOOTH = 1e-8  # m2/s2 inside square roots, keeps gradients finite at rest


class Coefficients(NamedTuple):
    """Parameters of the strip model. Lists have one entry for each link; entries may be arrays (a batch of fish)."""

    k: Any  # [N] added mass over rho pi/4 h^2
    cn: Any  # [N] cross-flow drag
    cf: Any  # tangential friction
    ca_forward: Any  # head form drag, swimming forwards
    ca_backward: Any  # and backwards
    ke: Any  # trailing-edge momentum flux
    lift_a: Any
    lift_b: Any
    stall_angle: Any  # rad
    stall_width: Any  # rad
    stall_lag: Any  # trailing-edge heights
    suction: Any = 1.0  # share of the leading-edge suction that the links behind the head recover
    residual: Any = 1.0  # factor on the learnt residual


class Strips(NamedTuple):
    """Constant geometry of the water model, plain floats, for N links with K strips each."""

    rho: float
    mu: tuple  # N x 3 moments of rho pi/4 h^2 ds
    displaced: tuple  # N, kg
    buoyancy: tuple  # N, m
    x: tuple  # N x K, m
    h: tuple  # N x K, m2
    p: tuple  # N x K, m2
    frontal: float  # m2
    tail_x: float
    tail_h: float
    edge_x: Any  # m, position x_e on the last link at which w_e is evaluated
    held: Any = None  # h, share of the last link's cross-flow drag that vanishes in attached flow; None for 0
    linear: Any = None  # N entries, linear drag coefficient c_i along each link, N s/m; None for 0


def coefficients(water: dict, n_links: int) -> Coefficients:
    """Reads a `[water]` table. Raises ConfigError if it is incomplete or not passive."""
    table = {key: value for key, value in water.items() if key not in NO_COEFFICIENT}
    for key in ("stall_angle", "stall_width"):
        if f"{key}_deg" in table:
            table[key] = float(np.radians(table.pop(f"{key}_deg")))
    missing = set(Coefficients._fields) - set(table) - set(Coefficients._field_defaults)
    unknown = set(table) - set(Coefficients._fields)
    if missing or unknown:
        needs = ", ".join(Coefficients._fields)
        raise ConfigError(f"[water]: missing {sorted(missing)}, unknown {sorted(unknown)}; needs {needs}")
    for key in ("k", "cn"):
        if len(table[key]) != n_links:
            raise ConfigError(f"[water] {key}: expected one value for each of {n_links} links, got {len(table[key])}")
        table[key] = [float(v) for v in table[key]]
    c = Coefficients(**table)
    if not 0.0 <= c.residual <= 2.0:
        raise ConfigError(f"[water]: residual = {c.residual}; expected a factor from 0 to 2, 1 as fitted")
    if not 0.0 <= c.suction <= 1.0:
        raise ConfigError(f"[water]: suction = {c.suction}; expected a recovered share from 0 to 1")
    if c.lift_a < 0 or c.lift_b < 0 or c.lift_a + c.lift_b < 0.5 - LIFT_ROUNDED:
        raise ConfigError(
            f"[water]: lift_a = {c.lift_a}, lift_b = {c.lift_b} can add energy; expected both >= 0 and lift_a + lift_b >= 0.5"
        )
    return c


def strips(geometry: Geometry, rho: float = 1000.0, water: dict | None = None) -> Strips:
    """Constant part of the water model as plain floats. water: the `[water]` table, for its `edge_place` and similar keys."""
    table = SHAPE | {key: number for key, number in (water or {}).items() if number is not None}
    rows = lambda a: tuple(tuple(float(v) for v in row) for row in a)
    line = lambda a: tuple(float(v) for v in a)
    return Strips(
        rho=rho,
        mu=rows(geometry.mu),
        displaced=line(geometry.displaced),
        buoyancy=line(geometry.buoyancy),
        x=rows(geometry.strip_x),
        h=rows(geometry.strip_h),
        p=rows(geometry.strip_p),
        frontal=geometry.frontal,
        tail_x=geometry.tail_x,
        tail_h=geometry.tail_h,
        edge_x=geometry.tail_x * float(table["edge_place"]),
        held=float(table["tail_held"]) or None,
        linear=linear_parts(geometry.strip_p, float(table["linear_drag"])) if table["linear_drag"] else None,
    )


def linear_parts(wetted, whole) -> tuple:
    """Linear drag coefficients of N links, N s/m: `whole`, which may be traced, divided by wetted area (N, K)."""
    areas = [float(np.sum(row)) for row in wetted]
    return tuple(whole * (area / sum(areas)) for area in areas)


def reactive(s: Strips, c: Coefficients, i: int, u, w0, omega, rate=None):
    """Velocity-dependent part of the added-mass force on link i: (F_t, F_n, moment).

    rate: yaw rate of the link in the world, if omega is relative to turning water; default omega.
    """
    rate = omega if rate is None else rate
    m0, m1 = c.k[i] * s.mu[i][0], c.k[i] * s.mu[i][1]
    suction = c.suction if i else 1.0
    momentum = suction * (m0 * w0 + m1 * omega)
    return rate * momentum, m0 * rate * u, m1 * rate * u - u * momentum


def resistive(xp, s: Strips, c: Coefficients, i: int, u, w0, omega):
    """Cross-flow drag and tangential friction, summed over the strips of link i."""
    force_t = force_n = moment = 0.0
    for x, h, p in zip(s.x[i], s.h[i], s.p[i], strict=True):
        w = w0 + omega * x
        normal = -(0.5 * s.rho * h) * c.cn[i] * xp.abs(w) * w
        force_t = force_t - (0.5 * s.rho * p) * xp.sqrt(u * u + w * w + SMOOTH)
        force_n = force_n + normal
        moment = moment + x * normal
    along = force_t * c.cf * u
    if s.linear is not None:
        along = along - s.linear[i] * u
    return along, force_n, moment


def with_held_tail(s: Strips, c: Coefficients, attached) -> Coefficients:
    """Coefficients while the tail's flow is attached: attached flow has no cross-flow drag, (1 - h x) C_n."""
    if s.held is None:
        return c
    return c._replace(cn=[*c.cn[:-1], (1.0 - s.held * attached) * c.cn[-1]])


def head_form(xp, s: Strips, c: Coefficients, u):
    """Form drag of the bluff head, along t."""
    return -(0.5 * s.rho * s.frontal) * xp.where(u > 0, c.ca_forward, c.ca_backward) * xp.abs(u) * u


def trailing_edge(xp, s: Strips, c: Coefficients, u, w0, omega, attached):
    """Momentum shed at the trailing edge of the last link: (F_t, F_n, moment)."""
    w = w0 + omega * s.edge_x
    me = c.ke * (s.rho * pi / 4 * s.tail_h**2)
    force_n = -(c.lift_a + c.lift_b * attached) * me * xp.maximum(u, 0.0) * w
    return 0.5 * attached * me * w * w, force_n, s.edge_x * force_n


def attachment(xp, s: Strips, c: Coefficients, u, w0, omega, attached, dt):
    """Advances the attachment state x of the tail by dt, exactly for frozen flow. Stays in [0, 1]."""
    w = w0 + omega * s.edge_x
    speed = xp.sqrt(u * u + w * w + SMOOTH)
    alpha = xp.arctan2(xp.sqrt(w * w + SMOOTH), u)
    target = 1.0 / (1.0 + xp.exp((alpha - c.stall_angle) / c.stall_width))
    return target + (attached - target) * xp.exp(-dt * speed / (c.stall_lag * s.tail_h))


def ambient(s: Strips, c: Coefficients, i: int, du_t, du_n):
    """Force of an ambient acceleration DU/Dt on link i: Froude-Krylov force plus added mass (Auton et al. 1988)."""
    m0, m1 = c.k[i] * s.mu[i][0], c.k[i] * s.mu[i][1]
    d = s.displaced[i]
    return d * du_t, (d + m0) * du_n, (d * s.buoyancy[i] + m1) * du_n


def link_forces(xp, s: Strips, c: Coefficients, i: int, u, w0, omega, du_t, du_n, attached, rate=None):
    """All forces on link i except those proportional to the body's own acceleration: (F_t, F_n, moment)."""
    # the body's own acceleration is left out, because its factor, the added mass, is in the caller's matrix. The stream's
    # acceleration is known in advance, so it gives a force
    if i == len(s.mu) - 1:
        c = with_held_tail(s, c, attached)
    parts = [reactive(s, c, i, u, w0, omega, rate), resistive(xp, s, c, i, u, w0, omega), ambient(s, c, i, du_t, du_n)]
    if i == 0:
        # only the head has a blunt front with a wake
        parts.append((head_form(xp, s, c, u), 0.0, 0.0))
    if i == len(s.mu) - 1:
        # momentum is shed only at the last edge, because the body continues between links (Lighthill 1971)
        parts.append(trailing_edge(xp, s, c, u, w0, omega, attached))
    return tuple(sum(column) for column in zip(*parts, strict=True))
