"""Displaced volume, inertia, added-mass moments and strips of every link from its sections.

Elliptical section of height h(s) and width w(s) at station s:  A = pi/4 h w,
displaced volume V = integral A ds, lateral added mass per length mu = k rho pi/4 h^2 (slender body, Lighthill 1960).
Widths are scaled by one factor so that rho V = total mass: the fish is neutrally buoyant (docs/decisions/decisions.md).

Link frame: x towards the nose, y left, z up, origin at the link's front joint; for the head the origin is the
reference point, the centre of mass of the straight fish projected on the long axis.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from fishmj.mjcf.description import Robot

_FINE = 240  # quadrature points per link


@dataclass(frozen=True)
class Geometry:
    """All arrays are float64; N links, K strips a link; positions along the link's own x axis from its origin, m."""

    n_links: int
    origin: np.ndarray  # (N,) x of each link's origin in the straight fish, measured from the reference point, m
    span: np.ndarray  # (N, 2) rear and front end of each link along its x axis, m
    joint: np.ndarray  # (N-1,) x of the rear hinge of links 0..N-2 along their own x axis, m
    mass: np.ndarray  # (N,) kg
    com: np.ndarray  # (N, 3) centre of mass in the link frame, m
    inertia: np.ndarray  # (N, 3) about the centre of mass, link axes, kg m2
    displaced: np.ndarray  # (N,) mass of displaced water, kg
    buoyancy: np.ndarray  # (N,) x of the centre of buoyancy in the link frame, m
    mu: np.ndarray  # (N, 3) moments 0, 1, 2 of rho pi/4 h^2 ds, kg, kg m, kg m2
    mu_vertical: np.ndarray  # (N, 3) the same with the width in place of the height
    strip_x: np.ndarray  # (N, K) strip centres, m
    strip_h: np.ndarray  # (N, K) height times ds, m2
    strip_w: np.ndarray  # (N, K) width times ds, m2
    strip_p: np.ndarray  # (N, K) perimeter times ds, m2
    tail_x: float  # x of the trailing edge in the last link's frame, m
    tail_h: float  # its height, m
    frontal: float  # largest cross-section, m2
    reference: float  # reference point, measured from the nose, m
    width_scale: float  # factor on all section widths


def geometry_of(robot: Robot, stations: int | None = None) -> Geometry:
    """Integrates the sections of `robot`; `stations` strips a link (default: its water table, else 6)."""
    k = int(stations or robot.water.get("stations", 6))
    rho = robot.density_water
    n = len(robot.links)
    raw_volume = sum(_quadrature(link, _FINE)[2] @ _area(link, _FINE) for link in robot.links)
    scale = robot.mass / (rho * raw_volume)
    fronts = np.concatenate([[0.0], np.cumsum([link.length for link in robot.links])])[:-1]  # from the nose, backwards
    com_back = [_com_back(link) for link in robot.links]
    reference = float(sum(link.mass * (f + c) for link, f, c in zip(robot.links, fronts, com_back, strict=True)) / robot.mass)
    columns = (("mu", 3), ("mu_vertical", 3), ("strip_x", k), ("strip_h", k), ("strip_w", k), ("strip_p", k))
    made: dict[str, np.ndarray] = {name: np.zeros((n, m)) for name, m in (*columns, ("com", 3), ("inertia", 3), ("span", 2))}
    made |= {"mass": np.array([link.mass for link in robot.links]), "displaced": np.zeros(n), "buoyancy": np.zeros(n)}
    for i, link in enumerate(robot.links):
        lead = reference if i == 0 else 0.0  # the link's front end along its own x axis
        s, ds, weight = _quadrature(link, _FINE)
        h, w = _section(link, s, scale)
        area = pi / 4 * h * w
        x = lead - s
        made["displaced"][i] = rho * np.sum(area * weight)
        made["buoyancy"][i] = rho * np.sum(area * x * weight) / made["displaced"][i]
        for m in range(3):
            made["mu"][i, m] = np.sum(rho * pi / 4 * h**2 * x**m * weight)
            made["mu_vertical"][i, m] = np.sum(rho * pi / 4 * w**2 * x**m * weight)
        s, ds, weight = _quadrature(link, k)
        fine = np.linspace(-0.5, 0.5, 41)[None, :] * ds + s[:, None]  # strip averages, so that few strips keep the areas
        h, w = _section(link, fine, scale)
        made["strip_x"][i] = lead - s
        made["strip_h"][i], made["strip_w"][i] = h.mean(1) * ds, w.mean(1) * ds
        made["strip_p"][i] = _perimeter(h, w).mean(1) * ds
        made["span"][i] = lead - link.length, lead
        made["com"][i] = lead - com_back[i], *(link.com[1:] if link.com else (0.0, 0.0))
        made["inertia"][i] = _inertia(link, scale, lead)
    heights = [row[1] * row[2] for link in robot.links for row in link.sections]
    return Geometry(
        n_links=n,
        origin=np.concatenate([[0.0], reference - fronts[1:]]),
        joint=made["span"][:-1, 0].copy(),
        tail_x=float(made["span"][-1, 0]),
        tail_h=float(robot.links[-1].sections[-1][1]),
        frontal=float(pi / 4 * scale * max(heights)),
        reference=reference,
        width_scale=float(scale),
        **made,
    )


def link_centres(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Link centres (T, N, 2) m of planar states q (T, 3 + J) m, rad."""
    geometry = geometry_of(robot)
    x, y, heading = q[:, 0], q[:, 1], q[:, 2]
    centres = []
    for i in range(geometry.n_links):
        if i:
            back = geometry.joint[i - 1]
            x, y = x + back * np.cos(heading), y + back * np.sin(heading)
            heading = heading + q[:, 2 + i]
        mid = geometry.span[i].mean()
        centres.append(np.stack([x + mid * np.cos(heading), y + mid * np.sin(heading)], -1))
    return np.stack(centres, 1)


def _quadrature(link, n):
    """Midpoints (n,), step and weights (n,) along the link, measured from its front end."""
    ds = link.length / n
    return (np.arange(n) + 0.5) * ds, ds, np.full(n, ds)


def _section(link, s, scale):
    rows = np.array(link.sections)
    return np.interp(s, rows[:, 0], rows[:, 1]), np.interp(s, rows[:, 0], rows[:, 2]) * scale


def _area(link, n):
    h, w = _section(link, _quadrature(link, n)[0], 1.0)
    return pi / 4 * h * w


def _perimeter(h, w):
    """Ramanujan's first formula for the perimeter of an ellipse with axes h and w."""
    a, b = h / 2, w / 2
    return pi * (3 * (a + b) - np.sqrt((3 * a + b) * (a + 3 * b)))


def _com_back(link):
    if link.com is not None:
        return link.com[0]
    s, _, weight = _quadrature(link, _FINE)
    area = _area(link, _FINE)
    return float(np.sum(area * s * weight) / np.sum(area * weight))


def _inertia(link, scale, lead):
    """(Ixx, Iyy, Izz), kg m2, of mass distributed like the displaced volume and moved to the stated centre of mass."""
    s, _, weight = _quadrature(link, _FINE)
    h, w = _section(link, s, scale)
    share = link.mass * h * w * weight / np.sum(h * w * weight)
    x = lead - s
    centre = np.sum(share * x) / link.mass
    lengthwise = np.sum(share * (x - centre) ** 2)
    ixx = np.sum(share * (h**2 + w**2)) / 16
    return np.array([ixx, lengthwise + np.sum(share * h**2) / 16, lengthwise + np.sum(share * w**2) / 16])
