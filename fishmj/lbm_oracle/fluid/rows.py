"""The step of the fluid for a CPU, one row of z for each thread: cells side by side in vector registers, identical to the bit.

A compiler vectorises a loop that has no branch, no store that could alias a load, and a plain count. A thread therefore loads up
to `LONG` cells of its row into a buffer, collides them in one such loop, and stores them. Everything with a branch stays outside
the loop: cells that a face redirects, the body's force, the background flow of the sponge.

The compiler needs three things. Loops are `while` loops, because Warp's `range` hides the count. Base and index are separate
arguments. Velocities are read by component and `wp.where` acts on single numbers, because vectors of three become wide loads
that the compiler does not split again.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid import in_kernels
from fishmj.lbm_oracle.fluid.collide import density, momentum, non_equilibrium_stress, reconstruct, relaxed
from fishmj.lbm_oracle.fluid.domain_faces import FACES, completes
from fishmj.lbm_oracle.fluid.in_kernels import ramp, vec19, vec19i
from fishmj.lbm_oracle.fluid.inflow import Inflow, background
from fishmj.lbm_oracle.fluid.lattice import C, Q
from fishmj.lbm_oracle.fluid.step import (
    Faces,
    Params,
    blend_through,
    gradient_within,
    is_ghost,
    leave_through,
    module_of,
    pick,
    pull_through,
    within,
)
from fishmj.lbm_oracle.fluid.storage import STORAGE, peek3_at, peek_at, poke3_at, poke_at, velocity_type

CELLS = 32  # that are collided at once
WIDTH = 8  # numbers in a vector register, at most: the loop goes on to a multiple of it and what is too much is not stored
LONG = wp.constant(CELLS)
Populations = wp.types.vector(length=Q * CELLS, dtype=wp.float32)
Gradients = wp.types.vector(length=9 * CELLS, dtype=wp.float32)
Velocities = wp.types.vector(length=3 * CELLS, dtype=wp.float32)


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
    """Kernel of `step.stream_collide` for a CPU; its first argument is the first row, not the first cell."""
    number, velocity = STORAGE[dtype], velocity_type(subgrid)
    module = module_of(faces, "wale" if subgrid else "none", dtype, "u_rows" if keeps else "f_rows")
    pull, velocity_gradient = pull_through(faces, number), gradient_within(faces, velocity)
    opened = any(any(completes(axis)) for axis in faces)
    inward, update = leave_through(faces)[0], branchless_update_through(faces, subgrid)
    (low_x, high_x), (low_y, high_y), _ = (completes(axis) for axis in faces)
    wraps = [FACES[axis.low].wraps for axis in faces]

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
        column = start + wp.tid()
        step = clock[0]
        if column == 0:
            clock_next[0] = step + 1
        nx, ny, nz = s.nx, s.ny, s.nz
        cells = nx * ny * nz
        plane = ny * nz
        x, y = column / ny, column % ny
        row = column * nz
        x0, y0 = x * plane, y * nz
        at_x, at_y = within(x - origin[3], nx), within(y - origin[4], ny)
        if is_ghost(s, wp.vec3i(at_x, at_y, s.low[2])):
            return
        node_x, node_y = at_x + origin[0], at_y + origin[1]
        low_z = within(origin[5], nz)  # where the lowest cell of the window lies in memory, and behind it the highest
        high_z = within(low_z + nz - 1, nz)
        ends = wp.where(wp.static(wraps[2]) or low_z == 0, 2, 4)  # cells that wrap round in memory, and those at faces elsewhere
        # an open face completes the moments of the inner neighbour
        inner, inner_x, inner_y = wp.vec3i(at_x, at_y, 0), x, y
        outer, n = False, wp.vec3()
        if wp.static(opened):
            inner = inward(s, inner)
            inner_x, inner_y = within(x + inner[0] - at_x, nx), within(y + inner[1] - at_y, ny)
            outer = inner_x != x or inner_y != y
            if outer:
                n = wp.normalize(wp.vec3(float(at_x - inner[0]), float(at_y - inner[1]), 0.0))
        edge = wp.static(not wraps[0]) and (inner[0] == 0 or inner[0] == nx - 1)
        edge = edge or (wp.static(not wraps[1]) and (inner[1] == 0 or inner[1] == ny - 1))
        from_x, from_y = inner_x * plane, inner_y * nz
        from_xm, from_xp = wp.where(inner_x > 0, inner_x - 1, nx - 1) * plane, wp.where(inner_x < nx - 1, inner_x + 1, 0) * plane
        from_ym, from_yp = wp.where(inner_y > 0, inner_y - 1, ny - 1) * nz, wp.where(inner_y < ny - 1, inner_y + 1, 0) * nz
        xm, xp = wp.where(x > 0, x - 1, nx - 1) * plane, wp.where(x < nx - 1, x + 1, 0) * plane
        ym, yp = wp.where(y > 0, y - 1, ny - 1) * nz, wp.where(y < ny - 1, y + 1, 0) * nz
        if wp.static(not wraps[0]):
            xm, xp = wp.where(at_x == 0, x0, xm), wp.where(at_x == nx - 1, x0, xp)
        if wp.static(not wraps[1]):
            ym, yp = wp.where(at_y == 0, y0, ym), wp.where(at_y == ny - 1, y0, yp)
        sigma = float(0.0)  # noqa: UP018  a variable to Warp
        if wp.static(opened):
            sigma = ramp(wp.static(low_x), wp.static(high_x), at_x, nx, s.sponge)
            sigma += ramp(wp.static(low_y), wp.static(high_y), at_y, ny, s.sponge)
            sigma = s.sponge_rate * sigma
        damped = sigma > 0.0
        pushed = node_x >= box[0] and node_x < box[3] and node_y >= box[1] and node_y < box[4]

        sources = vec19i()
        for i in range(wp.static(Q)):
            sources[i] = wp.static(i) * cells + pick(wp.static(C[i][0]), from_xm, from_x, from_xp)
            sources[i] = sources[i] + pick(wp.static(C[i][1]), from_ym, from_y, from_yp) - wp.static(C[i][2])
        first = int(0)  # noqa: UP018
        populations, gradients = Populations(), Gradients()
        while first < nz:
            count = wp.min(LONG, nz - first)
            # the row in memory order, in whole vectors except at its end; then, cell by cell, those that wrap or are redirected
            whole = (count + 2 * WIDTH - 1) / (2 * WIDTH) * (2 * WIDTH)
            i = int(0)  # noqa: UP018
            while i < wp.static(Q):
                base = sources[i] + first
                k = int(0)  # noqa: UP018
                last = wp.where(base + whole <= Q * cells, whole, wp.where(first + count == nz, count - 1, count))
                while k < last:
                    populations[i * LONG + k] = peek_at(f, base, k)
                    k += 1
                i += 1
            if wp.static(subgrid):
                k = wp.where(first == 0, 1, 0)
                last = wp.where(first + count == nz, count - 1, count)
                here = row + first
                while k < last:
                    for a in range(3):
                        east, west = peek3_at(u_old, xp + y0 + first, k, a), peek3_at(u_old, xm + y0 + first, k, a)
                        north, south = peek3_at(u_old, x0 + yp + first, k, a), peek3_at(u_old, x0 + ym + first, k, a)
                        above, below = peek3_at(u_old, here + 1, k, a), peek3_at(u_old, here - 1, k, a)
                        gradients[wp.static(a) * LONG + k] = 0.5 * (east - west)
                        gradients[wp.static(3 + a) * LONG + k] = 0.5 * (north - south)
                        gradients[wp.static(6 + a) * LONG + k] = 0.5 * (above - below)
                    k += 1
            e = int(0)  # noqa: UP018
            while e < wp.where(edge, count, ends):
                z = first + e
                if not edge:
                    z = wp.where(e < 2, wp.where(e == 0, 0, nz - 1), wp.where(e == 2, low_z, high_z))
                if z >= first and z < first + count:
                    k = z - first
                    at, m = wp.vec3i(at_x, at_y, within(z - origin[5], nz)), wp.vec3i(x, y, z)
                    q = pull(f, s, wp.vec3i(inner[0], inner[1], at[2]), wp.vec3i(inner_x, inner_y, z))
                    for i in range(wp.static(Q)):
                        populations[wp.static(i) * LONG + k] = q[i]
                    if wp.static(subgrid):
                        d = velocity_gradient(u_old, s, at, m)
                        for a in range(9):
                            gradients[wp.static(a) * LONG + k] = d[wp.static(a // 3), wp.static(a % 3)]
                e += 1
            pushes, targets = Velocities(), Velocities()
            k = int(0)  # noqa: UP018
            if pushed or damped or outer:
                while k < count:
                    node_z = within(first + k - origin[5], nz) + origin[2]
                    if pushed and node_z >= box[2] and node_z < box[5]:
                        for a in range(3):
                            pushes[wp.static(a) * LONG + k] = peek3_at(force, row + first, k, a)
                    if wp.static(opened):
                        if damped or outer:
                            target = background(flow, wp.vec3(float(node_x), float(node_y), float(node_z)), step + 1)
                            for a in range(3):
                                targets[wp.static(a) * LONG + k] = target[a]
                    k += 1

            k = int(0)  # noqa: UP018
            last = (count + WIDTH - 1) / WIDTH * WIDTH
            while k < last:
                q = vec19()
                for i in range(wp.static(Q)):
                    q[i] = populations[wp.static(i) * LONG + k]
                d = wp.mat33()
                for a in range(9):
                    d[wp.static(a // 3), wp.static(a % 3)] = gradients[wp.static(a) * LONG + k]
                push = wp.vec3(pushes[k], pushes[LONG + k], pushes[2 * LONG + k])
                target = wp.vec3(targets[k], targets[LONG + k], targets[2 * LONG + k])
                q, w = update(q, d, s, push, damped, sigma, target, outer, n)
                for i in range(wp.static(Q)):
                    populations[wp.static(i) * LONG + k] = q[i]
                for a in range(3):
                    pushes[wp.static(a) * LONG + k] = w[a]
                k += 1

            # the stepped part of a row, in two pieces if it wraps round
            begin = within(low_z + s.low[2], nz)
            end = begin + s.high[2] - s.low[2]
            start_k, stop = wp.max(wp.min(begin - first, count), 0), wp.min(end - first, count)
            rest = wp.min(end - nz - first, count)
            i = int(0)  # noqa: UP018
            while i < wp.static(Q):
                base = i * cells + row + first
                k = int(start_k)
                while k < stop:
                    poke_at(f_next, base, k, populations[i * LONG + k])
                    k += 1
                k = int(0)  # noqa: UP018
                while k < rest:
                    poke_at(f_next, base, k, populations[i * LONG + k])
                    k += 1
                i += 1
            if wp.static(keeps):
                k = int(start_k)
                while k < stop:
                    for a in range(3):
                        poke3_at(u_next, row + first, k, a, pushes[wp.static(a) * LONG + k])
                    k += 1
                k = int(0)  # noqa: UP018
                while k < rest:
                    for a in range(3):
                        poke3_at(u_next, row + first, k, a, pushes[wp.static(a) * LONG + k])
                    k += 1
            first += LONG

    return stream_collide_rows
