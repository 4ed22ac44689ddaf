"""The markers' part of a step in four kernels, one warp for each marker; `boundary.py` queues thirteen kernels instead.

    kernel              computes                                                  fuses (kernels.py and fsi_solve.py)
    place_markers       pose, Jacobian, cells, weights, F_j of unit velocities    pose, weight, set_target for r > 0
    sample_fluid        u* and rho of the cells, F = wanted, spread               clear_force, read_cells, set_target, spread
    assemble_response   second pass F <- 2 F - G, K and b0, v+                    correct, response_part, response_total, solve
    spread_force        F0 + sum v_j F_j into the fluid's G, wrench on the links  combine, spread_force, wrench, add_wrench

The formulas are those of `kernels.py`, for two passes. A step that never waits for the host spends its time in starting kernels
and in loads that wait for one another. Here the lanes of a warp load the cells of a marker side by side. `place_markers` computes
all that needs no water, while the water steps. `sample_fluid` clears the force of the last step, and `spread_force` clears the
scratch box. A CPU runs the same code with one lane.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from fishmj.lbm_oracle.fluid.in_kernels import wrap
from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed import fsi_solve
from fishmj.lbm_oracle.immersed.boundary import Boundary
from fishmj.lbm_oracle.immersed.fsi_solve import MOST, finish_response, finishes_last, solve_block, wait_for_block
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays, first_cell, phi, pulled_moments
from fishmj.lbm_oracle.immersed.wall_law import NODES, WallLaw, clear_layer, law_slip, probe, push_layer, wall_velocity

LANES = 32  # of a marker, on an accelerator
GROUP = 4  # lanes of a marker and right-hand side in `assemble_response`
PASSES = 2  # that these kernels do
BLOCKS = 64  # of `assemble_response`: half as many as run at once, for other tanks; the last one sums the parts of all


@wp.func_native(fsi_solve.SUM_OVER_WARP)
def sum_over_warp(x: wp.float32) -> wp.float32:
    """Sum of x over the lanes of a warp."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    unsigned four = 0xfu << (threadIdx.x & 28u);
    x += __shfl_xor_sync(four, x, 1);
    x += __shfl_xor_sync(four, x, 2);
#endif
    return x;
""")
def sum_over_group(x: wp.float32) -> wp.float32:
    """Sum of x over a group of four lanes."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
""")
def wait_for_warp():
    """Waits for all lanes of the warp; does nothing on the CPU."""
    ...


class MarkerKernels(NamedTuple):
    """The four kernels of a step, in their order."""

    place_markers: wp.Kernel
    sample_fluid: wp.Kernel
    assemble_response: wp.Kernel
    spread_force: wp.Kernel


@cache
def marker_kernels(width: int, on_gpu: bool, number: type = wp.float32, has_law: bool = False) -> MarkerKernels:
    """Makes the kernels for markers of this width, in water stored as `number`; `has_law`: with a law for the wall's stress."""
    lanes, group = (LANES, GROUP) if on_gpu else (1, 1)
    module = wp.get_module(f"{__name__}.{width}_{lanes}_{number.__name__}{'_law' if has_law else ''}")
    wp.set_module_options({"enable_backward": False, "max_unroll": 64 if on_gpu else Q}, module)
    return MarkerKernels(
        place_markers_kernel(width, lanes, module),
        sample_fluid_kernel(width, lanes, number, has_law, module),
        assemble_response_kernel(width, group, on_gpu, has_law, module),
        spread_force_kernel(width, lanes, number, has_law, module),
    )


