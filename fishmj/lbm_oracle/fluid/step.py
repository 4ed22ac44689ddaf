"""One step of the fluid in one pass over memory: pull, moments, faces, force, gradient, eddy viscosity, collision, sponge.

    f_i(x, t + 1) = f_i'(x - c_i, t)

Arrays are (19, nx, ny, nz) and (nx, ny, nz) with z fastest: neighbouring threads read neighbouring words of every population.
Memory is addressed by world node modulo size, so that a window moves by changing `origin`, the world node of its low corner.

Bytes a cell and step, FP32: populations 2 x 76 = 152; with eddy viscosity 6 more to write u and about 6 to read it once: three
numbers of 16 bits (storage.py), and the six neighbours come from cache; the same gradient serves the stress. The force is read
inside the body's box only.

`stream_collide(faces, subgrid)` is the kernel for one set of faces (domain_faces.py): a face that is not used costs nothing.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid import in_kernels
from fishmj.lbm_oracle.fluid.collide import density, hybrid_stress, momentum, non_equilibrium_stress, reconstruct, relaxed, wale
from fishmj.lbm_oracle.fluid.domain_faces import FACES, Axis, Source, completes, sources
from fishmj.lbm_oracle.fluid.in_kernels import ramp, vec6, vec6i, vec19, vec19i
from fishmj.lbm_oracle.fluid.inflow import Inflow, background
from fishmj.lbm_oracle.fluid.lattice import C, Q, W
from fishmj.lbm_oracle.fluid.storage import STORAGE, peek, peek3, poke, poke3, six, velocity_type

OPTIONS = {"max_unroll": 32, "enable_backward": False}  # and quick roots and quotients on a GPU where there is an eddy viscosity
Faces = tuple[Axis, Axis, Axis]


@wp.struct
class Params:
    """Parameters of every kernel, in lattice units."""

    nx: int
    ny: int
    nz: int
    planes: vec19i  # where each population begins
    by_ny: wp.vec2i  # what divides by ny and by nz (pairs.py)
    by_nz: wp.vec2i
    low: wp.vec3i  # logical nodes from `low` to below `high` are stepped; the others are read, and another level fills them
    high: wp.vec3i
    nu: float
    omega_bulk: float
    cw2: float  # square of the WALE constant
    hybrid_share: float  # of the stress that the velocity gradient gives
    hybrid_share_layer: float  # the same where the body's force acts
    body_acceleration: wp.vec3  # uniform
    wall_velocity: wp.vec3  # of the moving walls
    sponge: int
    sponge_rate: float


@wp.func
def pick(c: int, back: int, here: int, ahead: int):
    """Coordinate, along one axis, of the node from which a population of velocity c is pulled."""
    if c > 0:
        return back
    if c < 0:
        return ahead
    return here


@wp.func
def hits(c: int, at: int, size: int):
    """True if a population of velocity c arrives through the low or the high face of an axis."""
    return (c > 0 and at == 0) or (c < 0 and at == size - 1)


@wp.func
def within(i: int, n: int):
    """Index i, at most one size out of range, brought back to 0 .. n - 1; cheaper than a division."""
    if i < 0:
        return i + n
    if i >= n:
        return i - n
    return i


@wp.func
def is_ghost(s: Params, at: wp.vec3i):
    """True if another level fills the cell at logical node `at`."""
    outside = at[0] < s.low[0] or at[0] >= s.high[0] or at[1] < s.low[1] or at[1] >= s.high[1]
    return outside or at[2] < s.low[2] or at[2] >= s.high[2]


def pull_through(faces: Faces, number: type):
    """Makes the Warp function that streams: it returns f_i(x - c_i) of all populations, redirected at the faces."""
    redirected = [sources(faces, i) for i in range(Q)]
    gain_of = lambda i, met: getattr(in_kernels, source(i, met).gain)

    def source(i: int, met: int) -> Source:
        return redirected[i].get(met, Source(i, (False, False, False)))

    def meets(i: int, axis: int) -> bool:
        return any(met >> axis & 1 for met in redirected[i])

    @wp.func
    def pull(f: wp.array(dtype=number), s: Params, at: wp.vec3i, m: wp.vec3i):
        """Populations that arrive at logical node `at`, memory node m."""
        ny, nz = s.ny, s.nz
        n = s.nx * ny * nz
        x0, y0, z0 = m[0] * (ny * nz), m[1] * nz, m[2]
        xm, xp = wp.where(m[0] > 0, m[0] - 1, s.nx - 1) * (ny * nz), wp.where(m[0] < s.nx - 1, m[0] + 1, 0) * (ny * nz)
        ym, yp = wp.where(m[1] > 0, m[1] - 1, ny - 1) * nz, wp.where(m[1] < ny - 1, m[1] + 1, 0) * nz
        zm, zp = wp.where(m[2] > 0, m[2] - 1, nz - 1), wp.where(m[2] < nz - 1, m[2] + 1, 0)
        out = vec19()
        out[0] = peek(f, x0 + y0 + z0)
        for i in range(1, wp.static(Q)):
            sx = pick(wp.static(C[i][0]), xm, x0, xp)
            sy = pick(wp.static(C[i][1]), ym, y0, yp)
            sz = pick(wp.static(C[i][2]), zm, z0, zp)
            j = int(i)
            gain = float(0.0)  # noqa: UP018  a variable, not a constant, to Warp
            if wp.static(bool(redirected[i])):
                met = wp.where(wp.static(meets(i, 0)) and hits(wp.static(C[i][0]), at[0], s.nx), 1, 0)
                met += wp.where(wp.static(meets(i, 1)) and hits(wp.static(C[i][1]), at[1], ny), 2, 0)
                met += wp.where(wp.static(meets(i, 2)) and hits(wp.static(C[i][2]), at[2], nz), 4, 0)
                # selections where a node keeps to one axis: neighbouring threads of a GPU take one path, and the load comes last
                for way in range(1, 8):
                    if wp.static(way in redirected[i] and not all(source(i, way).stays)):
                        j = wp.where(met == way, wp.static(source(i, way).population), j)
                        sx = wp.where(wp.static(source(i, way).stays[0]) and met == way, x0, sx)
                        sy = wp.where(wp.static(source(i, way).stays[1]) and met == way, y0, sy)
                        sz = wp.where(wp.static(source(i, way).stays[2]) and met == way, z0, sz)
                if wp.static(any(all(known.stays) for known in redirected[i].values())):
                    if met > 0:  # seldom: without a branch an enclosed box took a sixth longer on a CPU
                        for way in range(1, 8):
                            if wp.static(all(source(i, way).stays)):
                                if met == way:
                                    sx, sy, sz, j = x0, y0, z0, wp.static(source(i, way).population)
                            if wp.static(source(i, way).gain != ""):
                                if met == way:
                                    c = wp.vec3(wp.static(float(C[i][0])), wp.static(float(C[i][1])), wp.static(float(C[i][2])))
                                    gain = wp.static(gain_of(i, way))(wp.static(6.0 * W[i]), c, s.wall_velocity)
            arrived = peek(f, j * n + sx + sy + sz)
            if wp.static(any(known.gain for known in redirected[i].values())):
                arrived += gain
            out[i] = arrived
        return out

    return pull


def leave_through(faces: Faces):
    """Makes two Warp functions for the faces on x and y that complete their nodes: the inner neighbour; the completed moments."""
    (low_x, high_x), (low_y, high_y), _ = (completes(axis) for axis in faces)
    complete = next((getattr(in_kernels, FACES[kind].complete) for axis in faces for kind in axis if FACES[kind].complete), None)

    @wp.func
    def inward(s: Params, at: wp.vec3i):
        x = wp.clamp(at[0], wp.static(int(low_x)), s.nx - 1 - wp.static(int(high_x)))
        y = wp.clamp(at[1], wp.static(int(low_y)), s.ny - 1 - wp.static(int(high_y)))
        return wp.vec3i(x, y, at[2])

    @wp.func
    def leave(s: Params, flow: Inflow, at: wp.vec3i, inner: wp.vec3i, node: wp.vec3i, step: int, drho: float, u: wp.vec3):
        """Density and velocity, the sponge's rate, and the background velocity that it relaxes to."""
        sigma = ramp(wp.static(low_x), wp.static(high_x), at[0], s.nx, s.sponge)
        sigma += ramp(wp.static(low_y), wp.static(high_y), at[1], s.ny, s.sponge)
        sigma = s.sponge_rate * sigma
        target = wp.vec3()
        outer = inner[0] != at[0] or inner[1] != at[1]
        if outer or sigma > 0.0:  # the interior never evaluates the background flow, eight loads of a table
            target = background(flow, wp.vec3(float(node[0]), float(node[1]), float(node[2])), step)
            if outer:
                n = wp.normalize(wp.vec3(float(at[0] - inner[0]), float(at[1] - inner[1]), 0.0))
                drho, u = wp.static(complete)(drho, u, target, n)
        return drho, u, sigma, target

    return inward, leave


