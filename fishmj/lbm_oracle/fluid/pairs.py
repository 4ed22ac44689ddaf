"""The step of the fluid for an accelerator, two cells of z for each thread: fewer instructions, wider loads, the same numbers.

Nine of the nineteen populations do not cross z: one aligned load brings those of two neighbours. Each of the nineteen goes out in
one aligned store. The offsets are computed once for both cells, without a division (`split_by`), and the data that all threads
read (origin, the body's box) takes two loads. Every other step goes through memory backwards (`turn`), because the last writes of
a step are still in the cache when the next step begins with them.

One H200, paper's box, relative to one cell for each thread in the same run: +7 % bare, +15 % with eddy viscosity and open faces,
+26 % in 16 bits (docs/solver/results.md, "Speed"). Needs an even number of cells along z.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid import in_kernels
from fishmj.lbm_oracle.fluid.domain_faces import FACES, Source, completes, sources
from fishmj.lbm_oracle.fluid.in_kernels import vec19
from fishmj.lbm_oracle.fluid.inflow import Inflow
from fishmj.lbm_oracle.fluid.lattice import C, Q, W
from fishmj.lbm_oracle.fluid.step import (
    Faces,
    Params,
    hits,
    is_ghost,
    leave_through,
    module_of,
    pick,
    push_at,
    update_through,
    within,
)
from fishmj.lbm_oracle.fluid.storage import STORAGE, peek, peek3, peek3_pair, peek_pair, poke3_pair, poke_pair, six, velocity_type


@wp.func_native("return (unsigned long long)(unsigned int)n * (unsigned int)by_magic >> shift;")
def quotient(n: int, by_magic: int, shift: int) -> int:
    """Integer quotient n // divisor by one multiplication and a shift; `by_magic` and `shift` come from `split_by(divisor)`."""
    ...


