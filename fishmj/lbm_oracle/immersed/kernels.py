"""The immersed boundary: markers take their pose, read the fluid, respond linearly to the body's velocity, and push the fluid.

For marker k with position X_k, unit normal n_k, volume V_k and Jacobian J_k (U = J_k v), lattice units, rho0 = 1:

    u*(x)   = sum_i c_i f_i / rho                      fluid velocity before any force
    u*_k    = sum_x u*(x) d(x - X_k)
    U_k(v)  = J_k v + s P_k (u*_k - J_k v)             slip target; P = I - n n^T, so s = 1 is impermeable and frictionless
    d_k     = U_k - (u* + G)_k,  F_k += d_k,  G(x) += sum_k V_k d_k d(x - X_k) / rho(x)          `passes` times
    F_k(v)  = F0_k + sum_j v_j F_j,k                   the passes are linear: one run for all nv + 1 right-hand sides
    K       = sum_k V_k J_k^T F_j,k,   b0 = sum_k V_k J_k^T F0_k         impulse of the body on the fluid: K v + b0

Departures from the textbook (Wang, Fan, Luo 2008; Kang, Hassan 2011):
    1. the slip target is frozen over the passes, so that the tangential force does not depend on their number;
    2. the spread force is divided by the local density, so that sum(rho G) = sum(V F) to round-off;
    3. Python never loops over markers, and only v is transferred to the host in a step.

d is regularised: the same function interpolates and spreads, so that the two are adjoint. With r in cells:

    3-point (Roma 1999):     phi = (1 + sqrt(1 - 3 r^2)) / 3                         |r| <= 1/2
                             phi = (5 - 3|r| - sqrt(1 - 3 (1 - |r|)^2)) / 6          |r| <= 3/2
    4-point (Peskin 2002):   phi = (3 - 2|r| + sqrt(1 + 4|r| - 4 r^2)) / 8           |r| <= 1
                             phi = (5 - 2|r| - sqrt(-7 + 12|r| - 4 r^2)) / 8         |r| <= 2

Both sum to one and conserve the first moment wherever the marker lies between the cells.

The speed of the water inside the hull is measured along each link, because a frictionless hull does not move it:

    s_l = sum_p w_p t_l . u*(x_p)          x_p: points of link l's own volume, t_l: its axis, sum_p w_p = 1

interpolated between the eight nodes round a point. Across the link the wall is impermeable and its water moves with it. Along the
link only friction and the closed ends move the water, so its speed must be measured.

Each thread of the kernels below has one marker (and one right-hand side, or one plane of its cells), on CPU and GPU alike.
"""

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from fishmj.base.errors import UnknownName
from fishmj.lbm_oracle.fluid.in_kernels import wrap
from fishmj.lbm_oracle.fluid.lattice import C, Q
from fishmj.lbm_oracle.fluid.storage import STORAGE, matrix3, peek, point3
from fishmj.mjcf.geometry import Geometry

wp.set_module_options({"enable_backward": False, "max_unroll": Q})

WIDTHS = (3, 4)


@wp.func
def phi(r: float, width: int) -> float:
    """One-dimensional weight at distance r [cells] of the kernel with `width` points."""
    a = wp.abs(r)
    if width == 3:
        if a <= 0.5:
            return (1.0 + wp.sqrt(wp.max(1.0 - 3.0 * a * a, 0.0))) / 3.0
        if a <= 1.5:
            return (5.0 - 3.0 * a - wp.sqrt(wp.max(1.0 - 3.0 * (1.0 - a) * (1.0 - a), 0.0))) / 6.0
        return 0.0
    if a <= 1.0:
        return (3.0 - 2.0 * a + wp.sqrt(wp.max(1.0 + 4.0 * a - 4.0 * a * a, 0.0))) / 8.0
    if a <= 2.0:
        return (5.0 - 2.0 * a - wp.sqrt(wp.max(-7.0 + 12.0 * a - 4.0 * a * a, 0.0))) / 8.0
    return 0.0


@wp.func
def first_cell(x: float, width: int) -> int:
    """Index of the first of the `width` cells that a marker at x [cells] touches."""
    if width == 3:
        return int(wp.floor(x + 0.5)) - 1
    return int(wp.floor(x)) - 1


