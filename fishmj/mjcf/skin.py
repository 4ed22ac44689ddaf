"""One smooth skin over all links, for replays and for the markers of an immersed boundary.

The straight body is a stack of elliptical rings through the sections of every link. Each vertex belongs to its nearest
hinge h and turns about it by a share s of the hinge angle, so a bend is spread over a short zone and no volume is lost:

    p = H_h + R(phi_h + s j_h) (r - h_rest),   s = smoothstep(distance behind the hinge / zone)

H_h hinge in the world, phi_h heading of the link before it, r rest position. s = 0 and s = 1 are the rigid links.
A robot's replay (JavaScript) uses the same formula.
"""

from typing import NamedTuple

import numpy as np

from fishmj.mjcf.description import Fin, Robot
from fishmj.mjcf.drawing import colour_of, drawn_sections, fin_root, hull_faces, tube_faces
from fishmj.mjcf.geometry import Geometry, geometry_of

ZONE = 0.3  # half-length of the bend zone over the shorter adjacent link
EYE = 0.07  # radius over head height
BELLY = np.array([0.97, 0.96, 0.93])  # colour that undersides fade to


class Skin(NamedTuple):
    """V vertices and F triangles in the straight pose, body frame (x to the nose, origin at the reference point), m."""

    vertices: np.ndarray  # (V, 3)
    normals: np.ndarray  # (V, 3) outward, unit
    faces: np.ndarray  # (F, 3) int32, counter-clockwise from outside
    hinge: np.ndarray  # (V,) int32, index of the hinge the vertex hangs on
    share: np.ndarray  # (V,) share of that hinge's angle, 0..1
    colour: np.ndarray  # (V, 3) RGB, 0..1
    hinge_x: np.ndarray  # (N-1,) hinges along the straight body, m


def skin(robot: Robot, *, spacing: float = 0.005, around: int = 28, smooth: bool = False, details: bool = True) -> Skin:
    """Lofts the skin of `robot`.

    Args:
        spacing: distance between rings, m. around: points on a ring.
        smooth: draw a monotone cubic through the sections (prettier) instead of straight lines (used by the water).
        details: add side fins and eyes; without them the mesh is the closed hull alone.
    """
    g = geometry_of(robot)
    parts = [_hull(robot, g, spacing, around, smooth)]
    if details:
        parts += [_fin(robot, g, fin, side) for fin in robot.fins for side in (1.0, -1.0)[: fin.count]]
        parts += [_eye(robot, g, side) for side in (1.0, -1.0)]
    offsets = np.cumsum([0, *(len(p[0]) for p in parts)])
    vertices, normals, colour = (np.concatenate([p[i] for p in parts]) for i in (0, 1, 3))
    faces = np.concatenate([p[2] + o for p, o in zip(parts, offsets, strict=False)]).astype(np.int32)
    hinge_x = g.origin[1:].copy()
    anchor = np.concatenate([p[4] for p in parts])  # a plate or an eye bends as a whole: by its root
    hinge, share = bend(robot, hinge_x, anchor)
    return Skin(vertices, normals, faces, hinge, share, colour, hinge_x)


def posed(s: Skin, q) -> np.ndarray:
    """Vertices in the world, (.., V, 3) m, for q = (x, y, psi, j_1 ..) of shape (.., 2 + N)."""
    q = np.asarray(q, float)
    hinges, headings = hinge_frames(s.hinge_x, q)
    angle = headings[..., s.hinge] + s.share * q[..., 3 + s.hinge]
    c, sn = np.cos(angle), np.sin(angle)
    dx, dy = s.vertices[:, 0] - s.hinge_x[s.hinge], s.vertices[:, 1]
    x = hinges[..., s.hinge, 0] + c * dx - sn * dy
    y = hinges[..., s.hinge, 1] + sn * dx + c * dy
    return np.stack([x, y, np.broadcast_to(s.vertices[:, 2], x.shape)], axis=-1)