def place_markers_kernel(width: int, lanes: int, module: Any) -> wp.Kernel:
    """Kernel of the markers' places and weights."""
    cells = width**3

    @wp.kernel(module=module, grid_stride=False)
    def place_markers(
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
        slips: wp.array(dtype=float),
        dx: wp.float64,
        dt: wp.float64,
        shape: wp.vec3i,
        world: wp.array(dtype=wp.vec3d),
        normals: wp.array(dtype=wp.vec3),
        store: wp.array(dtype=wp.vec3i),
        jacobian: wp.array2d(dtype=wp.vec3),
        low_cell: wp.array(dtype=wp.vec3i),
        weights: wp.array(dtype=float),
        force: wp.array2d(dtype=wp.vec3),
    ):
        """Computes what needs no water: place, normal and Jacobian of each marker, its cells, their weights, and F_j for j > 0.

        Fuses `kernels.pose` (X, n, J, store), `kernels.weight` (kept in `weights`, not computed anew by each reader) and
        `kernels.set_target` for r > 0 (F_j = J_j - s P J_j).
        """
        tid = wp.tid()
        k, lane = tid // wp.static(lanes), tid % wp.static(lanes)
        b, a, s = before[k], after[k], share[k]
        turn = s * host[at.angle + a]
        c, sn = wp.cos(turn), wp.sin(turn)
        r, m = rest[k] - pivot[k], rest_normal[k]
        local = wp.vec3d(c * r[0] - sn * r[1], sn * r[0] + c * r[1], r[2]) + pivot[k]
        rotation = matrix3(host, at.frame + 12 * b + 3)
        point = point3(host, at.frame + 12 * b) + rotation * local
        out = rotation * wp.vec3d(c * m[0] - sn * m[1], sn * m[0] + c * m[1], m[2])
        normal = wp.vec3(float(out[0]), float(out[1]), float(out[2]))
        # float64 up to here, relative to the box from here on: single precision would lose the fraction of a distant cell
        low = point3(host, at.box)
        inner = (point - point3(host, at.origin)) / dx - low
        p = wp.vec3(float(inner[0]), float(inner[1]), float(inner[2]))
        cell = wp.vec3i(
            first_cell(p[0], wp.static(width)), first_cell(p[1], wp.static(width)), first_cell(p[2], wp.static(width))
        )
        if lane == 0:
            world[k] = point
            normals[k] = normal
            x, y, z = wrap(cell[0] + int(low[0]), shape[0]), wrap(cell[1] + int(low[1]), shape[1]), cell[2] + int(low[2])
            store[k] = wp.vec3i(x, y, wrap(z, shape[2]))
            low_cell[k] = cell
        slip = slips[k]
        d = int(lane)
        while d < at.dofs:
            w = ((wp.float64(1.0) - s) * reach[b, d] + s * reach[a, d]) * dt / dx
            axis = point3(host, at.axis + 3 * d)
            column = w * axis
            if slides[d] == 0:
                column = w * wp.cross(axis, point - point3(host, at.anchor + 3 * d))
            v = wp.vec3(float(column[0]), float(column[1]), float(column[2]))
            jacobian[k, d] = v
            force[k, d + 1] = v - slip * (v - wp.dot(v, normal) * normal)
            d += wp.static(lanes)
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            weight = phi(p[0] - float(cell[0] + i), wp.static(width)) * phi(p[1] - float(cell[1] + j), wp.static(width))
            weights[wp.static(cells) * k + o] = weight * phi(p[2] - float(cell[2] + l), wp.static(width))
            o += wp.static(lanes)

    return place_markers


