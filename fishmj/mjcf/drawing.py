"""Shapes for drawing links: colours, a round nose, the hull through the sections of a link, its fins.

Only pictures have the round nose: water, mass and inertia keep the described sections. The plates of a fin are those that the
water acts on.
"""

import numpy as np

from fishmj.log.foxglove import Solid
from fishmj.mjcf.description import Fin, Robot
from fishmj.mjcf.geometry import Geometry, geometry_of

PALETTE = (  # warm and dark ones, which stand out on blue water; neighbours differ in hue and in brightness
    (0.89, 0.35, 0.25),  # coral
    (0.96, 0.70, 0.22),  # amber
    (0.93, 0.88, 0.76),  # cream
    (0.56, 0.71, 0.35),  # sage
    (0.45, 0.27, 0.53),  # plum
    (0.14, 0.22, 0.42),  # navy
    (0.90, 0.52, 0.60),  # rose
    (0.27, 0.30, 0.34),  # slate
)
BLUNT = 0.25  # height of the first section over the head's, from which a nose is a wall
NOSE = np.linspace(0.15, np.pi / 2, 7)  # rad, where a nose has its rings; the first is small, not a point: it has a normal
RING = 20  # points round a section
STEPS = 12  # rings along a link


def colour_of(robot: Robot, i: int) -> tuple[float, float, float]:
    """RGB (0..1) of link i: its own, or the palette's by its place in the fish."""
    own = robot.links[i].colour
    return PALETTE[i % len(PALETTE)] if own is None else own


def drawn_sections(robot: Robot, i: int) -> np.ndarray:
    """The rows (S, 3) of link i's sections [m] for pictures: the head's front end is rounded off.

    A first section is a flat wall, h0 high. If it is higher than a quarter of the head, it becomes half an ellipsoid inside the
    described length. The ellipsoid is r = h0 / 2 deep (at most a quarter of the link), and as high and wide as the link is at r.
    Its rings stand at r (1 - cos a) and have sin a of that size.
    """
    link = robot.links[i]
    rows = np.array(link.sections, float)
    depth = min(rows[0, 1:].max() / 2, link.length / 4)
    if i or depth <= 0 or rows[0, 1] < BLUNT * rows[:, 1].max():
        return rows
    behind = rows[rows[:, 0] > depth * (1 + 1e-9)]
    full = np.array([np.interp(depth, rows[:, 0], rows[:, k]) for k in (1, 2)])
    stations = np.r_[0.0, depth * (1 - np.cos(NOSE[1:]))]
    return np.concatenate([np.column_stack([stations, np.sin(NOSE)[:, None] * full]), behind])


def loft(robot: Robot, geometry: Geometry, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface through the elliptical sections of link i: vertices (V, 3) [m, link frame] and triangles (F, 3)."""
    rows = drawn_sections(robot, i)
    stations = np.union1d(np.linspace(0, robot.links[i].length, STEPS), rows[:, 0])
    half_h = np.interp(stations, rows[:, 0], rows[:, 1]) / 2
    half_w = np.maximum(np.interp(stations, rows[:, 0], rows[:, 2]) * geometry.width_scale / 2, 2e-4)  # visible from above
    turn = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    x = geometry.span[i, 1] - stations
    rings = np.stack([np.repeat(x[:, None], RING, 1), half_w[:, None] * np.cos(turn), half_h[:, None] * np.sin(turn)], axis=-1)
    vertices = np.concatenate([rings.reshape(-1, 3), [[x[0], 0, 0], [x[-1], 0, 0]]])
    return vertices, hull_faces(len(stations), RING).astype(np.int32)


def tube_faces(n: int, around: int) -> np.ndarray:
    """Triangles (F, 3) between n rings of `around` points each, nose first; counter-clockwise from outside."""
    a = (np.arange(n - 1)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(n - 1)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    return np.concatenate([np.stack([a, a + around, b], 1), np.stack([b, a + around, b + around], 1)])


def hull_faces(n: int, around: int) -> np.ndarray:
    """Triangles (F, 3) of the closed hull of n rings; the centres of the first and last ring are the final vertices."""
    k, following, last = np.arange(around), (np.arange(around) + 1) % around, (n - 1) * around
    nose = np.stack([np.full(around, n * around), k, following], 1)
    tail = np.stack([np.full(around, n * around + 1), last + following, last + k], 1)
    return np.concatenate([tube_faces(n, around), nose, tail])


def fin_root(robot: Robot, geometry: Geometry, fin: Fin) -> tuple[int, float]:
    """Number of the link that carries a fin, and the link's half width at the middle of the fin, m."""
    index = [link.name for link in robot.links].index(fin.link)
    rows = np.array(robot.links[index].sections)
    return index, float(np.interp(np.mean(fin.station), rows[:, 0], rows[:, 2]) * geometry.width_scale / 2)


def fin_plates(robot: Robot, geometry: Geometry, fin: Fin) -> list[tuple[float, float, float, float]]:
    """Plates of one fin as (x centre, y centre, chord, span), m, in the frame of the link that carries it."""
    index, root = fin_root(robot, geometry, fin)
    front = geometry.span[index, 1]
    chord, station = fin.station[1] - fin.station[0], (fin.station[0] + fin.station[1]) / 2
    sides = (1.0, -1.0)[: fin.count]
    return [(front - station, side * (root + fin.span / 2), chord, fin.span) for side in sides]


def solids(robot: Robot) -> tuple[Solid, ...]:
    """Links for a viewer, nose first: the same hulls and fin plates as in the robot's MuJoCo model."""
    g, out = geometry_of(robot), []
    for i, (link, front) in enumerate(zip(robot.links, [g.reference, *g.origin[1:]], strict=True)):
        plates = [plate for fin in robot.fins if fin.link == link.name for plate in fin_plates(robot, g, fin)]
        out.append(Solid(link.name, float(front), *loft(robot, g, i), tuple(plates), colour_of(robot, i)))
    return tuple(out)