def gradient_within(faces: Faces, velocity: type):
    """Makes the Warp function of the velocity gradient, d u / d x, d y, d z in rows, from the last step.

    At a face the node itself replaces its missing neighbour: exact along a slip face, half the shear beside a wall at rest.
    """
    bounded = [not FACES[axis.low].wraps for axis in faces]

    @wp.func
    def velocity_gradient(u: wp.array(dtype=velocity), s: Params, at: wp.vec3i, m: wp.vec3i):
        x, y, z = m[0], m[1], m[2]
        xm, xp = wp.where(x > 0, x - 1, s.nx - 1), wp.where(x < s.nx - 1, x + 1, 0)
        ym, yp = wp.where(y > 0, y - 1, s.ny - 1), wp.where(y < s.ny - 1, y + 1, 0)
        zm, zp = wp.where(z > 0, z - 1, s.nz - 1), wp.where(z < s.nz - 1, z + 1, 0)
        if wp.static(bounded[0]):
            xm, xp = wp.where(at[0] == 0, x, xm), wp.where(at[0] == s.nx - 1, x, xp)
        if wp.static(bounded[1]):
            ym, yp = wp.where(at[1] == 0, y, ym), wp.where(at[1] == s.ny - 1, y, yp)
        if wp.static(bounded[2]):
            zm, zp = wp.where(at[2] == 0, z, zm), wp.where(at[2] == s.nz - 1, z, zp)
        plane, row = s.ny * s.nz, s.nz
        over_y_z, over_x_z, over_x_y = y * row + z, x * plane + z, x * plane + y * row
        return wp.matrix_from_rows(
            0.5 * (peek3(u, xp * plane + over_y_z) - peek3(u, xm * plane + over_y_z)),
            0.5 * (peek3(u, yp * row + over_x_z) - peek3(u, ym * row + over_x_z)),
            0.5 * (peek3(u, zp + over_x_y) - peek3(u, zm + over_x_y)),
        )

    return velocity_gradient