@wp.func
def weight(x: wp.vec3, i: int, j: int, k: int, width: int) -> float:
    """Weight of the cell (i, j, k) for a marker at x; all in the same cell coordinates."""
    return phi(x[0] - float(i), width) * phi(x[1] - float(j), width) * phi(x[2] - float(k), width)


def check_width(width: int) -> int:
    """Returns `width` if there is such a kernel. Raises ConfigError."""
    if width not in WIDTHS:
        raise UnknownName("kernel width", str(width), WIDTHS)
    return width


@wp.struct
class CouplingArrays:
    """Offsets of the fields in the float64 block that the host sends every step; L links, n degrees of freedom."""

    links: int
    dofs: int
    frame: int  # L x 12: position, rotation (rows)
    angle: int  # L: angle of the hinge that carries the link
    axis: int  # n x 3
    anchor: int  # n x 3
    origin: int  # 3: world position of the centre of cell (0, 0, 0), m
    box: int  # 3: first cell of the scratch box
    before: int  # n: velocity at the start of the step
    system: int  # n x n: M + dt D
    momentum: int  # n: right-hand side without the fluid
    fixed: int  # n: 1 where the velocity is prescribed
    value: int  # n: the prescribed velocity
    reset_wrench: int  # 1 where the sum of the wrenches starts anew
    size: int


@wp.kernel
def pose(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    rest: wp.array(dtype=wp.vec3d),
    rest_normal: wp.array(dtype=wp.vec3d),
    pivot: wp.array(dtype=wp.vec3d),
    before: wp.array(dtype=int),
    after: wp.array(dtype=int),
    share: wp.array(dtype=wp.float64),
    reach: wp.array2d(dtype=wp.float64),
    slides: wp.array(dtype=int),
    dx: wp.float64,
    dt: wp.float64,
    width: int,
    shape: wp.vec3i,
    box: wp.vec3i,
    wraps: wp.vec3i,
    folded: wp.vec3i,
    corner: wp.array(dtype=int),
    force_box: wp.array(dtype=int),
    world: wp.array(dtype=wp.vec3d),
    cell: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    store: wp.array(dtype=wp.vec3i),
    jacobian: wp.array2d(dtype=wp.vec3),
):
    """Computes positions in the world [m] and in box cells, normals, and Jacobians [cells a step per unit velocity]."""
    k = wp.tid()
    if k < 3:  # nodes where the fluid will look for a force: the box, or all of an axis that wraps round
        force_box[k] = wp.where(wraps[k] == 1, corner[k], int(host[at.box + k]))
        force_box[k + 3] = force_box[k] + wp.where(wraps[k] == 1, shape[k], box[k])
    b, a, s = before[k], after[k], share[k]
    turn = s * host[at.angle + a]
    c, sn = wp.cos(turn), wp.sin(turn)
    r, m = rest[k] - pivot[k], rest_normal[k]
    local = wp.vec3d(c * r[0] - sn * r[1], sn * r[0] + c * r[1], r[2]) + pivot[k]
    rotation = matrix3(host, at.frame + 12 * b + 3)
    x = point3(host, at.frame + 12 * b) + rotation * local
    out = rotation * wp.vec3d(c * m[0] - sn * m[1], sn * m[0] + c * m[1], m[2])
    world[k] = x
    normal[k] = wp.vec3(float(out[0]), float(out[1]), float(out[2]))
    # float64 up to here, relative to the box from here on: single precision would lose the fraction of a distant cell
    grid = (x - point3(host, at.origin)) / dx
    low = point3(host, at.box)
    inner = grid - low
    for e in range(3):
        if folded[e] > 0:  # the box is all of the water: the marker's image in it, a whole number of periods away
            period, margin = wp.float64(shape[e]), wp.float64(folded[e])
            inner[e] -= period * wp.floor((inner[e] - margin) / period)
    place = wp.vec3(float(inner[0]), float(inner[1]), float(inner[2]))
    cell[k] = place
    i = wrap(first_cell(place[0], width) + int(low[0]), shape[0])
    j = wrap(first_cell(place[1], width) + int(low[1]), shape[1])
    store[k] = wp.vec3i(i, j, wrap(first_cell(place[2], width) + int(low[2]), shape[2]))
    for d in range(at.dofs):
        w = ((wp.float64(1.0) - s) * reach[b, d] + s * reach[a, d]) * dt / dx
        axis = point3(host, at.axis + 3 * d)
        column = w * axis
        if slides[d] == 0:
            column = w * wp.cross(axis, x - point3(host, at.anchor + 3 * d))
        jacobian[k, d] = wp.vec3(float(column[0]), float(column[1]), float(column[2]))


