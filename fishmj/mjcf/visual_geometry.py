"""What a link looks like in MuJoCo: a lofted hull from its sections, side fins, named sites. Massless, collides with nothing."""

import mujoco
import numpy as np

from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of, drawn_sections
from fishmj.mjcf.geometry import Geometry
from fishmj.units import WATER_DENSITY, WATER_VISCOSITY

DYNAMIC_VISCOSITY = WATER_DENSITY * WATER_VISCOSITY  # Pa s
FIN_THICKNESS = 0.001  # m, drawn half-thickness
RING = 20  # points round a section
STEPS = 12  # rings along a link
HIDDEN = 4  # MuJoCo geom group that viewers leave out


def add_link(spec, body, robot: Robot, geometry: Geometry, i: int) -> None:
    """Hull mesh, fins and sites of link i on `body`."""
    link = robot.links[i]
    rear, front = geometry.span[i]
    vertices, faces = loft(robot, geometry, i)
    spec.add_mesh(
        name=f"{link.name}_hull",
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    shape = {"contype": 0, "conaffinity": 0, "mass": 0.0, "rgba": [*colour_of(robot, i), 1.0]}
    body.add_geom(name=link.name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{link.name}_hull", **shape)
    for fin in robot.fins:
        if fin.link == link.name:
            for (x, y, chord, span), side in zip(fin_plates(robot, geometry, fin), ("left", "right"), strict=False):
                size = [chord / 2, span / 2, FIN_THICKNESS]
                body.add_geom(name=f"{fin.name}_{side}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[x, y, 0], size=size, **shape)
    body.add_site(name=f"{link.name}_centre", pos=[(rear + front) / 2, 0, 0], size=[0.004] * 3)
    if i == 0:
        body.add_site(name="reference", pos=[0, 0, 0], size=[0.004] * 3)
        body.add_site(name="nose", pos=[front, 0, 0], size=[0.004] * 3)
    if i == geometry.n_links - 1:
        body.add_site(name="tail_tip", pos=[rear, 0, 0], size=[0.004] * 3)


def add_ellipsoid(body, geometry: Geometry, i: int) -> None:
    """A hidden ellipsoid of the link's length, mean height and mean width that MuJoCo's own fluid model acts on."""
    rear, front = geometry.span[i]
    length = front - rear
    semi = [length / 2, geometry.strip_w[i].sum() / length / 2, geometry.strip_h[i].sum() / length / 2]
    body.add_geom(
        name=f"{body.name}_fluid",
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        pos=[(rear + front) / 2, 0, 0],
        size=semi,
        contype=0,
        conaffinity=0,
        mass=0.0,
        group=HIDDEN,
        rgba=[0, 0, 0, 0],
        fluid_ellipsoid=1,
    )


def loft(robot: Robot, geometry: Geometry, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface through the elliptical sections of link i: vertices (V, 3) [m, link frame] and triangles (F, 3)."""
    rows = drawn_sections(robot, i)
    stations = np.union1d(np.linspace(0, robot.links[i].length, STEPS), rows[:, 0])
    half_h = np.interp(stations, rows[:, 0], rows[:, 1]) / 2
    half_w = np.maximum(np.interp(stations, rows[:, 0], rows[:, 2]) * geometry.width_scale / 2, 2e-4)  # visible from above
    turn = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    x = geometry.span[i, 1] - stations
    rings = np.stack([np.repeat(x[:, None], RING, 1), half_w[:, None] * np.cos(turn), half_h[:, None] * np.sin(turn)], axis=-1)
    n = len(stations)
    vertices = np.concatenate([rings.reshape(-1, 3), [[x[0], 0, 0], [x[-1], 0, 0]]])
    a = (np.arange(n - 1)[:, None] * RING + np.arange(RING)).ravel()
    b = (np.arange(n - 1)[:, None] * RING + (np.arange(RING) + 1) % RING).ravel()
    side = np.concatenate([np.stack([a, a + RING, b], 1), np.stack([b, a + RING, b + RING], 1)])
    k, following = np.arange(RING), (np.arange(RING) + 1) % RING
    last = (n - 1) * RING
    nose = np.stack([np.full(RING, n * RING), k, following], 1)
    tail = np.stack([np.full(RING, n * RING + 1), last + following, last + k], 1)
    return vertices, np.concatenate([side, nose, tail]).astype(np.int32)


def fin_plates(robot: Robot, geometry: Geometry, fin) -> list[tuple[float, float, float, float]]:
    """Plates of one fin as (x centre, y centre, chord, span), m, in the frame of the link that carries it."""
    index = [link.name for link in robot.links].index(fin.link)
    link = robot.links[index]
    front = geometry.span[index, 1]
    rows = np.array(link.sections)
    chord, station = fin.station[1] - fin.station[0], (fin.station[0] + fin.station[1]) / 2
    root = np.interp(station, rows[:, 0], rows[:, 2]) * geometry.width_scale / 2
    sides = (1.0, -1.0)[: fin.count]
    return [(front - station, side * (root + fin.span / 2), chord, fin.span) for side in sides]