def sample_fluid_kernel(width: int, lanes: int, number: type, has_law: bool, module: Any) -> wp.Kernel:
    """Kernel of the fluid's velocity at the markers and the first pass; `has_law`: slip ratios from the stress of the wall."""
    cells = width**3

    @wp.kernel(module=module, grid_stride=False)
    def sample_fluid(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        slips: wp.array(dtype=float),
        volume: wp.array(dtype=float),
        shape: wp.vec3i,
        box: wp.vec3i,
        wraps: wp.vec3i,
        corner: wp.array(dtype=int),
        f: wp.array(dtype=number),
        body_acceleration: wp.vec3,
        law: WallLaw,
        dx: wp.float64,
        world: wp.array(dtype=wp.vec3d),
        jacobian: wp.array2d(dtype=wp.vec3),
        normals: wp.array(dtype=wp.vec3),
        store: wp.array(dtype=wp.vec3i),
        low_cell: wp.array(dtype=wp.vec3i),
        weights: wp.array(dtype=float),
        force_box: wp.array(dtype=int),
        last_store: wp.array(dtype=wp.vec3i),
        weight_over_rho: wp.array(dtype=float),
        force: wp.array2d(dtype=wp.vec3),
        scratch: wp.array4d(dtype=wp.vec3),
        acceleration: wp.array3d(dtype=wp.vec3),
    ):
        """Reads u* at the markers, sets F0 and spreads the F of all right-hand sides; clears the force of the last step.

        Fuses `kernels.clear_force` (cells `last_store`), `kernels.read_cells` (u* and rho, kept as weight / rho),
        `kernels.set_target` for r = 0 (F0 = s P u* - u*) and `kernels.spread` (first pass). With a law for the wall it also fuses
        `wall_law.probe_water` and `wall_law.set_slips`, and sets F_j for r > 0 anew.
        """
        tid = wp.tid()
        k, lane = tid // wp.static(lanes), tid % wp.static(lanes)
        if tid == 0:
            for x in range(3):
                force_box[x] = wp.where(wraps[x] == 1, corner[x], int(host[at.box + x]))
                force_box[x + 3] = force_box[x] + wp.where(wraps[x] == 1, shape[x], box[x])
        old, here, cell, normal = last_store[k], store[k], low_cell[k], normals[k]
        slip, push = float(slips[k]), volume[k]
        u = wp.vec3(0.0, 0.0, 0.0)
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(here[0] + i, shape[0]), wrap(here[1] + j, shape[1]), wrap(here[2] + l, shape[2])
            rho, momentum = pulled_moments(f, x, y, z, shape)
            weight = weights[wp.static(cells) * k + o]
            # divided by the local density, so that sum rho G = sum V F; otherwise the water would gain rho times the force
            weight_over_rho[wp.static(cells) * k + o] = weight / rho
            u += weight * (momentum / rho + body_acceleration)
            o += wp.static(lanes)
        o = int(lane)
        while o < wp.static(cells):  # the cells of the last step's force
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(old[0] + i, shape[0]), wrap(old[1] + j, shape[1]), wrap(old[2] + l, shape[2])
            acceleration[x, y, z] = wp.vec3(0.0, 0.0, 0.0)
            o += wp.static(lanes)
        u_at_marker = wp.vec3(sum_over_warp(u[0]), sum_over_warp(u[1]), sum_over_warp(u[2]))
        if wp.static(has_law):
            place = (world[k] - point3(host, at.origin)) / dx
            out, back = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
            o = int(lane)
            while o < NODES * law.sides[k]:
                share = probe(f, body_acceleration, place, normal, law.height, o, shape)
                if o < NODES:
                    out += share
                else:
                    back += share
                o += wp.static(lanes)
            wall = wall_velocity(host, at, jacobian, k)
            outer = wp.vec3(sum_over_warp(out[0]), sum_over_warp(out[1]), sum_over_warp(out[2])) - wall
            inner = wp.vec3(sum_over_warp(back[0]), sum_over_warp(back[1]), sum_over_warp(back[2])) - wall
            found = law_slip(law, k, normal, u_at_marker - wall, outer, inner)
            slip = found[0]
            d = int(lane)
            while d < at.dofs:
                v = jacobian[k, d]
                force[k, d + 1] = v - slip * (v - wp.dot(v, normal) * normal)
                d += wp.static(lanes)
            if lane == 0:
                slips[k] = slip
                law.outer[k] = found[1]
            o = int(lane)
            while o < NODES * law.points * law.sides[k]:
                clear_layer(law, k, o, shape, acceleration)
                o += wp.static(lanes)
        if lane == 0:
            force[k, 0] = slip * (u_at_marker - wp.dot(u_at_marker, normal) * normal) - u_at_marker
            last_store[k] = here  # all lanes have read the old one: `sum_over_warp` waits for them
        wait_for_warp()
        e = int(lane)
        while e < wp.static(cells) * (at.dofs + 1):
            o = e // (at.dofs + 1)
            side = e - o * (at.dofs + 1)
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            value = weight_over_rho[wp.static(cells) * k + o] * (push * force[k, side])
            wp.atomic_add(scratch, cell[0] + i, cell[1] + j, cell[2] + l, side, value)
            e += wp.static(lanes)

    return sample_fluid


