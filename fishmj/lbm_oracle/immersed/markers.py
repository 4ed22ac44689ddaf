"""Lagrangian markers: points where the immersed body touches the fluid, in the straight pose, about one marker in each cell.

A section of height h and width w becomes an ellipse of markers. A section that is too thin for two sides becomes one row of a
sheet in the middle plane: half-width after retraction below `SHEET` cells (with `edges`: below 0), or behind `fin_from`. Side
fins are sheets.

The kernel spreads a marker's force over 1.5 (3-point) or 2 (4-point) cells each way, so the body acts fatter than its
markers: they are drawn in along the normal by `hydro_offset` cells, at most `CLAMP` of the local half-thickness, and
sheets are shortened by it on their free edges (docs/solver/coupling.md has the measurement).

`Sharpness` draws hulls and rims in by other lengths. It also lets water slip on the markers just so far that the no-slip point
lies on the wall. In a shear g |y| on both sides of a sheet the regularised force makes the velocity g (phi * |y|) - g k. The
interpolation sees this as zero, with k = E |r - r'| for two independent draws from the kernel: the no-slip point lies k cells in
front of the sheet on either side. A slip length of k corrects this: u - U = k g, and the force on the water is
2 nu g = 2 nu (u - U) / k.

An accelerated sheet takes water along for the same reason. A pressure jump of wave number q along the sheet moves it by
q / 2 (1 - q k') of itself per unit of time, by q / 2 if the sheet is thin, so that the sheet has an extra inertia of 2 k' rho per
area: a layer 2 k' cells thick moves with it along its normal. k' = 0.88: 0.65 by the kernel, and the rest by the lattice, which
moves a shear of wave number q by 1 / (1 + tan^2(q / 2) / 3) of a force along it. `layer` is the thickness of that water. Its
momentum goes back to the links as that of the water inside a hull does (`body.py`).

Each marker has area A, acts on the volume V = A dx, and hangs on a hinge: it belongs with weight 1 - share to the link before
the hinge and with weight share to the link behind it (`mjcf.skin`), so the hull bends without gaps.
"""

from dataclasses import dataclass, fields, replace
from math import ceil, pi
from typing import Any

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import checked_kind
from fishmj.lbm_oracle.fluid.guard import numbers, whole_numbers
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import Geometry, geometry_of
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.skin import bend

HELD = {3: 0.7, 4: 0.9}  # cells that markers are drawn in where the water sticks, by the width of the kernel
SLIDING = {3: 0.45, 4: 0.55}  # and where it slides freely
STICKY = 0.95  # slip ratio up to which the drag of a sphere is that without slip
CLAMP = 0.45  # of the local half-thickness
SHEET = 0.5  # cells; a retracted half-width below it is one sheet
EDGE_RADIUS = 2 / 3  # cells; an edge of this radius is drawn in half-way between a rim and a hull
FLAT = 0.003  # share of an arc that faces across it, below which the arc counts as flat
LAYER, LAYER_WIDTH = 1.76, 3  # 2 k', cells of water that move with a sheet, and the points of the kernel for which they do
KINK = {3: 0.6, 4: 0.8}  # k, cells: mean over places between the nodes and angles to the grid; of 3 points 0.54 to 0.63


