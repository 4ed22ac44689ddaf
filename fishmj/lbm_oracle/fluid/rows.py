"""The step of the fluid for a CPU, a plane of x for each thread, in blocks of rows: identical to the bit to the plain kernel.

Memory: a core that reads nineteen rows of 120 bytes and writes nineteen waits for most of them, because few cache lines are under
way at once. A thread therefore copies a block of up to `CELLS` cells, whole rows where they fit, into a buffer, one population
after the other, collides it, and copies the results out. While a row is collided, the same row of the next block and the places
of this row's results are asked for (`prefetch`).

Vector registers: a compiler vectorises a loop that has no branch, no store that could alias a load, and a plain count. Rows lie
in the buffer as in memory, and the last vector of a row runs on into the next one, which is written later. Everything with a
branch stays outside the loop: cells that a face redirects, the body's force, the background flow of the sponge.

The compiler needs three things. Loops are `while` loops, because Warp's `range` hides the count. Base and index are separate
arguments. Velocities are read by component and `wp.where` acts on single numbers, because vectors of three become wide loads
that the compiler does not split again.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid import in_kernels
from fishmj.lbm_oracle.fluid.collide import density, momentum, non_equilibrium_stress, reconstruct, relaxed
from fishmj.lbm_oracle.fluid.domain_faces import FACES, completes, sources
from fishmj.lbm_oracle.fluid.in_kernels import ramp, vec19, vec19i
from fishmj.lbm_oracle.fluid.inflow import STEADY, Inflow, background
from fishmj.lbm_oracle.fluid.lattice import C, Q, W
from fishmj.lbm_oracle.fluid.step import (
    Faces,
    Params,
    blend_through,
    gradient_within,
    leave_through,
    module_of,
    pick,
    pull_through,
    within,
)
from fishmj.lbm_oracle.fluid.storage import (
    CELLS_AT_ONCE,
    STORAGE,
    copy_cells,
    peek3_at,
    peek_at,
    poke3_at,
    poke_at,
    prefetch,
    velocity_type,
)

CELLS = 256  # of a block, at most: with 128, 192 and 336 the laptop's preset had 0.68, 0.76 and 0.88 of the rate
WIDTH = CELLS_AT_ONCE
MOST = 16  # rows of a block
LONG, WIDE, TALL = wp.constant(CELLS), wp.constant(WIDTH), wp.constant(MOST)
ROOM = wp.constant(CELLS + WIDTH)  # of a population in a block: the last row goes on, too
Heights = wp.types.vector(length=3 * MOST, dtype=wp.int32)


def branchless_update_through(faces: Faces, subgrid: bool):
    """Makes `step.update_through` without a branch. `outer`: an open face with normal n completes the cell."""
    opened = any(any(completes(axis)) for axis in faces)
    complete = next((getattr(in_kernels, FACES[kind].complete) for axis in faces for kind in axis if FACES[kind].complete), None)
    blend = blend_through(subgrid)

    @wp.func
    def update(
        q: vec19, d: wp.mat33, s: Params, push: wp.vec3, damped: bool, sigma: float, target: wp.vec3, outer: bool, n: wp.vec3
    ):
        drho = density(q)
        u = (1.0 / (1.0 + drho)) * momentum(q)
        p = non_equilibrium_stress(q, drho, u)
        if wp.static(opened):
            own_drho, own_u = wp.static(complete)(drho, wp.vec3(u[0], u[1], u[2]), target, n)
            drho = wp.where(outer, own_drho, drho)
            for a in range(3):
                u[a] = wp.where(outer, own_u[a], u[a])
        share = wp.where(push[0] * push[0] + push[1] * push[1] + push[2] * push[2] == 0.0, s.hybrid_share, s.hybrid_share_layer)
        p, omega = blend(drho, p, d, s, share)
        p = relaxed(p, omega, s.omega_bulk)
        v = u + (s.body_acceleration + push)
        if wp.static(opened):
            drho = wp.where(damped, drho - sigma * drho, drho)
            for a in range(3):
                u[a] = wp.where(damped, u[a] + sigma * (target[a] - u[a]), u[a])
                v[a] = wp.where(damped, v[a] + sigma * (target[a] - v[a]), v[a])
            for a in range(6):
                p[a] = wp.where(damped, p[a] * (1.0 - sigma), p[a])
        return reconstruct(drho, u, v, p), 0.5 * (u + v)

    return update


@cache
def stream_collide_rows(faces: Faces, subgrid: bool, dtype: str = "float32", keeps: bool = True) -> wp.Kernel:
    """Kernel of `step.stream_collide` for a CPU; a thread has a plane of x."""
    number, velocity = STORAGE[dtype], velocity_type(subgrid)
    module = module_of(faces, "wale" if subgrid else "none", dtype, "u_rows" if keeps else "f_rows")
    pull, velocity_gradient = pull_through(faces, number), gradient_within(faces, velocity)
    opened = any(any(completes(axis)) for axis in faces)
    inward, update = leave_through(faces)[0], branchless_update_through(faces, subgrid)
    (low_x, high_x), (low_y, high_y), _ = (completes(axis) for axis in faces)
    wraps = [FACES[axis.low].wraps for axis in faces]
    mirrors = {i: found[4] for i in range(Q) if 4 in (found := sources(faces, i))}  # what meets only the face above or below

    @wp.kernel(module=module, grid_stride=False)
    def stream_collide_rows(
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
        x = start + wp.tid()
        step = clock[0]
        if x == 0:
            clock_next[0] = step + 1
        nx, ny, nz = s.nx, s.ny, s.nz
        plane = ny * nz
        cells = nx * plane
        x0 = x * plane
        at_x = within(x - origin[3], nx)
        node_x = at_x + origin[0]
        if at_x < s.low[0] or at_x >= s.high[0]:
            return
        xm, xp = wp.where(x > 0, x - 1, nx - 1) * plane, wp.where(x < nx - 1, x + 1, 0) * plane
        if wp.static(not wraps[0]):
            xm, xp = wp.where(at_x == 0, x0, xm), wp.where(at_x == nx - 1, x0, xp)
        low_z = within(origin[5], nz)  # where the lowest cell of the window lies in memory, and behind it the highest
        high_z = within(low_z + nz - 1, nz)
        # an open face completes the moments of the inner neighbour
        inner_x = x
        if wp.static(opened):
            inner_x = within(x + inward(s, wp.vec3i(at_x, 0, 0))[0] - at_x, nx)
        from_x = inner_x * plane
        from_xm, from_xp = wp.where(inner_x > 0, inner_x - 1, nx - 1) * plane, wp.where(inner_x < nx - 1, inner_x + 1, 0) * plane
        bases, levels = vec19i(), vec19i()
        for i in range(wp.static(Q)):
            bases[i] = wp.static(i) * cells + pick(wp.static(C[i][0]), from_xm, from_x, from_xp) - wp.static(C[i][2])
            levels[i] = pick(wp.static(C[i][1]), TALL, 0, 2 * TALL)
        # the stepped part of a row, in two pieces if it wraps round; all rows are stepped: a store may run on into the next one
        span = s.high[2] - s.low[2]
        begin = wp.where(span == nz, 0, within(low_z + s.low[2], nz))
        end = begin + span
        every = s.low[1] == 0 and s.high[1] == ny and span == nz
        tall = wp.clamp(LONG / nz, 1, TALL)
        far = wp.min(tall * nz, LONG)  # cells from a block to the next
        populations = wp.zeros(shape=(wp.static(Q * (CELLS + WIDTH)),), dtype=float)
        results = wp.zeros(shape=(wp.static(Q * (CELLS + WIDTH)),), dtype=float)
        gradients = wp.zeros(shape=(wp.static(9 * CELLS),), dtype=float)
        pushes = wp.zeros(shape=(wp.static(3 * CELLS),), dtype=float)
        targets = wp.zeros(shape=(wp.static(3 * CELLS),), dtype=float)
        velocities = wp.zeros(shape=(wp.static(3 * CELLS),), dtype=float)
        heights = Heights()

        k = int(0)  # noqa: UP018
        steady = flow.kind == STEADY
        while wp.static(opened) and k < LONG:
            for a in range(3):
                poke_at(targets, wp.static(a) * LONG, k, flow.mean[a])
            k += 1

        lowest = int(0)  # noqa: UP018
        while lowest < ny:
            rows = wp.min(tall, ny - lowest)
            gaps = wp.vec3i()  # rows that do not follow the one before in memory
            r = int(0)  # noqa: UP018
            while r < rows:
                y = lowest + r
                at_y = within(y - origin[4], ny)
                if wp.static(opened):
                    y = within(y + inward(s, wp.vec3i(at_x, at_y, 0))[1] - at_y, ny)
                heights[r] = y * nz
                heights[TALL + r] = wp.where(y > 0, y - 1, ny - 1) * nz
                heights[2 * TALL + r] = wp.where(y < ny - 1, y + 1, 0) * nz
                for a in range(3):
                    if r > 0 and heights[a * TALL + r] != heights[a * TALL + r - 1] + nz:
                        gaps[a] = gaps[a] + 1
                r += 1
            first = int(0)  # noqa: UP018
            while first < nz:
                count = wp.min(LONG, nz - first)
                whole = (count + WIDE - 1) / WIDE * WIDE
                # in memory order, in whole vectors except at the end; what wraps or is redirected follows row by row
                i = int(0)  # noqa: UP018
                while i < wp.static(Q):
                    together = gaps[levels[i] / TALL] == 0
                    runs, length = wp.where(together, 1, rows), wp.where(together, (rows - 1) * nz + count, count)
                    r = int(0)  # noqa: UP018
                    while r < runs:
                        base = bases[i] + heights[levels[i] + r] + first
                        to = i * ROOM + r * nz
                        last = wp.min((length + WIDE - 1) / WIDE * WIDE, Q * cells - base)
                        k = int(0)  # noqa: UP018
                        while k + WIDE <= last:
                            copy_cells(f, base + k, populations, to + k)
                            k += WIDE
                        while k < last:
                            poke_at(populations, to, k, peek_at(f, base, k))
                            k += 1
                        r += 1
                    i += 1

                r = int(0)  # noqa: UP018
                while r < rows:
                    y = lowest + r
                    at_y = within(y - origin[4], ny)
                    node_y = at_y + origin[1]
                    y0 = y * nz
                    row, at_r = x0 + y0, r * nz
                    inner, inner_y = wp.vec3i(at_x, at_y, 0), y
                    i = int(0)  # noqa: UP018
                    while i < wp.static(Q):
                        k = int(0)  # noqa: UP018
                        while k < count:
                            ahead = bases[i] + heights[levels[i] + r] + first + far + k
                            prefetch(f, ahead, f_next, i * cells + row + first + k)
                            k += WIDE
                        i += 1
                    if wp.static(keeps):
                        k = int(0)  # noqa: UP018
                        while k < count:
                            prefetch(u_old, xp + y0 + first + nz + k, u_next, row + first + nz + k)
                            k += WIDE
                    outer, n = False, wp.vec3()
                    if wp.static(opened):
                        inner = inward(s, inner)
                        inner_y = within(y + inner[1] - at_y, ny)
                        outer = inner_x != x or inner_y != y
                        if outer:
                            n = wp.normalize(wp.vec3(float(at_x - inner[0]), float(at_y - inner[1]), 0.0))
                    edge = wp.static(not wraps[0]) and (inner[0] == 0 or inner[0] == nx - 1)
                    edge = edge or (wp.static(not wraps[1]) and (inner[1] == 0 or inner[1] == ny - 1))
                    if edge:
                        k = int(0)  # noqa: UP018
                        while k < count:
                            z = within(first + k - origin[5], nz)
                            q = pull(f, s, wp.vec3i(inner[0], inner[1], z), wp.vec3i(inner_x, inner_y, first + k))
                            for i in range(wp.static(Q)):
                                poke_at(populations, wp.static(i) * ROOM + at_r, k, q[i])
                            k += 1
                    else:
                        from_y, from_ym, from_yp = heights[r], heights[TALL + r], heights[2 * TALL + r]
                        for i in range(wp.static(Q)):
                            if wp.static(C[i][2] != 0):
                                z = wp.where(wp.static(C[i][2] > 0), 0, nz - 1)  # here the path wraps round in memory
                                if z >= first and z < first + count:
                                    other = bases[i] + heights[levels[i] + r] + wp.static(C[i][2]) + (nz - 1 - z)
                                    poke_at(populations, wp.static(i) * ROOM + at_r, z - first, peek_at(f, other, 0))
                            if wp.static(i in mirrors):
                                z = wp.where(wp.static(C[i][2] > 0), low_z, high_z)
                                if z >= first and z < first + count:
                                    sx = pick(wp.static(0 if mirrors[i].stays[0] else C[i][0]), from_xm, from_x, from_xp)
                                    sy = pick(wp.static(0 if mirrors[i].stays[1] else C[i][1]), from_ym, from_y, from_yp)
                                    arrived = peek_at(f, wp.static(mirrors[i].population) * cells + sx + sy, z)
                                    if wp.static(mirrors[i].gain != ""):
                                        c = wp.vec3(
                                            wp.static(float(C[i][0])), wp.static(float(C[i][1])), wp.static(float(C[i][2]))
                                        )
                                        gain = wp.static(getattr(in_kernels, mirrors[i].gain))
                                        arrived += gain(wp.static(6.0 * W[i]), c, s.wall_velocity)
                                    poke_at(populations, wp.static(i) * ROOM + at_r, z - first, arrived)
                    if wp.static(subgrid):
                        ym, yp = wp.where(y > 0, y - 1, ny - 1) * nz, wp.where(y < ny - 1, y + 1, 0) * nz
                        if wp.static(not wraps[1]):
                            ym, yp = wp.where(at_y == 0, y0, ym), wp.where(at_y == ny - 1, y0, yp)
                        top = wp.max(wp.max(wp.max(xm, xp) + y0, x0 + wp.max(ym, yp)), row)
                        k = int(0)  # noqa: UP018
                        if row + first == 0 or top + first + whole >= cells:  # too near to an end of the array
                            while k < count:
                                z = first + k
                                at = wp.vec3i(at_x, at_y, within(z - origin[5], nz))
                                d = velocity_gradient(u_old, s, at, wp.vec3i(x, y, z))
                                for a in range(9):
                                    poke_at(gradients, wp.static(a) * LONG, k, d[wp.static(a // 3), wp.static(a % 3)])
                                k += 1
                        else:
                            here = row + first
                            while k < whole:
                                for a in range(3):
                                    east, west = peek3_at(u_old, xp + y0 + first, k, a), peek3_at(u_old, xm + y0 + first, k, a)
                                    north, south = peek3_at(u_old, x0 + yp + first, k, a), peek3_at(u_old, x0 + ym + first, k, a)
                                    above, below = peek3_at(u_old, here + 1, k, a), peek3_at(u_old, here - 1, k, a)
                                    poke_at(gradients, wp.static(a) * LONG, k, 0.5 * (east - west))
                                    poke_at(gradients, wp.static(3 + a) * LONG, k, 0.5 * (north - south))
                                    poke_at(gradients, wp.static(6 + a) * LONG, k, 0.5 * (above - below))
                                k += 1
                            e = int(0)  # noqa: UP018
                            while e < wp.where(wp.static(wraps[2]) or low_z == 0, 2, 4):
                                z = wp.where(e < 2, wp.where(e == 0, 0, nz - 1), wp.where(e == 2, low_z, high_z))
                                if z >= first and z < first + count:
                                    zm, zp = wp.where(z > 0, z - 1, nz - 1), wp.where(z < nz - 1, z + 1, 0)
                                    if wp.static(not wraps[2]):
                                        zm, zp = wp.where(z == low_z, z, zm), wp.where(z == high_z, z, zp)
                                    for a in range(3):
                                        above, below = peek3_at(u_old, row + zp, 0, a), peek3_at(u_old, row + zm, 0, a)
                                        poke_at(gradients, wp.static(6 + a) * LONG, z - first, 0.5 * (above - below))
                                e += 1
                    sigma = float(0.0)  # noqa: UP018  a variable to Warp
                    if wp.static(opened):
                        sigma = ramp(wp.static(low_x), wp.static(high_x), at_x, nx, s.sponge)
                        sigma += ramp(wp.static(low_y), wp.static(high_y), at_y, ny, s.sponge)
                        sigma = s.sponge_rate * sigma
                    damped = sigma > 0.0
                    pushed = node_x >= box[0] and node_x < box[3] and node_y >= box[1] and node_y < box[4]
                    k = int(0)  # noqa: UP018
                    if pushed or (not steady and (damped or outer)):
                        while k < count:
                            node_z = within(first + k - origin[5], nz) + origin[2]
                            if pushed and node_z >= box[2] and node_z < box[5]:
                                for a in range(3):
                                    poke_at(pushes, wp.static(a) * LONG, k, peek3_at(force, row + first, k, a))
                            if wp.static(opened):
                                if not steady and (damped or outer):
                                    target = background(flow, wp.vec3(float(node_x), float(node_y), float(node_z)), step + 1)
                                    for a in range(3):
                                        poke_at(targets, wp.static(a) * LONG, k, target[a])
                            k += 1

                    k = int(0)  # noqa: UP018
                    while k < whole:
                        q = vec19()
                        for i in range(wp.static(Q)):
                            q[i] = peek_at(populations, wp.static(i) * ROOM + at_r, k)
                        d = wp.mat33()
                        for a in range(9):
                            d[wp.static(a // 3), wp.static(a % 3)] = peek_at(gradients, wp.static(a) * LONG, k)
                        push = wp.vec3(peek_at(pushes, 0, k), peek_at(pushes, LONG, k), peek_at(pushes, 2 * LONG, k))
                        target = wp.vec3(peek_at(targets, 0, k), peek_at(targets, LONG, k), peek_at(targets, 2 * LONG, k))
                        q, w = update(q, d, s, push, damped, sigma, target, outer, n)
                        for i in range(wp.static(Q)):
                            poke_at(results, wp.static(i) * ROOM + at_r, k, q[i])
                        for a in range(3):
                            poke_at(velocities, wp.static(a) * LONG, k, w[a])
                        k += 1
                    if pushed:
                        k = int(0)  # noqa: UP018
                        while k < whole:
                            for a in range(3):
                                poke_at(pushes, wp.static(a) * LONG, k, 0.0)
                            k += 1
                    if wp.static(keeps):
                        if at_y >= s.low[1] and at_y < s.high[1]:
                            k = wp.max(begin - first, 0)
                            last = wp.where(every, wp.min(whole, (ny - y) * nz - first), wp.min(end - first, count))
                            while k < last:
                                for a in range(3):
                                    poke3_at(u_next, row + first, k, a, peek_at(velocities, wp.static(a) * LONG, k))
                                k += 1
                            k = int(0)  # noqa: UP018
                            last = wp.min(end - nz - first, count)
                            while k < last:
                                for a in range(3):
                                    poke3_at(u_next, row + first, k, a, peek_at(velocities, wp.static(a) * LONG, k))
                                k += 1
                    r += 1

                runs, length = wp.where(every, 1, rows), wp.where(every, (rows - 1) * nz + count, count)
                if every:  # whole vectors, but never into the next plane: another thread steps it
                    length = wp.min((length + WIDE - 1) / WIDE * WIDE, (ny - lowest) * nz - first)
                i = int(0)  # noqa: UP018
                while i < wp.static(Q):
                    r = int(0)  # noqa: UP018
                    while r < runs:
                        at_y = within(lowest + r - origin[4], ny)
                        if at_y >= s.low[1] and at_y < s.high[1]:
                            base, out = i * cells + x0 + (lowest + r) * nz + first, i * ROOM + r * nz
                            k = wp.max(begin - first, 0)
                            last = wp.where(every, length, wp.min(end - first, count))
                            while k + WIDE <= last:
                                copy_cells(results, out + k, f_next, base + k)
                                k += WIDE
                            while k < last:
                                poke_at(f_next, base, k, peek_at(results, out, k))
                                k += 1
                            k = int(0)  # noqa: UP018
                            last = wp.min(end - nz - first, count)
                            while k < last:
                                poke_at(f_next, base, k, peek_at(results, out, k))
                                k += 1
                        r += 1
                    i += 1
                first += LONG
            lowest += tall

    return stream_collide_rows