def split_by(divisor: int) -> tuple[int, int]:
    """Multiplier and shift (m, s) with n // divisor = n m >> s for all 0 <= n < 2^31; m as the signed number of its 32 bits.

    s = 31 + l, m = ceil(2^s / divisor), 2^(l - 1) < divisor <= 2^l. m exceeds 2^s / divisor by less than one, so n m / 2^s
    exceeds n / divisor by less than 1 / divisor.
    """
    bits = 31 + (divisor - 1).bit_length()
    magic = -(-(1 << bits) // divisor)
    return (magic if magic < 2**31 else magic - 2**32), bits


def pull_pair_through(faces: Faces, number: type):
    """Makes `step.pull_through` for the node `at` and the next one in memory, whose logical z is `next_z`."""
    redirected = [sources(faces, i) for i in range(Q)]
    gain_of = lambda i, met: getattr(in_kernels, source(i, met).gain)

    def source(i: int, met: int) -> Source:
        return redirected[i].get(met, Source(i, (False, False, False)))

    def meets(i: int, axis: int) -> bool:
        return any(met >> axis & 1 for met in redirected[i])

    @wp.func
    def pull(f: wp.array(dtype=number), s: Params, at: wp.vec3i, next_z: int, m: wp.vec3i):
        ny, nz = s.ny, s.nz
        x0, y0 = m[0] * (ny * nz), m[1] * nz
        xm, xp = wp.where(m[0] > 0, m[0] - 1, s.nx - 1) * (ny * nz), wp.where(m[0] < s.nx - 1, m[0] + 1, 0) * (ny * nz)
        ym, yp = wp.where(m[1] > 0, m[1] - 1, ny - 1) * nz, wp.where(m[1] < ny - 1, m[1] + 1, 0) * nz
        za, zb = m[2], m[2] + 1
        zm, zp = wp.where(za > 0, za - 1, nz - 1), wp.where(zb < nz - 1, zb + 1, 0)
        a, b = vec19(), vec19()
        for i in range(wp.static(Q)):
            for second in range(2):
                if wp.static(C[i][2] != 0) or wp.static(second == 0):  # what does not cross z comes for both at once
                    z0, at_z = wp.where(wp.static(second == 1), zb, za), wp.where(wp.static(second == 1), next_z, at[2])
                    back, ahead = wp.where(wp.static(second == 1), za, zm), wp.where(wp.static(second == 1), zp, zb)
                    sx = pick(wp.static(C[i][0]), xm, x0, xp)
                    sy = pick(wp.static(C[i][1]), ym, y0, yp)
                    sz = pick(wp.static(C[i][2]), back, z0, ahead)
                    j = s.planes[i]
                    gain = float(0.0)  # noqa: UP018  a variable, not a constant, to Warp
                    if wp.static(bool(redirected[i])):
                        met = wp.where(wp.static(meets(i, 0)) and hits(wp.static(C[i][0]), at[0], s.nx), 1, 0)
                        met += wp.where(wp.static(meets(i, 1)) and hits(wp.static(C[i][1]), at[1], ny), 2, 0)
                        met += wp.where(wp.static(meets(i, 2)) and hits(wp.static(C[i][2]), at_z, nz), 4, 0)
                        for way in range(1, 8):
                            if wp.static(way in redirected[i]):
                                j = wp.where(met == way, s.planes[wp.static(source(i, way).population)], j)
                                sx = wp.where(wp.static(source(i, way).stays[0]) and met == way, x0, sx)
                                sy = wp.where(wp.static(source(i, way).stays[1]) and met == way, y0, sy)
                                sz = wp.where(wp.static(source(i, way).stays[2]) and met == way, z0, sz)
                            if wp.static(source(i, way).gain != ""):
                                if met == way:
                                    c = wp.vec3(wp.static(float(C[i][0])), wp.static(float(C[i][1])), wp.static(float(C[i][2])))
                                    gain = wp.static(gain_of(i, way))(wp.static(6.0 * W[i]), c, s.wall_velocity)
                    if wp.static(C[i][2] == 0):
                        both = peek_pair(f, j + sx + sy + za)
                        a[i] = both[0]
                        b[i] = both[1]
                    elif wp.static(second == 0):
                        a[i] = peek(f, j + sx + sy + sz)
                    else:
                        b[i] = peek(f, j + sx + sy + sz)
                    if wp.static(any(known.gain for known in redirected[i].values())):
                        if wp.static(second == 0):
                            a[i] = a[i] + gain
                        if wp.static(second == 1 or C[i][2] == 0):
                            b[i] = b[i] + gain
        return a, b

    return pull


def gradient_pair_within(faces: Faces, velocity: type):
    """Makes `step.gradient_within` for two cells."""
    bounded = [not FACES[axis.low].wraps for axis in faces]

    @wp.func
    def velocity_gradient(u: wp.array(dtype=velocity), s: Params, at: wp.vec3i, next_z: int, m: wp.vec3i):
        x, y, z = m[0], m[1], m[2]
        xm, xp = wp.where(x > 0, x - 1, s.nx - 1), wp.where(x < s.nx - 1, x + 1, 0)
        ym, yp = wp.where(y > 0, y - 1, s.ny - 1), wp.where(y < s.ny - 1, y + 1, 0)
        zm, zp = wp.where(z > 0, z - 1, s.nz - 1), wp.where(z + 2 < s.nz, z + 2, 0)
        if wp.static(bounded[0]):
            xm, xp = wp.where(at[0] == 0, x, xm), wp.where(at[0] == s.nx - 1, x, xp)
        if wp.static(bounded[1]):
            ym, yp = wp.where(at[1] == 0, y, ym), wp.where(at[1] == s.ny - 1, y, yp)
        plane, row = s.ny * s.nz, s.nz
        over_y_z, over_x_z, over_x_y = y * row + z, x * plane + z, x * plane + y * row
        along_x = 0.5 * (peek3_pair(u, xp * plane + over_y_z) - peek3_pair(u, xm * plane + over_y_z))
        along_y = 0.5 * (peek3_pair(u, yp * row + over_x_z) - peek3_pair(u, ym * row + over_x_z))
        own, below, above = peek3_pair(u, over_x_y + z), peek3(u, over_x_y + zm), peek3(u, over_x_y + zp)
        first, second = own[0], own[1]
        over_first, under_second = second, first
        if wp.static(bounded[2]):
            below, above = wp.where(at[2] == 0, first, below), wp.where(next_z == s.nz - 1, second, above)
            over_first = wp.where(at[2] == s.nz - 1, first, over_first)  # of a window that was moved up or down
            under_second = wp.where(next_z == 0, second, under_second)
        a = wp.matrix_from_rows(along_x[0], along_y[0], 0.5 * (over_first - below))
        b = wp.matrix_from_rows(along_x[1], along_y[1], 0.5 * (above - under_second))
        return a, b

    return velocity_gradient


@cache
def stream_collide_pairs(faces: Faces, subgrid: bool, dtype: str = "float32", keeps: bool = True) -> wp.Kernel:
    """Kernel of `step.stream_collide` for an accelerator. Thread t has the cells 2 t and 2 t + 1.

    t counts up from the first argument, or down from the second if that is not negative.
    """
    number, velocity = STORAGE[dtype], velocity_type(subgrid)
    module = module_of(faces, "wale" if subgrid else "none", dtype, "u_pairs" if keeps else "f_pairs")
    pull, velocity_gradient = pull_pair_through(faces, number), gradient_pair_within(faces, velocity)
    opened = any(any(completes(axis)) for axis in faces)
    inward, update = leave_through(faces)[0], update_through(faces, subgrid)

    @wp.kernel(module=module, grid_stride=False)
    def stream_collide_pairs(
        start: int,
        turn: int,
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
        here = 2 * wp.where(turn < 0, start + wp.tid(), turn - wp.tid())
        o, b = six(origin), six(box)
        column = quotient(here, s.by_nz[0], s.by_nz[1])
        x = quotient(column, s.by_ny[0], s.by_ny[1])
        m = wp.vec3i(x, column - x * s.ny, here - column * s.nz)
        step = clock[0]
        if here == 0:
            clock_next[0] = step + 1
        at = wp.vec3i(within(m[0] - o[3], s.nx), within(m[1] - o[4], s.ny), within(m[2] - o[5], s.nz))
        next_at = wp.vec3i(at[0], at[1], within(m[2] + 1 - o[5], s.nz))
        if is_ghost(s, at):  # so is the next: what is stepped of a row begins at an even place
            return
        node = wp.vec3i(at[0] + o[0], at[1] + o[1], at[2] + o[2])
        next_node = wp.vec3i(node[0], node[1], next_at[2] + o[2])

        inner, inner_m = at, m
        if wp.static(opened):
            inner = inward(s, at)
            inner_m = wp.vec3i(within(m[0] + inner[0] - at[0], s.nx), within(m[1] + inner[1] - at[1], s.ny), m[2])
        next_inner = wp.vec3i(inner[0], inner[1], next_at[2])
        q, next_q = pull(f, s, inner, next_at[2], inner_m)
        d, next_d = wp.mat33(), wp.mat33()
        if wp.static(subgrid):
            d, next_d = velocity_gradient(u_old, s, at, next_at[2], m)
        g, share = push_at(s, b, force, node, here)
        next_g, next_share = push_at(s, b, force, next_node, here + 1)
        q, w = update(q, d, s, flow, at, inner, node, step, g, share)
        next_q, next_w = update(next_q, next_d, s, flow, next_at, next_inner, next_node, step, next_g, next_share)
        for i in range(wp.static(Q)):
            poke_pair(f_next, s.planes[i] + here, q[i], next_q[i])
        if wp.static(keeps):
            poke3_pair(u_next, here, w, next_w)

    return stream_collide_pairs