def hinge_frames(hinge_x: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World position (.., N-1, 2) of every hinge and heading (.., N-1) of the link before it."""
    headings = q[..., 2:3] + np.concatenate([np.zeros((*q.shape[:-1], 1)), np.cumsum(q[..., 3:-1], -1)], -1)
    reach = np.diff(hinge_x, prepend=0.0)  # from the reference point or the hinge before, along x; negative
    step = reach[:, None] * np.stack([np.cos(headings), np.sin(headings)], -1)
    return q[..., None, :2] + np.cumsum(step, axis=-2), headings


def bend(robot: Robot, hinge_x: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hinge and share of its angle for points at body station x."""
    hinge = np.argmin(np.abs(x[:, None] - hinge_x), axis=1)
    lengths = np.array([link.length for link in robot.links])
    zone = ZONE * np.minimum(lengths[:-1], lengths[1:])[hinge]
    u = np.clip((hinge_x[hinge] - x) / (2 * zone) + 0.5, 0.0, 1.0)
    return hinge.astype(np.int32), u * u * (3 - 2 * u)


def _profile(robot: Robot, scale: float, smooth: bool):
    """Functions of the station from the nose [m] -> half-height, half-width [m]."""
    fronts = np.cumsum([0.0, *(link.length for link in robot.links)])
    rows = np.concatenate([drawn_sections(robot, i) + [fronts[i], 0, 0] for i in range(len(robot.links))])
    keep = np.concatenate([[True], np.diff(rows[:, 0]) > 1e-9])  # links meet in one section
    s, h, w = rows[keep].T
    h, w = h / 2, np.maximum(w * scale / 2, 2e-4)
    if not smooth:
        return fronts, lambda x: (np.interp(x, s, h), np.interp(x, s, w))
    from scipy.interpolate import PchipInterpolator

    height, width = PchipInterpolator(s, h), PchipInterpolator(s, w)
    return fronts, lambda x: (height(x), width(x))


def _hull(robot: Robot, g: Geometry, spacing: float, around: int, smooth: bool):
    fronts, profile = _profile(robot, g.width_scale, smooth)
    stations, owners = [], []
    for i, link in enumerate(robot.links):  # seams get two rings, so that colours meet in a sharp line
        n = max(2, int(np.ceil(link.length / spacing)))
        inner = fronts[i] + np.linspace(0, link.length, n + 1)
        stations.append(np.union1d(inner, fronts[i] + drawn_sections(robot, i)[:, 0]))
        owners += [i] * len(stations[-1])
    s, owner = np.concatenate(stations), np.array(owners)
    half_h, half_w = profile(s)
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    c, sn = np.cos(turn), np.sin(turn)
    x = g.reference - s
    rings = np.stack([np.repeat(x[:, None], around, 1), half_w[:, None] * c, half_h[:, None] * sn], -1)
    eps = 1e-4  # m; slopes of the profile by central differences, one-sided at the ends
    lo, hi = np.clip(s - eps, 0, fronts[-1]), np.clip(s + eps, 0, fronts[-1])
    dh, dw = ((b - a) / (hi - lo) for a, b in zip(profile(lo), profile(hi), strict=True))
    across = np.stack([c * half_h[:, None], sn * half_w[:, None]], -1)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    slope = across[..., 0] * c * dw[:, None] + across[..., 1] * sn * dh[:, None]
    normals = np.concatenate([slope[..., None], across], -1).reshape(-1, 3)  # the hull widens towards the tail: nose-facing
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    vertices = np.concatenate([rings.reshape(-1, 3), [[x[0], 0, 0], [x[-1], 0, 0]]])
    normals = np.concatenate([normals, [[1, 0, 0], [-1, 0, 0]]])
    owner = np.concatenate([np.repeat(owner, around), [0, owner[-1]]])
    base = np.array([colour_of(robot, i) for i in range(len(robot.links))])[owner]
    return vertices, normals, hull_faces(len(s), around), _shaded(base, normals), vertices[:, 0]


def _shaded(base: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Colours with the countershading of fish: darker back, pale belly."""
    up = normals[:, 2:3]
    pale = 0.6 * np.clip((-up - 0.45) / 0.5, 0, 1)
    return np.clip((base * (1 - 0.22 * np.clip(up, 0, 1))) * (1 - pale) + BELLY * pale, 0, 1)


def _fin(robot: Robot, g: Geometry, fin: Fin, side: float):
    """A thin plate with a swept, rounded edge inside the rectangle station x span of the description."""
    index, root = fin_root(robot, g, fin)
    front_x = g.origin[index] + g.span[index, 1]
    middle = front_x - np.mean(fin.station)
    u, v = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 7), indexing="ij")
    lead = 0.65 * v**2.2  # leading edge sweeps back towards the tip
    chord = fin.station[1] - fin.station[0]
    x = front_x - fin.station[0] - chord * (lead + u * (1 - lead))
    y = side * (0.7 * root + v * (0.3 * root + fin.span))
    thick = 0.0025 * np.sqrt(np.clip(4 * u * (1 - u), 0, 1)) * (1 - 0.7 * v)
    top = np.stack([x, y, thick], -1).reshape(-1, 3)
    vertices = np.concatenate([top, top * [1, 1, -1]])
    a = (np.arange(8)[:, None] * 7 + np.arange(6)).ravel()
    quads = np.concatenate([np.stack([a, a + 7, a + 1], 1), np.stack([a + 1, a + 7, a + 8], 1)])
    down, up = (quads, quads[:, ::-1]) if side > 0 else (quads[:, ::-1], quads)
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(top), axis=0)
    colour = np.tile(0.62 * np.array(colour_of(robot, index)), (len(vertices), 1))
    return vertices, normals, np.concatenate([up, down + len(top)]), colour, np.full(len(vertices), middle)


def _eye(robot: Robot, g: Geometry, side: float):
    """A white ball with a dark pupil, above the middle of the head's front fifth."""
    link = robot.links[0]
    rows = np.array(link.sections)
    station = 0.19 * link.length
    h, w = np.interp(station, rows[:, 0], rows[:, 1]) / 2, np.interp(station, rows[:, 0], rows[:, 2]) * g.width_scale / 2
    radius = EYE * rows[:, 1].max()
    lift = 0.42  # sine of the angle round the section
    centre = np.array([g.reference - station, side * (w * np.sqrt(1 - lift**2) - 0.25 * radius), h * lift])
    out = np.array([0.35, side, 0.18]) / np.linalg.norm([0.35, 1, 0.18])
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 16, endpoint=False), indexing="ij")
    e1 = np.cross(out, [0, 0, 1.0])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(out, e1)
    ring = np.cos(turn)[..., None] * e1 + np.sin(turn)[..., None] * e2
    normals = (np.cos(polar)[..., None] * out + np.sin(polar)[..., None] * ring).reshape(-1, 3)
    colour = np.where((polar < 0.7).reshape(-1, 1), [[0.05, 0.05, 0.07]], [[0.96, 0.96, 0.96]])
    return centre + radius * normals, normals, tube_faces(13, 16), colour, np.full(normals.shape[0], centre[0])