@wp.func
def push_at(s: Params, box: vec6i, force: wp.array(dtype=wp.vec3), node: wp.vec3i, here: int):
    """Acceleration of a world node, uniform plus, inside `box`, the body's; and the share of stress that the gradient gives."""
    push = wp.vec3()
    # the force is loaded in the body's box only: all other nodes save 12 bytes
    if (
        node[0] >= box[0]
        and node[0] < box[3]
        and node[1] >= box[1]
        and node[1] < box[4]
        and node[2] >= box[2]
        and node[2] < box[5]
    ):
        push = peek3(force, here)
    share = wp.where(wp.length_sq(push) == 0.0, s.hybrid_share, s.hybrid_share_layer)
    return s.body_acceleration + push, share


def module_of(faces: Faces, model: str, dtype: str, keeps: str):
    """Warp module with a name of its own; Warp's automatic names ignore static expressions that depend on an unrolled loop."""
    module = wp.get_module(".".join([__name__, *("_".join(axis) for axis in faces), model, dtype, keeps]))
    wp.set_module_options(OPTIONS | {"fast_math": model != "none"}, module)
    return module


def blend_through(subgrid: bool):
    """Makes the Warp function of the subgrid model, for all kernels of a step; it has no branch (rows.py).

    It takes density and stress P of a node before the collision, the velocity gradient d and the share of stress that d gives,
    and returns the hybrid stress and the relaxation rate omega. `relaxed` stays with the callers: inside this function a GPU's
    compiler would contract other products, and the last bits would change.
    """

    @wp.func
    def blend(drho: float, p: vec6, d: wp.mat33, s: Params, share: float):
        nu = s.nu
        if wp.static(subgrid):  # from the last step's velocity: this step's neighbours are being written by other threads
            nu += wale(d[0], d[1], d[2], s.cw2)
            p = hybrid_stress(p, d[0], d[1], d[2], (1.0 + drho) * (0.5 + 3.0 * nu), share)
        return p, 1.0 / (0.5 + 3.0 * nu)

    return blend