@dataclass(frozen=True, kw_only=True, repr=False)
class Sharpness:
    """Lengths, in cells, that place markers relative to walls and sheets; the defaults are those of the shipped data.

    hull: inset of hulls along their normal. rim: inset of sheets at their free edges, in their plane. None: both from
        `offset_of`.
    hull_slip, sheet_slip: slip lengths for no-slip walls (slip = 0); a wall with a slip ratio has its friction from that ratio.
    layer: thickness of the water that moves with a sheet, whose momentum its link gets back.
    edges: hulls are drawn in by the whole length, however thin they are. A section then ends above and below in an edge, which is
    drawn in like a rim, less if it is rounder; a marker on it has all the normals of its arc.
    law_height: m, least distance at which the water gives the stress of the wall (`wall_law.py`), and with it a slip ratio for
        each marker and step; None: the run's slip ratio.
    """

    hull: float | None = None
    rim: float | None = None
    hull_slip: float = 0.0
    sheet_slip: float = 0.0
    edges: bool = False
    law_height: float | None = None
    layer: float = 0.0

    def __post_init__(self):
        """Raises ConfigError for an invalid length."""
        for name in ("hull", "rim"):
            if getattr(self, name) is not None:
                numbers(f"sharpness: {name}", getattr(self, name))
        for name in ("hull_slip", "sheet_slip", "layer"):
            numbers(f"sharpness: {name}", getattr(self, name), low=0.0)
        if self.law_height is not None:
            numbers("sharpness: law_height", self.law_height, low=0.0)

    def __repr__(self) -> str:
        """Lengths as records have them; `law_height` and `layer` only if there is one."""
        late = {"law_height": None, "layer": 0.0}
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        given = {name: value for name, value in given.items() if name not in late or value != late[name]}
        return f"Sharpness({', '.join(f'{name}={value!r}' for name, value in given.items())})"

    def insets(self, width: int = 3, slip: float = 0.0, hydro_offset: float | None = None) -> tuple[float, float]:
        """Insets of hulls and of rims, cells; a given `hydro_offset` holds for both."""
        plain = offset_of(width, slip, hydro_offset)
        if hydro_offset is not None:
            return plain, plain
        return plain if self.hull is None else self.hull, plain if self.rim is None else self.rim

    def slip_length(self, sheet: np.ndarray, thick=0.0) -> np.ndarray:
        """Slip lengths (N,) cells.

        `sheet` (N,) marks markers of sheets, which stand for half a thickness of `thick` (N,) cells.
        """
        return np.where(sheet, np.maximum(self.sheet_slip - thick, 0.0), self.hull_slip)

    def layer_of(self, sheet: np.ndarray, thick=0.0) -> np.ndarray:
        """Thickness (N,) cells of the water that moves with each marker; arguments as `slip_length`.

        What the sheet stands for is water inside the link already.
        """
        return np.where(sheet, np.maximum(self.layer - 2 * np.asarray(thick), 0.0), 0.0)


PLAIN = Sharpness()
# chosen on spheres, plates, the added mass of sheets and an eel on three grids; of a 3-point kernel (studies/solver/NOTES.md)
SHARP = Sharpness(hull=0.45, rim=1.25, hull_slip=0.05, sheet_slip=KINK[3])
EDGES = replace(SHARP, edges=True)  # chosen on paddles (`cases.paddle`)
WALL_STRESS = replace(EDGES, law_height=0.015)
FINS = replace(EDGES, layer=LAYER)  # judged on discs and plates (`cases.disc`)


