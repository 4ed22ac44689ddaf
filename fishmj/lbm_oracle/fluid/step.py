"""One step of the fluid in one pass over memory: pull, moments, faces, sponge, slopes, eddy viscosity, collision, force.

    f_i(x, t + 1) = f_i'(x - c_i, t)

Arrays are (19, nx, ny, nz) and (nx, ny, nz) with z fastest: neighbouring threads read neighbouring words of every population.
Memory is addressed by world node modulo size, so that a window moves by changing `origin`, the world node of its low corner.

Bytes a cell and step, FP32: populations 2 x 76 = 152; with eddy viscosity 12 more to write u and about 12 to read it once (its
six neighbours come from cache; the same slopes serve the stress); the force is read inside the body's box only.

`kernels(faces, subgrid)` compiles the two kernels for one set of faces: what a face does not need costs nothing.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.collide import density, hybrid_stress, momentum, non_equilibrium_stress, reconstruct, relaxed, wale
from fishmj.lbm_oracle.fluid.domain_faces import Axis, ramp, through
from fishmj.lbm_oracle.fluid.inflow import Inflow, background
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES, C, Q, W, mirrored, opposite, vec19
from fishmj.lbm_oracle.fluid.storage import STORAGE, peek, peek3, poke, poke3

OPTIONS = {"max_unroll": 32, "enable_backward": False}  # and quick roots and quotients on a GPU where there is an eddy viscosity


@wp.struct
class Params:
    """What every kernel needs to know, lattice units."""

    nx: int
    ny: int
    nz: int
    nu: float
    omega_bulk: float
    cw2: float  # square of the WALE constant
    borrowed: float  # share of the stress that the slopes of the velocity give
    borrowed_layer: float  # the same where the body's force acts
    drive: wp.vec3  # uniform acceleration
    slide: wp.vec3  # velocity of the wall at high y
    sponge: int
    sponge_rate: float


class Kernels(NamedTuple):
    advance: wp.Kernel
    predict: wp.Kernel


@wp.func
def pick(c: int, back: int, here: int, ahead: int):
    """Where a population of velocity c comes from along one axis."""
    if c > 0:
        return back
    if c < 0:
        return ahead
    return here


@wp.func
def hits(c: int, low: bool, high: bool):
    """Does it come through the low or the high face?"""
    return (c > 0 and low) or (c < 0 and high)


@wp.func
def folded(i: int, n: int):
    """World node -> memory."""
    r = i % n
    if r < 0:
        r += n
    return r


@wp.func
def within(i: int, n: int):
    """An index less than one size out of range, brought back; cheaper than a division."""
    if i < 0:
        return i + n
    if i >= n:
        return i - n
    return i


@cache
def kernels(faces: tuple[Axis, Axis, Axis], subgrid: bool, dtype: str = "float32", keeps: bool = True) -> Kernels:
    """Kernels for these faces of x, y and z; `subgrid` adds eddy viscosity and blend.

    `dtype` is how populations are stored. `keeps` stores the velocity of each step, which the next one needs for them.
    """
    number = STORAGE[dtype]

    def meets(i: int, axis: int, kind: str) -> bool:
        """Can population i come through a face of this kind?"""
        c = VELOCITIES[i, axis]
        return bool(c) and faces[axis][0 if c > 0 else 1] == kind

    def bends(i: int) -> bool:
        return any(meets(i, axis, "slip") for axis in range(3))

    def bounces(i: int) -> bool:
        return any(meets(i, axis, "wall") for axis in range(3))

    def turned(i: int, *axes: int) -> int:
        return mirrored(i, *axes)

    # a module of its own, by name: Warp's automatic names do not see static expressions that depend on an unrolled loop
    module = wp.get_module(
        ".".join([__name__, *("_".join(axis) for axis in faces), "wale" if subgrid else "none", dtype, "u" if keeps else "f"])
    )
    wp.set_module_options(OPTIONS | {"fast_math": subgrid}, module)
    bounded = [axis.low != "periodic" for axis in faces]
    opened = ["open" in axis for axis in faces]

    @wp.func
    def pull(f: wp.array(dtype=number), s: Params, lx: int, ly: int, lz: int, x: int, y: int, z: int):
        """Populations that arrive at memory node (x, y, z), logical node (lx, ly, lz)."""
        ny, nz = s.ny, s.nz
        n = s.nx * ny * nz
        x0, y0, z0 = x * (ny * nz), y * nz, z
        xm, xp = wp.where(x > 0, x - 1, s.nx - 1) * (ny * nz), wp.where(x < s.nx - 1, x + 1, 0) * (ny * nz)
        ym, yp = wp.where(y > 0, y - 1, ny - 1) * nz, wp.where(y < ny - 1, y + 1, 0) * nz
        zm, zp = wp.where(z > 0, z - 1, nz - 1), wp.where(z < nz - 1, z + 1, 0)
        lowx, lowy, lowz = lx == 0, ly == 0, lz == 0
        highx, highy, highz = lx == s.nx - 1, ly == ny - 1, lz == nz - 1
        out = vec19()
        out[0] = peek(f, x0 + y0 + z0)
        for i in range(1, wp.static(Q)):
            sx = pick(wp.static(C[i][0]), xm, x0, xp)
            sy = pick(wp.static(C[i][1]), ym, y0, yp)
            sz = pick(wp.static(C[i][2]), zm, z0, zp)
            j = int(i)
            lift = float(0.0)  # noqa: UP018  a variable, not a constant, to Warp
            if wp.static(bends(i)):
                fx = wp.static(meets(i, 0, "slip")) and hits(wp.static(C[i][0]), lowx, highx)
                fy = wp.static(meets(i, 1, "slip")) and hits(wp.static(C[i][1]), lowy, highy)
                fz = wp.static(meets(i, 2, "slip")) and hits(wp.static(C[i][2]), lowz, highz)
                sx, sy, sz = wp.where(fx, x0, sx), wp.where(fy, y0, sy), wp.where(fz, z0, sz)
                plain = wp.where(
                    fx,
                    wp.where(fy, wp.static(turned(i, 0, 1)), wp.static(turned(i, 0))),
                    wp.where(fy, wp.static(turned(i, 1)), i),
                )
                above = wp.where(
                    fx,
                    wp.where(fy, wp.static(turned(i, 0, 1, 2)), wp.static(turned(i, 0, 2))),
                    wp.where(fy, wp.static(turned(i, 1, 2)), wp.static(turned(i, 2))),
                )
                j = wp.where(fz, above, plain)
            if wp.static(bounces(i)):
                bx = wp.static(meets(i, 0, "wall")) and hits(wp.static(C[i][0]), lowx, highx)
                by = wp.static(meets(i, 1, "wall")) and hits(wp.static(C[i][1]), lowy, highy)
                bz = wp.static(meets(i, 2, "wall")) and hits(wp.static(C[i][2]), lowz, highz)
                if bx or by or bz:
                    sx, sy, sz, j = x0, y0, z0, wp.static(opposite(i))
                    if wp.static(C[i][1] < 0):
                        if by and not bx and not bz:  # in the corner the side wall holds: a moving corner is first order
                            c = wp.vec3(wp.static(float(C[i][0])), wp.static(float(C[i][1])), wp.static(float(C[i][2])))
                            lift = wp.static(6.0 * W[i]) * wp.dot(c, s.slide)
            arrived = peek(f, j * n + sx + sy + sz)
            if wp.static(bounces(i)):
                arrived += lift
            out[i] = arrived
        return out

    @wp.func
    def slopes(u: wp.array(dtype=wp.vec3), s: Params, lx: int, ly: int, lz: int, x: int, y: int, z: int):
        """d u / d x, d y, d z in rows, from the last step; at a face the node stands in for its missing neighbour."""
        xm, xp = wp.where(x > 0, x - 1, s.nx - 1), wp.where(x < s.nx - 1, x + 1, 0)
        ym, yp = wp.where(y > 0, y - 1, s.ny - 1), wp.where(y < s.ny - 1, y + 1, 0)
        zm, zp = wp.where(z > 0, z - 1, s.nz - 1), wp.where(z < s.nz - 1, z + 1, 0)
        if wp.static(bounded[0]):
            xm, xp = wp.where(lx == 0, x, xm), wp.where(lx == s.nx - 1, x, xp)
        if wp.static(bounded[1]):
            ym, yp = wp.where(ly == 0, y, ym), wp.where(ly == s.ny - 1, y, yp)
        if wp.static(bounded[2]):
            zm, zp = wp.where(lz == 0, z, zm), wp.where(lz == s.nz - 1, z, zp)
        plane, row = s.ny * s.nz, s.nz
        over_y_z, over_x_z, over_x_y = y * row + z, x * plane + z, x * plane + y * row
        return wp.matrix_from_rows(
            0.5 * (peek3(u, xp * plane + over_y_z) - peek3(u, xm * plane + over_y_z)),
            0.5 * (peek3(u, yp * row + over_x_z) - peek3(u, ym * row + over_x_z)),
            0.5 * (peek3(u, zp + over_x_y) - peek3(u, zm + over_x_y)),
        )

    @wp.kernel(module=module, grid_stride=False)
    def advance(
        start: int,
        s: Params,
        flow: Inflow,
        origin: wp.array(dtype=int),
        box: wp.array(dtype=int),
        clock: wp.array(dtype=int),
        f: wp.array(dtype=number),
        u_old: wp.array(dtype=wp.vec3),
        force: wp.array(dtype=wp.vec3),
        f_next: wp.array(dtype=number),
        u_next: wp.array(dtype=wp.vec3),
        clock_next: wp.array(dtype=int),
    ):
        here = start + wp.tid()
        z = here % s.nz
        column = here / s.nz
        y = column % s.ny
        x = column / s.ny
        step = clock[0]
        if here == 0:
            clock_next[0] = step + 1
        lx, ly, lz = within(x - origin[3], s.nx), within(y - origin[4], s.ny), within(z - origin[5], s.nz)
        wx, wy, wz = lx + origin[0], ly + origin[1], lz + origin[2]

        if wp.static(any(opened)):
            inner_x, inner_y = int(lx), int(ly)
            if wp.static(opened[0]):
                inner_x = wp.clamp(lx, 1, s.nx - 2)
            if wp.static(opened[1]):
                inner_y = wp.clamp(ly, 1, s.ny - 2)
            inner_mx, inner_my = within(x + inner_x - lx, s.nx), within(y + inner_y - ly, s.ny)
            q = pull(f, s, inner_x, inner_y, lz, inner_mx, inner_my, z)
        else:
            q = pull(f, s, lx, ly, lz, x, y, z)
        drho = density(q)
        u = (1.0 / (1.0 + drho)) * momentum(q)
        p = non_equilibrium_stress(q, drho, u)

        sigma = float(0.0)  # noqa: UP018
        target = wp.vec3()
        if wp.static(any(opened)):
            if wp.static(opened[0]):
                sigma = ramp(lx, s.nx, s.sponge)
            if wp.static(opened[1]):
                sigma += ramp(ly, s.ny, s.sponge)
            sigma = s.sponge_rate * sigma
            outer = inner_x != lx or inner_y != ly
            if outer or sigma > 0.0:
                target = background(flow, wp.vec3(float(wx), float(wy), float(wz)), step + 1)
                if outer:
                    n = wp.normalize(wp.vec3(float(lx - inner_x), float(ly - inner_y), 0.0))
                    drho, u = through(drho, u, target, n)

        g = s.drive
        nu = s.nu
        bare = True
        if wx >= box[0] and wx < box[3] and wy >= box[1] and wy < box[4] and wz >= box[2] and wz < box[5]:
            push = peek3(force, here)
            g += push
            bare = wp.length_sq(push) == 0.0
        if wp.static(subgrid):
            d = slopes(u_old, s, lx, ly, lz, x, y, z)
            nu += wale(d[0], d[1], d[2], s.cw2)
            share = wp.where(bare, s.borrowed, s.borrowed_layer)
            p = hybrid_stress(p, d[0], d[1], d[2], (1.0 + drho) * (0.5 + 3.0 * nu), share)
        p = relaxed(p, 1.0 / (0.5 + 3.0 * nu), s.omega_bulk)
        v = u + g
        if wp.static(any(opened)):
            if sigma > 0.0:
                drho -= sigma * drho
                u += sigma * (target - u)
                v += sigma * (target - v)
                p *= 1.0 - sigma
        q = reconstruct(drho, u, v, p)
        n_cells = s.nx * s.ny * s.nz
        for i in range(wp.static(Q)):
            # static: a deferred expression here makes Warp hash those of `pull`, and never take a stale kernel from its cache
            poke(f_next, wp.static(i) * n_cells + here, q[i])
        if wp.static(keeps):
            poke3(u_next, here, 0.5 * (u + v))

    @wp.kernel(module=module)
    def predict(
        s: Params,
        origin: wp.array(dtype=int),
        box: wp.array(dtype=int),
        f: wp.array(dtype=number),
        u: wp.array3d(dtype=wp.vec3),
        rho: wp.array3d(dtype=float),
    ):
        i, j, k = wp.tid()
        wx, wy, wz = box[0] + i, box[1] + j, box[2] + k
        if wx >= box[3] or wy >= box[4] or wz >= box[5]:
            return
        x, y, z = folded(wx, s.nx), folded(wy, s.ny), folded(wz, s.nz)
        q = pull(f, s, wx - origin[0], wy - origin[1], wz - origin[2], x, y, z)
        drho = density(q)
        rho[x, y, z] = 1.0 + drho
        u[x, y, z] = (momentum(q) + (1.0 + drho) * s.drive) / (1.0 + drho)

    return Kernels(advance, predict)


def box_array(box) -> np.ndarray:
    """((lox, loy, loz), (hix, hiy, hiz)) -> (6,) int32."""
    return np.concatenate([np.asarray(box[0]), np.asarray(box[1])]).astype(np.int32)