def update_through(faces: Faces, subgrid: bool):
    """Makes the Warp function that updates a cell: pulled populations q, velocity gradient d -> stored populations, velocity."""
    opened = any(any(completes(axis)) for axis in faces)
    _, leave = leave_through(faces)
    blend = blend_through(subgrid)

    @wp.func
    def update(
        q: vec19,
        d: wp.mat33,
        s: Params,
        flow: Inflow,
        at: wp.vec3i,
        inner: wp.vec3i,
        node: wp.vec3i,
        step: int,
        g: wp.vec3,
        share: float,
    ):
        drho = density(q)  # of the pulled populations: ten moments are all that the collision needs of nineteen
        u = (1.0 / (1.0 + drho)) * momentum(q)
        p = non_equilibrium_stress(q, drho, u)
        sigma = float(0.0)  # noqa: UP018
        target = wp.vec3()
        if wp.static(opened):
            drho, u, sigma, target = leave(s, flow, at, inner, node, step + 1, drho, u)
        p, omega = blend(drho, p, d, s, share)
        p = relaxed(p, omega, s.omega_bulk)
        v = u + g  # exact difference: f_eq(u + G) - f_eq(u), without a half-force correction of P (collide.py)
        if wp.static(opened):
            if sigma > 0.0:  # in moments, P among them: at sigma = 1 the node would be the background's equilibrium
                drho -= sigma * drho
                u += sigma * (target - u)
                v += sigma * (target - v)
                p *= 1.0 - sigma
        return reconstruct(drho, u, v, p), 0.5 * (u + v)  # u + G / 2, the second-order velocity of the water

    return update


@cache
def stream_collide(faces: Faces, subgrid: bool, dtype: str = "float32", keeps: bool = True) -> wp.Kernel:
    """Kernel for these faces of x, y and z; `subgrid` adds eddy viscosity and hybrid stress.

    `dtype` is the storage of the populations. `keeps`: store the velocity of each step, which the next step needs for `subgrid`.
    """
    number, velocity = STORAGE[dtype], velocity_type(subgrid)
    module = module_of(faces, "wale" if subgrid else "none", dtype, "u" if keeps else "f")
    pull, velocity_gradient = pull_through(faces, number), gradient_within(faces, velocity)
    opened = any(any(completes(axis)) for axis in faces)
    inward, update = leave_through(faces)[0], update_through(faces, subgrid)

    @wp.kernel(module=module, grid_stride=False)
    def stream_collide(
        start: int,
        s: Params,
        flow: Inflow,
        origin: wp.array(dtype=int),
        box: wp.array(dtype=int),
        clock: wp.array(dtype=int),
        f: wp.array(dtype=number),
        u_old: wp.array(dtype=velocity),
        force: wp.array(dtype=wp.vec3),
        f_next: wp.array(dtype=number),
        u_next: wp.array(dtype=velocity),
        clock_next: wp.array(dtype=int),
    ):
        here = start + wp.tid()
        column = here / s.nz
        m = wp.vec3i(column / s.ny, column % s.ny, here % s.nz)
        step = clock[0]
        if here == 0:
            clock_next[0] = step + 1
        at = wp.vec3i(within(m[0] - origin[3], s.nx), within(m[1] - origin[4], s.ny), within(m[2] - origin[5], s.nz))
        if is_ghost(s, at):
            return
        node = wp.vec3i(at[0] + origin[0], at[1] + origin[1], at[2] + origin[2])

        inner, inner_m = at, m
        if wp.static(opened):
            inner = inward(s, at)
            inner_m = wp.vec3i(within(m[0] + inner[0] - at[0], s.nx), within(m[1] + inner[1] - at[1], s.ny), m[2])
        q = pull(f, s, inner, inner_m)
        d = wp.mat33()
        if wp.static(subgrid):
            d = velocity_gradient(u_old, s, at, m)
        g, share = push_at(s, six(box), force, node, here)
        q, w = update(q, d, s, flow, at, inner, node, step, g, share)
        n_cells = s.nx * s.ny * s.nz
        for i in range(wp.static(Q)):
            # static: a deferred expression here makes Warp hash the expressions of `pull`, so that it never takes a stale kernel
            poke(f_next, wp.static(i) * n_cells + here, q[i])
        if wp.static(keeps):
            poke3(u_next, here, w)

    return stream_collide