@dataclass(frozen=True, kw_only=True)
class Markers:
    """N markers of one body; positions are in the frame of the link `before`, in the straight pose.

    `pivot` is the hinge in the same frame: position = pivot + Rz(share angle) (rest - pivot), then the frame of `before`.
    """

    rest: np.ndarray  # (N, 3) m
    normal: np.ndarray  # (N, 3) unit, outward
    area: np.ndarray  # (N,) m2
    pivot: np.ndarray  # (N, 3) m
    before: np.ndarray  # (N,) int, link
    after: np.ndarray  # (N,) int, link
    share: np.ndarray  # (N,) 0..1
    sheet: np.ndarray  # (N,) bool, single sheet
    slip_length: np.ndarray | None = None  # (N,) cells, where the water sticks; None: 0
    layer: np.ndarray | None = None  # (N,) cells of water that move with a sheet along its normal; None: 0
    law_height: float | None = None  # m, of the law for the wall's stress; None: no law
    from_nose: np.ndarray | None = None  # (N,) m along a laminar hull, above 0; None: it is turbulent

    def __post_init__(self):
        """Raises ConfigError for arrays of other shapes or types, and for invalid numbers."""
        n = len(np.atleast_1d(np.asarray(self.area, object)))
        checked: dict[str, np.ndarray] = {
            "rest": numbers("markers: rest", self.rest, (n, 3)),
            "normal": numbers("markers: normal", self.normal, (n, 3), low=-1.001, high=1.001),
            "area": numbers("markers: area", self.area, (n,), low=0.0),
            "pivot": numbers("markers: pivot", self.pivot, (n, 3)),
            "share": numbers("markers: share", self.share, (n,), low=0.0, high=1.0),
            "before": whole_numbers("markers: before", self.before, (n,), low=0),
            "after": whole_numbers("markers: after", self.after, (n,), low=0),
            "sheet": np.asarray(self.sheet),
        }
        if checked["sheet"].shape != (n,) or checked["sheet"].dtype != bool:
            raise ConfigError(
                f"markers: sheet is {checked['sheet'].dtype} of the shape {checked['sheet'].shape}; expected {n} bools"
            )
        long = np.linalg.norm(checked["normal"], axis=1)
        if (np.abs(long - 1) > 1e-3).any():
            at = int(np.argmax(np.abs(long - 1)))
            raise ConfigError(f"markers: normal[{at}] has the length {long[at]:.4g}; expected unit vectors")
        for name in ("slip_length", "layer"):
            if getattr(self, name) is not None:
                checked[name] = numbers(f"markers: {name}", getattr(self, name), (n,), low=0.0)
        if self.law_height is not None:
            numbers("markers: law_height", self.law_height, low=0.0)
        if self.from_nose is not None:
            checked["from_nose"] = numbers("markers: from_nose", self.from_nose, (n,), low=1e-300)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.area)

    def layer_inertia(self, links: int, centre: np.ndarray, dx: float, rho: float) -> np.ndarray:
        """Inertia of the layers on the links' sheets, (L, 6, 6), kg, kg m and kg m2, for a twist about `centre` (L, 3) m.

            sum_k m_k w_k w_k^T,   m_k = rho A_k layer_k dx,   w_k = (n_k, (x_k - centre) x n_k)          in the link's frame

        Cells are of dx m and water is of rho kg/m3. A marker in a bend counts on both links by its share.
        """
        found = np.zeros((links, 6, 6))
        if self.layer is not None and self.layer.any():
            mass = rho * self.area * self.layer * dx
            for link, place, share in (
                (self.before, self.rest, 1 - self.share),
                (self.after, self.rest - self.pivot, self.share),
            ):
                arm = np.cross(place - centre[link], self.normal)
                way = np.concatenate([self.normal, arm], 1)
                np.add.at(found, link, (share * mass)[:, None, None] * way[:, :, None] * way[:, None])
        return found

    @classmethod
    def rigid(cls, rest, normal, area, *, link: int = 0, sheet=False, sharpness: Sharpness = PLAIN) -> "Markers":
        """Markers of one rigid link, already drawn in; `sharpness` gives their slip lengths."""
        rest = numbers("markers: rest", rest, (None, 3))
        n, index = len(rest), np.full(len(rest), whole_numbers("markers: link", link, low=0), np.int32)
        spread = lambda value: np.full(n, value) if np.ndim(value) == 0 else np.array(value)
        sheet = spread(sheet)
        return cls(
            rest=rest,
            normal=normal,
            area=spread(area),
            pivot=np.zeros((n, 3)),
            before=index,
            after=index,
            share=np.zeros(n),
            sheet=sheet,
            slip_length=sharpness.slip_length(sheet),
            layer=sharpness.layer_of(sheet),
            law_height=sharpness.law_height,
        )


def offset_of(width: int, slip: float = 0.0, hydro_offset: float | None = None) -> float:
    """Retraction in cells: `hydro_offset` if given, else the measured one of the kernel of that `width` (3 or 4) at that slip."""
    if width not in HELD:
        raise UnknownName("kernel width", str(width), HELD)
    numbers("markers: slip", slip, low=0.0, high=1.0)
    if hydro_offset is not None:
        return float(numbers("markers: hydro_offset", hydro_offset))
    free = min(max((slip - STICKY) / (1 - STICKY), 0.0), 1.0)
    return HELD[width] + free * (SLIDING[width] - HELD[width])