@wp.func
def pulled_moments(f: wp.array(dtype=Any), x: int, y: int, z: int, shape: wp.vec3i):
    """rho and rho u* of a cell, from the populations that its next step pulls.

    It wraps round on every axis and ignores faces: `Boundary.place_markers` refuses a body so near to a face that it would
    matter.
    """
    rho, m = wp.float32(1.0), wp.vec3(0.0, 0.0, 0.0)  # populations are stored less their weight
    cells = shape[0] * shape[1] * shape[2]
    # coordinates of the neighbours at -c, 0, c: nine instead of 57 remainders
    at_x = shape[1] * shape[2] * wp.vec3i(wrap(x + 1, shape[0]), wrap(x, shape[0]), wrap(x - 1, shape[0]))
    at_y = shape[2] * wp.vec3i(wrap(y + 1, shape[1]), wrap(y, shape[1]), wrap(y - 1, shape[1]))
    at_z = wp.vec3i(wrap(z + 1, shape[2]), wrap(z, shape[2]), wrap(z - 1, shape[2]))
    for q in range(wp.static(Q)):  # unrolled: nineteen loads under way at once
        c = wp.static(wp.vec3i(*C[q]))
        value = peek(f, q * cells + at_x[c[0] + 1] + at_y[c[1] + 1] + at_z[c[2] + 1])
        rho += value
        m += value * wp.vec3(float(c[0]), float(c[1]), float(c[2]))
    return rho, m


@wp.kernel
def read_cells(
    f: wp.array(dtype=Any),
    body_acceleration: wp.vec3,
    cell: wp.array(dtype=wp.vec3),
    store: wp.array(dtype=wp.vec3i),
    width: int,
    shape: wp.vec3i,
    box_u: wp.array3d(dtype=wp.vec3),
    box_rho: wp.array3d(dtype=float),
):
    """Computes u* and rho of the cells that marker k touches; markers that share a cell write the same numbers."""
    k, o = wp.tid()
    i, j, l = o // (width * width), (o // width) % width, o % width
    at = store[k]
    x, y, z = wrap(at[0] + i, shape[0]), wrap(at[1] + j, shape[1]), wrap(at[2] + l, shape[2])
    # only the cells that a marker touches: velocities of the whole box would cost a second pass over memory
    rho, m = pulled_moments(f, x, y, z, shape)
    p = cell[k]
    bx, by, bz = first_cell(p[0], width) + i, first_cell(p[1], width) + j, first_cell(p[2], width) + l
    box_u[bx, by, bz] = m / rho + body_acceleration
    box_rho[bx, by, bz] = rho


@wp.kernel
def set_target(
    cell: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    jacobian: wp.array2d(dtype=wp.vec3),
    slip: wp.array(dtype=float),
    width: int,
    box_u: wp.array3d(dtype=wp.vec3),
    wanted: wp.array2d(dtype=wp.vec3),
    force: wp.array2d(dtype=wp.vec3),
):
    """First pass: wanted velocity change of marker k for right-hand side r; r = 0 is a body at rest in the present fluid."""
    k, r = wp.tid()
    n, s = normal[k], slip[k]
    change = wp.vec3(0.0, 0.0, 0.0)
    # frozen for all passes: with a target that follows u*, the friction would depend on the number of passes
    if r == 0:
        p, u = cell[k], wp.vec3(0.0, 0.0, 0.0)
        x, y, z = first_cell(p[0], width), first_cell(p[1], width), first_cell(p[2], width)
        for i in range(width):
            for j in range(width):
                for l in range(width):
                    u += weight(p, x + i, y + j, z + l, width) * box_u[x + i, y + j, z + l]
        change = s * (u - wp.dot(u, n) * n) - u
    else:
        v = jacobian[k, r - 1]
        change = v - s * (v - wp.dot(v, n) * n)
    wanted[k, r] = change
    force[k, r] = change