def assemble_response_kernel(width: int, group: int, on_gpu: bool, has_law: bool, module: Any) -> wp.Kernel:
    """Kernel of the second pass, K, b0 and v+; `has_law`: the second pass corrects the force along the normal alone."""
    cells = width**3

    @wp.kernel(module=module, grid_stride=False)
    def assemble_response(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        markers: int,
        chunk: int,
        jacobian: wp.array2d(dtype=wp.vec3),
        normals: wp.array(dtype=wp.vec3),
        volume: wp.array(dtype=float),
        low_cell: wp.array(dtype=wp.vec3i),
        weights: wp.array(dtype=float),
        scratch: wp.array4d(dtype=wp.vec3),
        scale: wp.float64,
        force: wp.array2d(dtype=wp.vec3),
        part: wp.array3d(dtype=wp.float64),
        done: wp.array(dtype=int),
        water: wp.array2d(dtype=wp.float64),
        rows: wp.array(dtype=wp.float64),
        step: wp.array(dtype=int),
        pivots: wp.array(dtype=int),
        v: wp.array(dtype=wp.float64),
        target: wp.array(dtype=wp.float64),
    ):
        """Does the second pass of the forcing, sums K and b0, and solves for v+ in the block that finishes last.

        Fuses `kernels.correct` (F += wanted - G), `fsi_solve.response_part`, `fsi_solve.response_total` and `fsi_solve.solve`.
        On a GPU and up to `MOST` degrees of freedom the elimination runs in shared memory (`finish_response`).
        """
        tid, threads = wp.tid(), wp.block_dim()
        me, block = tid % threads, tid // threads
        sides = at.dofs + 1
        begin = block * chunk
        end = wp.min(begin + chunk, markers)
        item, g = me // wp.static(group), me % wp.static(group)
        while item < (end - begin) * sides:
            k, r = begin + item // sides, item % sides
            p, g_at_marker = low_cell[k], wp.vec3(0.0, 0.0, 0.0)
            for turn in range(wp.static(-(-cells // group))):
                o = turn * wp.static(group) + g
                if o < wp.static(cells):
                    i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
                    g_at_marker += weights[wp.static(cells) * k + o] * scratch[p[0] + i, p[1] + j, p[2] + l, r]
            g_at_marker = wp.vec3(sum_over_group(g_at_marker[0]), sum_over_group(g_at_marker[1]), sum_over_group(g_at_marker[2]))
            if g == 0:
                wanted = force[k, r]
                if wp.static(has_law):
                    force[k, r] = wanted + wp.dot(wanted - g_at_marker, normals[k]) * normals[k]
                else:
                    force[k, r] = wanted + wanted - g_at_marker
            item += threads // wp.static(group)
        wait_for_block()
        entry = int(me)
        while entry < at.dofs * sides:
            i, r = entry // sides, entry % sides
            total = wp.float64(0.0)
            for k in range(begin, end):
                total += wp.float64(volume[k] * wp.dot(jacobian[k, i], force[k, r]))
            part[block, i, r] = total
            entry += threads
        is_last = finishes_last(done, part.shape[0])
        if is_last == 1 and wp.static(on_gpu) and at.dofs <= wp.static(MOST):
            if me == 0:
                done[0] = 0
            finish_response(
                part, part.shape[0], scale, host, at.system, at.momentum, at.fixed, at.value, at.dofs, water, pivots, v, target,
                me, threads,
            )  # fmt: skip
        elif is_last == 1:
            entry = int(me)
            while entry < at.dofs * sides:
                i, r = entry // sides, entry % sides
                total = wp.float64(0.0)
                for c in range(part.shape[0]):
                    total += part[c, i, r]
                water[i, r] = scale * total
                entry += threads
            if me == 0:
                done[0] = 0
            wait_for_block()
            solve_block(host, at, water, 1, rows, step, pivots, v, target, me, threads)

    return assemble_response


def spread_force_kernel(width: int, lanes: int, number: type, has_law: bool, module: Any) -> wp.Kernel:
    """Kernel of the final force and the wrenches; `has_law`: the force along the wall goes into a layer."""
    cells = width**3

    @wp.kernel(module=module, grid_stride=False)
    def spread_force(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        before: wp.array(dtype=int),
        after: wp.array(dtype=int),
        share: wp.array(dtype=wp.float64),
        volume: wp.array(dtype=float),
        world: wp.array(dtype=wp.vec3d),
        store: wp.array(dtype=wp.vec3i),
        low_cell: wp.array(dtype=wp.vec3i),
        weight_over_rho: wp.array(dtype=float),
        force: wp.array2d(dtype=wp.vec3),
        v: wp.array(dtype=wp.float64),
        shape: wp.vec3i,
        impulse: wp.float64,
        f: wp.array(dtype=number),
        law: WallLaw,
        normals: wp.array(dtype=wp.vec3),
        dx: wp.float64,
        final: wp.array(dtype=wp.vec3),
        scratch: wp.array4d(dtype=wp.vec3),
        acceleration: wp.array3d(dtype=wp.vec3),
        wrench: wp.array2d(dtype=wp.float64),
    ):
        """Adds the final force to the fluid's G and to the wrenches on the links; clears the scratch box for the next step.

        Fuses `kernels.combine` (F = F0 + sum v_j F_j), `kernels.spread_force`, `fsi_solve.wrench` and `fsi_solve.add_wrench`.
        With a law for the wall it also fuses `wall_law.push_layers`.
        """
        tid = wp.tid()
        k, lane = tid // wp.static(lanes), tid % wp.static(lanes)
        total = force[k, 0]
        for d in range(at.dofs):
            total += float(v[d]) * force[k, d + 1]
        if lane == 0:
            final[k] = total
        whole, p, here = volume[k] * total, low_cell[k], store[k]
        if wp.static(has_law):
            normal = normals[k]
            across = wp.dot(whole, normal) * normal
            place = (world[k] - point3(host, at.origin)) / dx
            o = int(lane)
            while o < NODES * law.points * law.sides[k]:
                push_layer(law, f, k, o, place, normal, whole - across, shape, acceleration)
                o += wp.static(lanes)
            whole = across
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(here[0] + i, shape[0]), wrap(here[1] + j, shape[1]), wrap(here[2] + l, shape[2])
            wp.atomic_add(acceleration, x, y, z, weight_over_rho[wp.static(cells) * k + o] * whole)
            o += wp.static(lanes)
        s = share[k]
        part = int(lane)
        while part < 12:  # impulse and moment on the two links of a bend; most markers have one
            link, w = int(before[k]), wp.float64(1.0) - s
            if part >= 6:
                link, w = int(after[k]), wp.float64(s)
            if w > wp.float64(0.0):
                on_link = (-w * wp.float64(volume[k])) * wp.vec3d(
                    wp.float64(total[0]), wp.float64(total[1]), wp.float64(total[2])
                )
                axis = part % 6
                if axis >= 3:
                    on_link = wp.cross(world[k] - point3(host, at.frame + 12 * link), on_link)
                wp.atomic_add(wrench, link, axis, impulse * on_link[axis % 3])
            part += wp.static(lanes)
        e = int(lane)
        while e < wp.static(cells) * (at.dofs + 1):
            o = e // (at.dofs + 1)
            side = e - o * (at.dofs + 1)
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            scratch[p[0] + i, p[1] + j, p[2] + l, side] = wp.vec3(0.0, 0.0, 0.0)
            e += wp.static(lanes)

    return spread_force


class MarkerWarps:
    """Runs the four kernels over the arrays of a `Boundary` with two passes, and owns their additional arrays."""

    def __init__(self, boundary: Boundary, number: type = wp.float32):
        b, device = boundary, boundary.device
        self.boundary, on_gpu = boundary, device.is_cuda
        self._kernels = marker_kernels(b.width, on_gpu, number, b.has_law)
        self._threads = b.count * (LANES if on_gpu else 1)
        least, most = fsi_solve.BLOCK // (GROUP * b.rhs), -(-b.count // BLOCKS)
        self._chunk = max(1, least, most) if on_gpu else b.count  # markers of a block in `assemble_response`
        blocks = -(-b.count // self._chunk)
        self._response_threads = blocks * (fsi_solve.BLOCK if on_gpu else 1)
        empty = lambda shape, dtype: wp.zeros(shape, dtype=dtype, device=device)
        self._low_cell, self._last_store, self._done = empty(b.count, wp.vec3i), empty(b.count, wp.vec3i), empty(1, wp.int32)
        self._weights, self._weight_over_rho = (empty(b.count * b.width**3, wp.float32) for _ in range(2))
        self._velocity = empty(b.dofs, wp.float64)
        self._part = empty((blocks, b.dofs, b.rhs), wp.float64)

    def begin(self) -> None:
        """Queues the clearing of the scratch box, which another user may have left filled."""
        self.boundary.scratch.zero_()

    def place_markers(self) -> None:
        """Queues `place_markers`: all that follows from the pose of the body in `boundary.host` without the water."""
        b, lat = self.boundary, self.boundary.lattice
        args = [b.host, b.layout, b.rest, b.rest_normal, b.pivot, b.before, b.after, b.share, b.moves, b.slides, b.slips]
        found = [b.world, b.normal, b.store, b.jacobian, self._low_cell, self._weights, b.force]
        self._launch(self._kernels.place_markers, self._threads, [*args, lat.dx, lat.dt, wp.vec3i(*b.shape), *found])

    def sample_fluid(self, f: wp.array, corner: wp.array, force_box: wp.array, acceleration: wp.array) -> None:
        """Queues `sample_fluid`; arguments as `Boundary.assemble_response`, and the fluid's G, whose last force it clears."""
        b = self.boundary
        args = [b.host, b.layout, b.slips, b.volume, wp.vec3i(*b.shape), wp.vec3i(*b.box_shape), b.wraps, corner, f]
        args += [b.body_acceleration, b.law, b.lattice.dx, b.world, b.jacobian, b.normal, b.store, self._low_cell, self._weights]
        found = [force_box, self._last_store, self._weight_over_rho, b.force, b.scratch]
        self._launch(self._kernels.sample_fluid, self._threads, [*args, *found, acceleration])

    def assemble_response(self) -> None:
        """Queues `assemble_response`: K, b0 and v+."""
        b, lat = self.boundary, self.boundary.lattice
        scale = lat.mass * lat.velocity**2 * lat.dt / lat.dx * lat.velocity
        args = [b.host, b.layout, b.count, self._chunk, b.jacobian, b.normal, b.volume, self._low_cell]
        args += [self._weights, b.scratch, scale]
        args += [b.force, self._part, self._done, b.water, *b.elimination, self._velocity, b.target]
        self._launch(self._kernels.assemble_response, self._response_threads, args)

    def spread_force(self, f: wp.array, acceleration: wp.array) -> None:
        """Queues `spread_force`: the force into the fluid's G, and the wrench on the links; `f` as in `sample_fluid`."""
        b, lat = self.boundary, self.boundary.lattice
        args = [b.host, b.layout, b.before, b.after, b.share, b.volume, b.world, b.store, self._low_cell]
        args += [self._weight_over_rho, b.force]
        args += [b.target, wp.vec3i(*b.shape), lat.mass * lat.velocity, f, b.law, b.normal, lat.dx]
        args += [b.final, b.scratch, acceleration, b.wrench_sum]
        self._launch(self._kernels.spread_force, self._threads, args)

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.boundary.device, block_dim=fsi_solve.BLOCK)
