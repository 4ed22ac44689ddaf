"""Shapes that a `Scene` puts into water: sphere, cylinder, section, plate, closed mesh of triangles, geoms of a MuJoCo model.

A mesh becomes markers in three steps: its vertices are drawn in so that every face moves by the kernel's offset; random points
fill the faces; Lloyd's iterations gather them into even patches of about one cell.

    V = sum_t a . (b x c) / 6,   int x dV and int x x^T dV alike      volume, centre and inertia from tetrahedra to the origin
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, pi, radians, sin
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.lbm_oracle.immersed.markers import FINS, Markers, Sharpness, offset_of, sphere_markers
from fishmj.lbm_oracle.immersed.silhouettes import Surface, frontal_area, thinnest
from fishmj.lbm_oracle.immersed.strip import circle_markers

POINTS, ROUNDS = 25, 10  # random points a marker, Lloyd's iterations: patches even to 15 %
# cells that markers are drawn in: a wall with water at rest behind it acts k' / 2 = 0.44 cells in front of them, half of what a
# sheet with moving water on both sides does (markers.py)
INSET = offset_of(3, slip=1.0)
MOST_DRAWN = 1.8  # insets by which a vertex moves at most: a box's corner needs 3^1/2
LOST = 0.05  # share of the points that may leave the shape when its faces are drawn in
SHOWN = 3  # groups of geoms that MuJoCo draws by default: 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """A rigid shape about its own origin.

    markers: of cells of dx m. size: m, of the Reynolds number. area: m2, of the coefficients. surface: for the frontal area and
    the picture; without it there is none. width: m, the thinnest that the stream sees; 0: `size`. volume: m3. centre: (3,) m.
    inertia: (3, 3) m5, moments of the volume about `centre`. flat: a section in the plane z = 0, whose area and volume are those
    of one metre of span.
    """

    name: str
    markers: Callable[[float], Markers]
    size: float
    area: float
    surface: Surface | None = None
    width: float = 0.0
    volume: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    flat: bool = False


def sphere(diameter: float) -> BodyShape:
    """A sphere of `diameter` m. Raises ConfigError unless it is positive."""
    d = float(numbers("sphere: diameter", diameter, low=1e-300))
    volume, area = pi * d**3 / 6, pi * d**2 / 4
    inertia = np.eye(3) * 0.1 * volume * d**2
    make, surface = lambda dx: sphere_markers(d / 2, dx, hydro_offset=INSET), _revolved(_arc() * d / 2)
    return BodyShape(name="sphere", markers=make, size=d, area=area, surface=surface, volume=volume, inertia=inertia)


def cylinder(diameter: float) -> BodyShape:
    """A circular cylinder of `diameter` m along z, in a box of two lengths. Raises ConfigError unless it is positive."""
    d = float(numbers("cylinder: diameter", diameter, low=1e-300))
    volume = pi * d**2 / 4
    inertia = np.diag([1.0, 1.0, 2.0]) * volume * d**2 / 16
    turn = np.linspace(0, 2 * pi, 64, endpoint=False)
    make = lambda dx: circle_markers(d / 2, dx, hydro_offset=INSET)
    surface = _ring(np.stack([np.cos(turn), np.sin(turn)], -1) * d / 2)
    return BodyShape(name="cylinder", markers=make, size=d, area=d, surface=surface, volume=volume, inertia=inertia, flat=True)


def section(points: Any) -> BodyShape:
    """A section of your own in the plane, for a box of two lengths: corners (P, 2) m of a closed polygon, either way round.

    Its area, of the coefficients, is its extent across the stream; its size the longer side of the upright box round it.

    Raises ConfigError: fewer than three corners, a line that crosses itself, or no area.
    """
    corners = numbers("section: points", points, (None, 2))
    if len(corners) < 3:
        raise ConfigError(f"section: {len(corners)} points; expected three or more corners of a closed polygon")
    after = np.roll(corners, -1, 0)
    corners = corners[(corners != after).any(1)]
    turn = _turned(corners)
    if turn < 0:
        corners = corners[::-1]
    if _crosses(corners) or not turn:
        raise ConfigError("section: the polygon crosses itself, or has no area; expected its corners in order, each once")
    volume, centre, inertia = _section_moments(corners)
    x, y = np.ptp(corners, 0)
    options: dict[str, Any] = {"volume": volume, "centre": centre, "inertia": inertia, "width": float(y), "flat": True}
    make = lambda dx: polygon_markers(corners, dx)
    return BodyShape(name="section", markers=make, size=float(max(x, y)), area=float(y), surface=_ring(corners), **options)


def upright_edges(surface: Surface) -> list[tuple[int, float]]:
    """Axis and place, m, of the edges along the grid that have `LOST` of a section's line or more, by place; each once."""
    ends = surface[0][surface[1]][..., :2]  # (F, 2, 2)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    found = set()
    for axis in range(2):
        across = np.ptp(ends[..., axis], axis=1) < 1e-6 * length
        kept = across & (length >= LOST * length.sum())
        found |= {(axis, float(place)) for place in ends[kept, 0, axis]}
    return sorted(found)