@wp.kernel
def spread(
    cell: wp.array(dtype=wp.vec3),
    volume: wp.array(dtype=float),
    force: wp.array2d(dtype=wp.vec3),
    width: int,
    box_rho: wp.array3d(dtype=float),
    scratch: wp.array4d(dtype=wp.vec3),
):
    """scratch(x) += V_k F_k d(x - X_k) / rho(x) in plane i of the cells that marker k touches, right-hand sides innermost."""
    k, r, i = wp.tid()
    p, push = cell[k], volume[k] * force[k, r]
    x, y, z = first_cell(p[0], width), first_cell(p[1], width), first_cell(p[2], width)
    wx = phi(p[0] - float(x + i), width)
    for j in range(width):
        wy = wx * phi(p[1] - float(y + j), width)
        for l in range(width):
            w = wy * phi(p[2] - float(z + l), width)
            # divided by the local density, so that sum rho G = sum V F; otherwise the water would gain rho times the markers'
            # force
            wp.atomic_add(scratch, x + i, y + j, z + l, r, (w / box_rho[x + i, y + j, z + l]) * push)


@wp.kernel
def fold(axis: int, period: int, scratch: wp.array4d(dtype=wp.vec3)):
    """Sums the cells of the box that are a period apart along an axis, and so one cell of water; each gets the sum."""
    i, j, k, r = wp.tid()
    at = wp.vec3i(i, j, k)
    total, size = wp.vec3(0.0, 0.0, 0.0), scratch.shape[axis]
    for n in range((size - at[axis] + period - 1) / period):
        image = at
        image[axis] = at[axis] + n * period
        total += scratch[image[0], image[1], image[2], r]
    for n in range((size - at[axis] + period - 1) / period):
        image = at
        image[axis] = at[axis] + n * period
        scratch[image[0], image[1], image[2], r] = total


@wp.kernel
def correct(
    cell: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    normal_only: int,
    wanted: wp.array2d(dtype=wp.vec3),
    width: int,
    scratch: wp.array4d(dtype=wp.vec3),
    force: wp.array2d(dtype=wp.vec3),
):
    """Does one more pass: F_k += wanted_k - G_k; with `normal_only` the part along the normal alone."""
    k, r = wp.tid()
    p, g_at_marker = cell[k], wp.vec3(0.0, 0.0, 0.0)
    x, y, z = first_cell(p[0], width), first_cell(p[1], width), first_cell(p[2], width)
    for i in range(width):
        wx = phi(p[0] - float(x + i), width)
        for j in range(width):
            wy = wx * phi(p[1] - float(y + j), width)
            for l in range(width):
                g_at_marker += (wy * phi(p[2] - float(z + l), width)) * scratch[x + i, y + j, z + l, r]
    if normal_only == 1:
        force[k, r] = force[k, r] + wp.dot(wanted[k, r] - g_at_marker, normal[k]) * normal[k]
    else:
        force[k, r] = force[k, r] + wanted[k, r] - g_at_marker


@wp.kernel
def combine(force: wp.array2d(dtype=wp.vec3), v: wp.array(dtype=wp.float64), final: wp.array(dtype=wp.vec3)):
    """F_k = F0_k + sum_j v_j F_j,k."""
    k = wp.tid()
    total = force[k, 0]
    for j in range(force.shape[1] - 1):
        total += float(v[j]) * force[k, j + 1]
    final[k] = total


@wp.kernel
def spread_force(
    cell: wp.array(dtype=wp.vec3),
    store: wp.array(dtype=wp.vec3i),
    volume: wp.array(dtype=float),
    final: wp.array(dtype=wp.vec3),
    width: int,
    shape: wp.vec3i,
    box_rho: wp.array3d(dtype=float),
    acceleration: wp.array3d(dtype=wp.vec3),
):
    """G(x) += V_k F_k d(x - X_k) / rho(x) in the fluid's own array, in plane i of the cells that marker k touches."""
    k, i = wp.tid()
    p, at, whole = cell[k], store[k], volume[k] * final[k]
    x, y, z = first_cell(p[0], width), first_cell(p[1], width), first_cell(p[2], width)
    for j in range(width):
        for l in range(width):
            w = weight(p, x + i, y + j, z + l, width) / box_rho[x + i, y + j, z + l]
            sx, sy, sz = wrap(at[0] + i, shape[0]), wrap(at[1] + j, shape[1]), wrap(at[2] + l, shape[2])
            wp.atomic_add(acceleration, sx, sy, sz, w * whole)