def sphere_markers(
    radius: float, dx: float, *, slip=0.0, width: int = 3, hydro_offset: float | None = None, sharpness: Sharpness = PLAIN
) -> Markers:
    """Markers of a sphere of `radius` m about the origin of link 0: points of a golden spiral, equal areas of about dx^2."""
    numbers("sphere: radius", radius, low=0.0), numbers("sphere: dx", dx, low=1e-300)
    r = radius - sharpness.insets(width, slip, hydro_offset)[0] * dx
    if r <= dx:
        raise ConfigError(
            f"sphere of radius {radius} m: markers drawn in to {r:.4g} m do not resolve it; choose dx < {radius / 3:.3g} m"
        )
    n = ceil(4 * pi * r**2 / dx**2)
    z = 1 - (2 * np.arange(n) + 1) / n
    turn = pi * (3 - 5**0.5) * np.arange(n)
    flat = np.sqrt(1 - z**2)
    unit = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], -1)
    return Markers.rigid(r * unit, unit, 4 * pi * r**2 / n, sharpness=sharpness)


def fish_markers(
    robot: "Robot | str" = "fish",
    dx: float = 0.01,
    *,
    slip: float = 1.0,
    width: int = 3,
    hydro_offset: float | None = None,
    spacing: float = 1.0,
    sharpness: Sharpness = PLAIN,
) -> Markers:
    """Markers of a fish for cells of size dx [m].

    Args:
        slip: slip ratio of the boundary; a wall with slip acts thinner.
        width: points of the kernel, 3 or 4.
        hydro_offset: inset in cells; the measured one by default.
        spacing: cells between markers.
        sharpness: insets and slip lengths of hulls and sheets.

    Raises ConfigError: nothing of the fish is left at this dx.
    """
    options: dict[str, Any] = {"slip": slip, "width": width, "hydro_offset": hydro_offset, "spacing": spacing}
    return chain_markers(load_robot(robot), dx, sharpness=sharpness, **options)


def chain_markers(
    robot: Robot,
    dx: float,
    *,
    slip: float,
    width: int = 3,
    hydro_offset: float | None = None,
    spacing: float = 1.0,
    sharpness: Sharpness = PLAIN,
) -> Markers:
    """Markers of a chain of any number of links; arguments as `fish_markers`.

    Raises ConfigError: as `fish_markers`, or a laminar hull without a law for the wall's stress.
    """
    numbers("markers: dx", dx, low=1e-300), numbers("markers: spacing", spacing, low=1e-3)
    checked_kind("markers: sharpness", sharpness, Sharpness, needed=True)
    if robot.hull == "laminar" and sharpness.law_height is None:
        raise ConfigError(
            f"{robot.name}: hull = 'laminar' in a boundary of the flow solver with one slip ratio for the hull; take the boundary"
            " wall_stress, or leave hull out of the description"
        )
    g = geometry_of(robot)
    (hull, rim), step = sharpness.insets(width, slip, hydro_offset), spacing * dx
    parts = [_body(robot, g, hull * dx, rim * dx, step, dx, sharpness.edges)]
    parts += [_side_fin(robot, g, fin, side, rim * dx, step) for fin in robot.fins for side in (1.0, -1.0)[: fin.count]]
    point, normal, area, anchor, sheet, thick = (np.concatenate(column) for column in zip(*parts, strict=True))
    if len(point) == 0:
        raise ConfigError(
            f"{robot.name}: no marker fits at dx = {dx} m; the fish is {robot.length} m long, try dx = {robot.length / 27:.3g} m"
        )
    hinge, share = bend(robot, g.origin[1:], anchor)
    before, after = hinge, hinge + 1
    rigid = (share == 0) | (share == 1)  # one link alone: keep its own index on both sides
    after = np.where(share == 0, before, after)
    before_of = np.where(share == 1, hinge + 1, before)
    pivot = np.stack([g.origin[hinge + 1] - g.origin[before_of], 0 * anchor, 0 * anchor], -1)
    return Markers(
        rest=point - np.stack([g.origin[before_of], 0 * anchor, 0 * anchor], -1),
        normal=normal,
        area=area,
        pivot=pivot,
        before=before_of.astype(np.int32),
        after=np.where(rigid, before_of, after).astype(np.int32),
        share=np.where(rigid, 0.0, share),
        sheet=sheet,
        slip_length=sharpness.slip_length(sheet, thick / dx),
        layer=sharpness.layer_of(sheet, thick / dx),
        law_height=sharpness.law_height,
        from_nose=np.maximum(g.reference - point[:, 0], dx / 2) if robot.hull == "laminar" else None,
    )