def polygon_markers(corners: np.ndarray, dx: float) -> Markers:
    """Markers of a polygon (P, 2) m about a cell apart, one cell deep, drawn in by the kernel's offset.

    Raises ConfigError: the section is thinner than the offset on both sides.
    """
    inset = INSET * dx
    along = np.roll(corners, -1, 0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    after = np.stack([along[:, 1], -along[:, 0]], -1)  # outward, of the edge behind each corner
    before = np.roll(after, 1, 0)
    move = -inset * (before + after) / np.maximum(1 + np.sum(before * after, 1, keepdims=True), 1e-9)
    far = np.linalg.norm(move, axis=1, keepdims=True)
    drawn = corners + move * np.minimum(1.0, MOST_DRAWN * inset / np.maximum(far, 1e-300))
    edges = np.roll(drawn, -1, 0) - drawn
    length = np.linalg.norm(edges, axis=1)
    count = max(4, round(length.sum() / dx))
    at = (np.arange(count) + 0.5) / count * length.sum()
    edge = np.minimum(np.searchsorted(np.cumsum(length), at), len(corners) - 1)
    share = (at - (np.cumsum(length) - length)[edge]) / length[edge]
    place = drawn[edge] + share[:, None] * edges[edge]
    turned_back = np.sum(edges * along, 1) < 0
    if _turned(drawn) <= 0 or np.mean(turned_back[edge] | ~_inside(place, corners)) > LOST:
        raise ConfigError(
            f"section: more than {100 * LOST:.0f} % of its line lies where it is thinner than the {2 * INSET:.1f} cells by"
            f" which both sides are drawn in at dx = {dx:g} m; take a smaller dx, or a plate(..) for a thin part"
        )
    lift = lambda values: np.append(values, np.zeros((count, 1)), 1)
    return Markers.rigid(lift(place), lift(after[edge]), length.sum() / count * dx)


def _ring(corners: np.ndarray) -> Surface:
    """Surface of a section: its corners (P, 2) m, and its edges."""
    n = len(corners)
    return np.append(corners, np.zeros((n, 1)), 1), np.stack([np.arange(n), (np.arange(n) + 1) % n], -1)


def _turned(corners: np.ndarray) -> float:
    """Area of a polygon (P, 2), positive if it is counter-clockwise."""
    after = np.roll(corners, -1, 0)
    return float((corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]).sum() / 2)