@wp.kernel
def clear_force(store: wp.array(dtype=wp.vec3i), width: int, shape: wp.vec3i, acceleration: wp.array3d(dtype=wp.vec3)):
    """G = 0 in the cells that the markers touched in the last step."""
    k, o = wp.tid()
    at = store[k]
    i, j, l = o // (width * width), (o // width) % width, o % width
    acceleration[wrap(at[0] + i, shape[0]), wrap(at[1] + j, shape[1]), wrap(at[2] + l, shape[2])] = wp.vec3(0.0, 0.0, 0.0)


class Points(NamedTuple):
    """P points in the volumes of the links, in the links' frames."""

    place: np.ndarray  # (P, 3) m
    link: np.ndarray  # (P,)
    share: np.ndarray  # (P,) of the link's volume; 1 in all for each link

    @classmethod
    def of(cls, g: Geometry) -> "Points":
        """Four points for each strip, at half the half-axes of its elliptic section: exact for a quadratic function across it."""
        ds = ((g.span[:, 1] - g.span[:, 0]) / g.strip_x.shape[1])[:, None]
        width, height = g.strip_w / ds, g.strip_h / ds
        area = width * height / (width * height).sum(1, keepdims=True)
        place = [  # two by two, not one on the axis: what turns with the link must not look like what slides along it
            np.stack([g.strip_x, side * width / 4, up * height / 4], -1).reshape(-1, 3) for side in (-1, 1) for up in (-1, 1)
        ]
        link = np.repeat(np.arange(g.n_links), g.strip_x.shape[1])
        return cls(np.concatenate(place), np.tile(link, 4), np.tile(area.ravel() / 4, 4))


@wp.kernel
def measure_interior(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    place: wp.array(dtype=wp.vec3d),
    link: wp.array(dtype=int),
    f: wp.array(dtype=Any),
    body_acceleration: wp.vec3,
    dx: wp.float64,
    shape: wp.vec3i,
    along: wp.array2d(dtype=float),
):
    """Contribution of node o, of the eight round point p, to t . u* there, lattice units."""
    p, o = wp.tid()
    frame = at.frame + 12 * link[p]
    rotation = matrix3(host, frame + 3)
    x = (point3(host, frame) + rotation * place[p] - point3(host, at.origin)) / dx
    axis = wp.vec3(float(rotation[0, 0]), float(rotation[1, 0]), float(rotation[2, 0]))
    low = wp.vec3i(int(wp.floor(x[0])), int(wp.floor(x[1])), int(wp.floor(x[2])))
    part = wp.vec3(float(x[0]) - float(low[0]), float(x[1]) - float(low[1]), float(x[2]) - float(low[2]))
    # trilinear: the markers' kernel reaches 1.5 cells and would leave a hull that is three cells wide
    i, j, k = o // 4, (o // 2) % 2, o % 2
    weight = wp.abs(float(1 - i) - part[0]) * wp.abs(float(1 - j) - part[1]) * wp.abs(float(1 - k) - part[2])
    rho, m = pulled_moments(f, low[0] + i, low[1] + j, low[2] + k, shape)
    along[p, o] = weight * wp.dot(axis, m / rho + body_acceleration)


@wp.kernel
def mean_interior_speed(
    along: wp.array2d(dtype=float),
    begin: wp.array(dtype=int),
    share: wp.array(dtype=float),
    scale: wp.float64,
    speed: wp.array(dtype=wp.float64),
):
    """Computes s_l, m/s; the points of link l begin at begin[l] and end where the next link's begin."""
    l = wp.tid()  # one thread a link in a fixed order of points: atomics would cost the repetition to the bit
    total = wp.float32(0.0)
    for p in range(begin[l], begin[l + 1]):
        at_point = wp.float32(0.0)
        for o in range(8):
            at_point += along[p, o]
        total += share[p] * at_point
    speed[l] = scale * wp.float64(total)


for _kernel in (read_cells, measure_interior):
    for _storage in STORAGE.values():  # beforehand: an overload that comes later reloads the module under captured graphs
        wp.overload(_kernel, {"f": wp.array(dtype=_storage)})