def _profile(robot: Robot, g: Geometry):
    """Returns the function station behind the nose [m] -> half-height, half-width [m]; and the station where the plate begins."""
    fronts = np.concatenate([[0.0], np.cumsum([link.length for link in robot.links])])
    rows = np.concatenate([np.array(link.sections) + [front, 0, 0] for link, front in zip(robot.links, fronts, strict=False)])
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 1e-9])]
    last = robot.links[-1]
    plate = fronts[-2] + last.fin_from if last.fin_from is not None else fronts[-1]
    half = lambda s: (np.interp(s, rows[:, 0], rows[:, 1]) / 2, np.interp(s, rows[:, 0], rows[:, 2]) * g.width_scale / 2)
    return half, plate


def _body(robot: Robot, g: Geometry, inset: float, rim: float, step: float, dx: float, edges: bool):
    """Hull rings, nose cap and tail sheet, in the straight pose, body frame."""
    half, plate = _profile(robot, g)
    nose, tail = min(inset, CLAMP * robot.length), robot.length - rim
    n = max(1, round((tail - nose) / step))
    ds = (tail - nose) / n
    out = []
    for i, s in enumerate(nose + (np.arange(n) + 0.5) * ds):
        a, b = half(s)
        drawn = inset if edges else min(inset, CLAMP * b)
        if s >= plate or b - drawn < (0.0 if edges else SHEET) * dx:
            out.append(_row(s, a - min(rim, CLAMP * a), b, ds, step))
            continue
        slope = [(v - u) / (2e-3) for u, v in zip(half(s - 1e-3), half(s + 1e-3), strict=True)]
        high = a - (min(_edge_inset(a, b, inset, rim, dx), CLAMP * a) if edges else drawn)
        out.append(_ring(s, high, b - drawn, slope, ds, step, edges))
        if i == 0:
            out.append(_cap(nose, high, b - drawn, step))
    station, y, z, nx, ny, nz, area, sheet, thick = (np.concatenate(column) for column in zip(*out, strict=True))
    x = g.reference - station
    return np.stack([x, y, z], -1), np.stack([nx, ny, nz], -1), area, x, sheet.astype(bool), thick


def _edge_inset(a: float, b: float, inset: float, rim: float, dx: float) -> float:
    """Inset of the ends of a section of half-height a and half-width b.

    It is the rim's if the radius there, b^2 / a, is far below a cell, and the hull's if it is far above.
    """
    return inset + (rim - inset) / (1.0 + b * b / (a * dx * EDGE_RADIUS))


def _even(count: float) -> int:
    """Nearest even number: with an odd number, one marker more on one side makes mirrored fish differ by 2.6 % in force."""
    return 2 * round(count / 2)


def _ellipse(a: float, b: float, n: int):
    """n angles at equal arc length on the ellipse of half-axes a (z) and b (y), and its perimeter."""
    fine = np.linspace(0, 2 * pi, 721)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(b * np.cos(fine)), np.diff(a * np.sin(fine))))])
    return np.interp((np.arange(n) + 0.5) / n * length[-1], length, fine), length[-1]


def _ring(s, a, b, slope, ds, step, edges=False):
    """One elliptical ring; `slope` are the derivatives of half-height and half-width along the body.

    With `edges` the number of markers is a multiple of four, so that none lies on an edge, and each stands for its arc
    (`_facing`).
    """
    count = _ellipse(a, b, 1)[1] / step
    n = max(4, 4 * round(count / 4)) if edges else max(6, _even(count))
    turn, perimeter = _ellipse(a, b, n)
    c, sn = np.cos(turn), np.sin(turn)
    across, share = _outward(a, b, turn), np.ones(n)
    if edges:
        which, across, share = _facing(a, b, n, across)
        c, sn = c[which], sn[which]
    lengthwise = across[:, 0] * c * slope[1] + across[:, 1] * sn * slope[0]
    size = np.sqrt(1 + lengthwise**2)
    one = np.ones(len(c))
    area = share * perimeter / n * ds * size
    return s * one, b * c, a * sn, lengthwise / size, across[:, 0] / size, across[:, 1] / size, area, 0 * one, 0 * one