def _crosses(corners: np.ndarray) -> bool:
    """Returns True if two edges of a polygon (P, 2) cross."""
    side = lambda p, q, r: (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
    a, b = corners, np.roll(corners, -1, 0)
    ends = side(a[:, None], b[:, None], a[None]) * side(a[:, None], b[:, None], b[None])
    return bool(((ends < 0) & (ends.T < 0)).any())


def _inside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points (N, 2) in a polygon (P, 2)."""
    a, b = corners[None], np.roll(corners, -1, 0)[None]
    x, y = points[:, :1], points[:, 1:]
    over = (a[..., 1] > y) != (b[..., 1] > y)
    rise = np.where(over, b[..., 1] - a[..., 1], 1.0)
    return (over & (x < a[..., 0] + (y - a[..., 1]) / rise * (b[..., 0] - a[..., 0]))).sum(1) % 2 == 1


def _section_moments(corners: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Area m2, centre (3,) m and moments (3, 3) m4 about it, of one metre of span without that along the span."""
    after = np.roll(corners, -1, 0)
    cross = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    area = float(cross.sum() / 2)
    whole = corners + after
    centre = (cross[:, None] * whole).sum(0) / (6 * area)
    second = sum(np.einsum("p,pi,pj->ij", cross, q, q) for q in (corners, after, whole)) / 24 - area * np.outer(centre, centre)
    full = np.zeros((3, 3))
    full[:2, :2] = second
    return area, np.append(centre, 0.0), np.trace(full) * np.eye(3) - full


def plate(chord: float, span: float | None = None, *, angle: float = 0.0, sharpness: Sharpness = FINS) -> BodyShape:
    """A thin plate of `chord` m, its leading edge up by `angle` degrees; without `span` m it spans a box of two lengths.

    The coefficients are of the area chord x span. Raises ConfigError for invalid numbers.
    """
    c = float(numbers("plate: chord", chord, low=1e-300))
    s = None if span is None else float(numbers("plate: span", span, low=1e-300))
    turn, area = radians(float(numbers("plate: angle", angle, low=-180, high=180))), c * (s or 1.0)
    make = lambda dx: plate_markers(c, s, turn, dx, sharpness)
    x, y, z = c / 2 * cos(turn), c / 2 * sin(turn), (s or 0.0) / 2
    surface = np.array([[-x, y, -z], [x, -y, -z], [x, -y, z], [-x, y, z]]), np.array([[0, 1, 2], [0, 2, 3]])
    if s is None:
        surface = _ring(surface[0][:2, :2])
    return BodyShape(name="plate", markers=make, size=c, area=area, surface=surface, width=min(c, s or c), flat=s is None)


def plate_markers(chord: float, span: float | None, angle: float, dx: float, sharpness: Sharpness) -> Markers:
    """Markers of a plate turned by `angle` rad, about a cell apart, its middle at the origin of link 0."""
    inset = sharpness.insets()[1] * dx
    half = [size / 2 - min(inset, 0.45 * size / 2) for size in ((chord,) if span is None else (chord, span))]
    counts = [max(1, round(2 * h / dx)) for h in half]
    sides = [h * (2 * (np.arange(n) + 0.5) / n - 1) for h, n in zip(half, counts, strict=True)]
    s, z = (column.ravel() for column in np.meshgrid(*sides, indexing="ij")) if span is not None else (sides[0], 0 * sides[0])
    area = 4 * half[0] * half[1] / s.size if span is not None else 2 * half[0] / s.size * dx
    normal = np.broadcast_to([sin(angle), cos(angle), 0.0], (s.size, 3))
    return Markers.rigid(np.stack([s * cos(angle), -s * sin(angle), z], -1), normal, area, sheet=True, sharpness=sharpness)


def mesh(source: Any, scale: float = 1.0) -> BodyShape:
    """A closed mesh of triangles: an STL, OBJ or MSH file, or (vertices (V, 3) m, faces (F, 3), counter-clockwise from outside).

    `scale` turns the file's unit into metres. The size is the longest side of the upright box round it.

    Raises ConfigError: the file cannot be read, or the surface is open, inside out or without volume.
    """
    numbers("mesh: scale", scale, low=1e-300)
    what = f"mesh {source}" if isinstance(source, str | Path) else "mesh"
    vertices, faces = _file_surface(Path(source)) if isinstance(source, str | Path) else _given_surface(source)
    vertices, faces = _closed(what, vertices * scale, faces)
    volume, centre, inertia = solid_moments(vertices, faces)
    surface, size = (vertices, faces), float(np.ptp(vertices, 0).max())
    options: dict[str, Any] = {"volume": volume, "centre": centre, "inertia": inertia, "width": thinnest(vertices)}
    make = lambda dx: surface_markers(what, vertices, faces, dx)
    return BodyShape(name=what, markers=make, size=size, area=frontal_area([surface]), surface=surface, **options)


def _given_surface(source) -> tuple[np.ndarray, np.ndarray]:
    if not isinstance(source, tuple | list) or len(source) != 2:
        raise ConfigError(f"mesh: {type(source).__name__}; expected the name of a file, or (vertices (V, 3), faces (F, 3))")
    vertices = numbers("mesh: vertices", source[0], (None, 3))
    return vertices, whole_numbers("mesh: faces", source[1], (None, 3), low=0, high=len(vertices) - 1)


def _file_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a file as MuJoCo reads it, in the file's own frame."""
    if not path.is_file():
        raise ConfigError(f"mesh {path}: no such file; expected an STL, OBJ or MSH file")
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh", file=str(path.resolve()), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"mesh {path}: {' '.join(str(error).split())}; expected an STL, OBJ or MSH file") from None
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
    return model.mesh_vert.astype(float) @ turn.reshape(3, 3).T + model.mesh_pos[0], model.mesh_face.astype(int)


def _closed(what: str, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joins equal vertices; raises ConfigError unless every edge has two faces that run through it in opposite directions."""
    step = 1e-7 * max(float(np.ptp(vertices, 0).max()), 1e-300)
    _, first, same = np.unique(np.round(vertices / step).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    vertices, faces = vertices[first], same.ravel()[faces]
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth, back = (set(map(tuple, side)) for side in (edges.tolist(), edges[:, ::-1].tolist()))
    if len(forth) != len(edges) or forth != back:
        raise ConfigError(
            f"{what}: {len(forth ^ back)} edges do not join two triangles that are counter-clockwise seen from outside; expected"
            " a closed surface. Repair it first, for example with `trimesh` or Blender"
        )
    volume = solid_moments(vertices, faces)[0] if len(faces) else 0.0
    if not volume > 0:
        raise ConfigError(f"{what}: volume {volume:.3g} m3; expected triangles that are counter-clockwise seen from outside")
    return vertices, faces


def solid_moments(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume m3, centre (3,) m and moments of inertia (3, 3) m5 about it, of the inside of a closed surface."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    tetra = np.sum(a * np.cross(b, c), 1) / 6
    volume = float(tetra.sum())
    if not volume > 0:
        return volume, np.zeros(3), np.zeros((3, 3))
    whole = a + b + c
    centre = (tetra[:, None] * whole).sum(0) / (4 * volume)
    second = sum(np.einsum("t,ti,tj->ij", tetra, p, p) for p in (a, b, c, whole)) / 20 - volume * np.outer(centre, centre)
    return volume, centre, np.trace(second) * np.eye(3) - second


def surface_markers(what: str, vertices: np.ndarray, faces: np.ndarray, dx: float) -> Markers:
    """Markers of a closed surface about a cell of dx m apart, drawn in by the kernel's offset; the same ones each time.

    Raises ConfigError: the surface is thinner than the offset on both sides.
    """
    random = np.random.default_rng(0)
    drawn = _drawn_in(vertices, faces, INSET * dx)
    area = float(np.linalg.norm(_area_vectors(drawn, faces), axis=1).sum())
    count = max(8, round(area / dx**2))
    points, normals = _random_points(drawn, faces, POINTS * count, random)
    outside, outward = _random_points(vertices, faces, POINTS * count, random)
    near = cKDTree(outside).query(points)[1]
    lost = float(np.mean(np.sum((points - outside[near]) * outward[near], 1) > 0))
    if lost > LOST:
        raise ConfigError(
            f"{what}: {100 * lost:.0f} % of its surface is thinner than the {2 * INSET:.1f} cells by which both sides are"
            f" drawn in at dx = {dx:g} m; take a smaller dx, or a plate(..) for a thin part"
        )
    place = np.concatenate([points / dx, 0.5 * normals], 1)  # two near sides stay apart
    seeds = place[random.choice(len(place), count, replace=False)]
    for _ in range(ROUNDS):
        owner = cKDTree(seeds).query(place)[1]
        share = np.bincount(owner, minlength=count)
        mean = np.stack([np.bincount(owner, column, count) for column in place.T], -1)
        seeds = np.where(share[:, None] > 0, mean / np.maximum(share, 1)[:, None], seeds)
    used = share > 0
    normal = seeds[used, 3:]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    flat = np.linalg.norm(normal, axis=1) < 0.5  # two sides of a part without thickness
    normal[flat] = [0.0, 0.0, 1.0]
    return Markers.rigid(seeds[used, :3] * dx, normal, share[used] * area / len(points))


def _area_vectors(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a) / 2


def _drawn_in(vertices: np.ndarray, faces: np.ndarray, inset: float) -> np.ndarray:
    """Vertices moved so that all faces round each move inwards by `inset`, in least squares."""
    vector = _area_vectors(vertices, faces)
    area = np.linalg.norm(vector, axis=1, keepdims=True)
    normal, share = vector / np.maximum(area, 1e-300), area / area.mean()
    square, right = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    for corner in faces.T:
        np.add.at(square, corner, share[:, :, None] * normal[:, :, None] * normal[:, None])
        np.add.at(right, corner, share * normal)
    move = -inset * np.einsum("vij,vj->vi", np.linalg.pinv(square, rcond=0.02, hermitian=True), right)
    far = np.linalg.norm(move, axis=1, keepdims=True)
    return vertices + move * np.minimum(1.0, MOST_DRAWN * inset / np.maximum(far, 1e-300))


def _random_points(vertices: np.ndarray, faces: np.ndarray, count: int, random) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3) spread evenly over a surface, and their normals."""
    vector = _area_vectors(vertices, faces)
    area = np.linalg.norm(vector, axis=1)
    at = np.searchsorted(np.cumsum(area), (np.arange(count) + random.random(count)) / count * area.sum())
    at = np.minimum(at, len(faces) - 1)
    u, v = random.random((2, count))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u)[:, None], np.where(over, 1 - v, v)[:, None]
    a, b, c = (vertices[faces[at, i]] for i in range(3))
    return a + u * (b - a) + v * (c - a), vector[at] / np.maximum(area[at], 1e-300)[:, None]


def geom_surface(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface of a geom, vertices (V, 3) m in the frame of its body and faces (F, 3).

    Raises ConfigError: a plane, a height field or a signed distance field, or an open mesh.
    """
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    what = f"geom {model.geom(geom).name!r}"
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        i = int(model.geom_dataid[geom])
        first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
        start, number = model.mesh_faceadr[i], model.mesh_facenum[i]
        faces = model.mesh_face[start : start + number].astype(int)
        vertices, faces = _closed(what, model.mesh_vert[first : first + count].astype(float), faces)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        faces = np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    else:
        vertices, faces = _revolved(_meridian(what, kind, size))
        if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            vertices = vertices * size
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return vertices @ turn.reshape(3, 3).T + model.geom_pos[geom], faces


def _arc() -> np.ndarray:
    """Half a circle (33, 2) of radius 1: distance from the axis and height."""
    turn = np.linspace(-pi / 2, pi / 2, 33)
    arc = np.stack([np.cos(turn), np.sin(turn)], -1)
    arc[[0, -1], 0] = 0.0
    return arc


def _meridian(what: str, kind: mujoco.mjtGeom, size: np.ndarray) -> np.ndarray:
    """Half a section (n, 2) m: distance from the axis and height, from the lower pole to the upper one."""
    arc = _arc()
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return arc * size[0]
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return arc
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        low, high = arc[:17] * size[0] - [0, size[1]], arc[16:] * size[0] + [0, size[1]]
        return np.concatenate([low, high])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.array([[0, -size[1]], [size[0], -size[1]], [size[0], size[1]], [0, size[1]]])
    raise ConfigError(
        f"{what}: a {kind.name.removeprefix('mjGEOM_').lower()}; expected a sphere, capsule, ellipsoid, cylinder, box or mesh"
    )


def _revolved(meridian: np.ndarray, around: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """Surface that a meridian (n, 2) sweeps about z."""
    turn = 2 * pi * np.arange(around) / around
    rings = np.stack([np.outer(meridian[1:-1, 0], np.cos(turn)), np.outer(meridian[1:-1, 0], np.sin(turn))], -1)
    height = np.broadcast_to(meridian[1:-1, 1, None, None], (*rings.shape[:2], 1))
    poles = [[0.0, 0.0, meridian[0, 1]], [0.0, 0.0, meridian[-1, 1]]]
    vertices = np.concatenate([np.concatenate([rings, height], -1).reshape(-1, 3), poles])
    n, here, after = len(rings), np.arange(around), (np.arange(around) + 1) % around
    faces = [np.stack([0 * here + n * around, after, here], -1)]
    for i in range(n - 1):
        a, b = i * around, (i + 1) * around
        faces += [np.stack([a + here, a + after, b + after], -1), np.stack([a + here, b + after, b + here], -1)]
    faces.append(np.stack([0 * here + n * around + 1, (n - 1) * around + here, (n - 1) * around + after], -1))
    return vertices, np.concatenate(faces)


def link_surfaces(model: mujoco.MjModel) -> list[list[tuple[str, np.ndarray, np.ndarray]]]:
    """Name, vertices and faces of every shown geom (groups 0 to 2) of each moving body.

    Raises ConfigError: a geom of the world, which no force can be read from; or no geom at all.
    """
    found: list[list[tuple[str, np.ndarray, np.ndarray]]] = [[] for _ in range(model.nbody - 1)]
    for geom in np.flatnonzero(model.geom_group < SHOWN):
        name = model.geom(geom).name or str(geom)
        if model.geom_bodyid[geom] == 0:
            raise ConfigError(f"model: geom {name!r} belongs to the world; walls are faces of the box, an obstacle needs a body")
        found[model.geom_bodyid[geom] - 1].append((f"geom {name}", *geom_surface(model, int(geom))))
    if not any(found):
        raise ConfigError(
            "model: no geom in the groups 0 to 2; the water needs a surface: add geoms, or show those of groups 3 to 5"
        )
    return found