def _outward(a: float, b: float, turn: np.ndarray) -> np.ndarray:
    """(.., 2) unit normals in y, z of the ellipse of half-axes a (z) and b (y) at angles `turn`."""
    across = np.stack([np.cos(turn) * a, np.sin(turn) * b], -1)
    return across / np.linalg.norm(across, axis=-1, keepdims=True)


def _facing(a: float, b: float, n: int, across: np.ndarray, fine: int = 32) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index, normal and share of the area that represent each of n markers on an ellipse; `across` (n, 2) are normals there.

        <n n^T> = sum_i share_i e_i e_i^T      mean over the marker's arc; e_i: its principal directions, the shares add up to 1

    A marker stops the water along its normal. If the arc turns by a large angle, as at an edge, it has two directions: two
    markers stand there, each with its share. With one marker, water that should leave the hull there would slip round the edge.
    """
    normal = _outward(a, b, _ellipse(a, b, fine * n)[0]).reshape(n, fine, 2)
    shares, directions = np.linalg.eigh(np.einsum("nki,nkj->nij", normal, normal) / fine)
    share, direction = shares.T.ravel(), directions.transpose(2, 0, 1).reshape(2 * n, 2)
    which = np.tile(np.arange(n), 2)
    direction *= np.where((direction * across[which]).sum(-1) < 0, -1.0, 1.0)[:, None]
    kept = share > FLAT
    return which[kept], direction[kept], np.where(share > 1 - FLAT, 1.0, share)[kept]


def _cap(s, a, b, step):
    """Nose: concentric ellipses that close the front, normal forwards."""
    rings = max(1, round(min(a, b) / step))
    cols = []
    for r in range(rings):
        share, area = (r + 0.5) / rings, pi * a * b * (2 * r + 1) / rings**2
        n = 1 if r == 0 and area < 1.5 * step**2 else max(2, _even(area / step**2))
        turn, one = _ellipse(share * a, share * b, n)[0], np.ones(n)
        if n == 1:
            share = 0.0
        y, z = share * b * np.cos(turn), share * a * np.sin(turn)
        cols.append((s * one, y, z, one, 0 * one, 0 * one, area / n * one, 0 * one, 0 * one))
    return tuple(np.concatenate(column) for column in zip(*cols, strict=True))


def _row(s, a, b, ds, step):
    """One upright row of a sheet of half-height a that stands for a half-width b, normal to the left."""
    n = max(1, round(2 * a / step))
    z = a * (2 * (np.arange(n) + 0.5) / n - 1)
    one = np.ones(n)
    return s * one, 0 * one, z, 0 * one, one, 0 * one, 2 * a / n * ds * one, one, b * one


def _side_fin(robot: Robot, g: Geometry, fin, side: float, inset: float, step: float):
    """One horizontal plate, shortened by the offset on its three free edges."""
    i = [link.name for link in robot.links].index(fin.link)
    rows = np.array(robot.links[i].sections)
    front = g.origin[i] + g.span[i, 1]
    root = np.interp(np.mean(fin.station), rows[:, 0], rows[:, 2]) * g.width_scale / 2
    chord = fin.station[1] - fin.station[0]
    along, tip = min(inset, CLAMP * chord / 2), min(inset, CLAMP * fin.span)
    nx, ny = max(1, round((chord - 2 * along) / step)), max(1, round((fin.span - tip) / step))
    u, v = np.meshgrid((np.arange(nx) + 0.5) / nx, (np.arange(ny) + 0.5) / ny, indexing="ij")
    x = (front - fin.station[0] - along - u * (chord - 2 * along)).ravel()
    y = side * (root + v * (fin.span - tip)).ravel()
    one = np.ones(len(x))
    area = (chord - 2 * along) / nx * (fin.span - tip) / ny
    point, normal = np.stack([x, y, 0 * x], -1), np.stack([0 * x, 0 * x, one], -1)
    return point, normal, area * one, np.full(len(x), front - np.mean(fin.station)), one.astype(bool), 0 * one
