"""The markers' part of a step in four kernels, one warp for each marker; `boundary.py` queues thirteen kernels instead.

    kernel    computes                                                     fuses (kernels.py and fsi_solve.py)
    place     pose, Jacobian, cells, weights, F_j of unit velocities       pose, weight, set_target for r > 0
    look      u* and rho of the cells, F = wanted, spread                  clear_force, read_cells, set_target for r = 0, spread
    answer    second pass F <- 2 F - G, K and b0, v+                       correct, response_part, response_total, solve
    push      F0 + sum v_j F_j into the fluid's G, wrench on the links     combine, spread_force, wrench, add_wrench

The formulas are those of `kernels.py`, for two passes. A step that never waits for the host spends its time in starting kernels
and in loads that wait for one another. Here the lanes of a warp load the cells of a marker side by side. `place` computes all
that needs no water, while the water steps. `look` clears the force of the last step, and `push` clears the scratch box. A CPU
runs the same code with one lane.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid.lattice import Q, wrap
from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed import fsi_solve
from fishmj.lbm_oracle.immersed.boundary import Boundary
from fishmj.lbm_oracle.immersed.fsi_solve import solve_block, wait_for_block
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays, first, phi, pulled

LANES = 32  # of a marker, on an accelerator
GROUP = 4  # lanes of a marker and right-hand side in `answer`
PASSES = 2  # that these kernels do
BLOCKS = 64  # of `answer`, half as many as run at once, for there are other tanks; the last one adds up what all have found
MOST = 24  # degrees of freedom that are solved for in shared memory


@wp.func_native(fsi_solve.OVER_WARP)
def over_warp(x: wp.float32) -> wp.float32:
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
def over_group(x: wp.float32) -> wp.float32:
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


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __shared__ int last;
    __threadfence();
    __syncthreads();
    if (threadIdx.x == 0) last = atomicAdd(done.data, 1) == blocks - 1;
    __syncthreads();
    __threadfence();
    return last;
#else
    done.data[0] += 1;
    return done.data[0] == blocks;
#endif
""")
def ends_last(done: wp.array(dtype=wp.int32), blocks: int) -> int:
    """Returns 1 in the block that finishes last, else 0; `done` counts the finished blocks."""
    ...


@wp.func_native(f"""
#if defined(__CUDA_ARCH__)
    // Gauss-Jordan, a thread an entry; a row that was a pivot's is marked in `used`. Column p stands while step p reads it
    __shared__ double a[{MOST} * ({MOST} + 1)];
    __shared__ double x[{MOST}];
    const int wide = n + 1, entries = n * wide;
    for (int e = me; e < entries; e += threads) {{
        const int i = e / wide, j = e - i * wide, r = j < n ? j + 1 : 0;
        double total = 0.0;
        #pragma unroll 8
        for (int c = 0; c < blocks; ++c) total += part.data[(c * n + i) * wide + r];
        total *= scale;
        water.data[i * wide + r] = total;
        const bool held = host.data[fixed + i] >= 0.5;
        double entry = j < n ? host.data[system + n * i + j] + total : host.data[momentum + i] - total;
        if (held) entry = j < n ? (i == j ? 1.0 : 0.0) : host.data[value + i];
        a[e] = entry;
    }}
    __syncthreads();
    unsigned used = 0u;
    for (int p = 0; p < n; ++p) {{
        int found = -1;
        double greatest = 0.0;
        for (int i = 0; i < n; ++i) {{
            const double size = fabs(a[wide * i + p]);
            if (!(used >> i & 1u) && (found < 0 || size > greatest)) {{ found = i; greatest = size; }}
        }}
        used |= 1u << found;
        for (int e = me; e < entries; e += threads) {{
            const int i = e / wide, j = e - i * wide;
            if (j > p && i != found) a[e] -= a[wide * i + p] / a[wide * found + p] * a[wide * found + j];
        }}
        __syncthreads();
        if (me == p) x[p] = a[wide * found + p], pivots.data[p] = found;
    }}
    __syncthreads();
    if (me < n) {{
        const double solution = a[wide * pivots.data[me] + n] / x[me];
        v.data[me] = solution;
        target.data[me] = solution;
    }}
#endif
""")
def finish_response(
    part: wp.array3d(dtype=wp.float64),
    blocks: int,
    scale: wp.float64,
    host: wp.array(dtype=wp.float64),
    system: int,
    momentum: int,
    fixed: int,
    value: int,
    n: int,
    water: wp.array2d(dtype=wp.float64),
    pivots: wp.array(dtype=wp.int32),
    v: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
    me: int,
    threads: int,
):
    """Sums the chunks of K and b0 and solves (A + K) v = right - b0 by Gauss-Jordan elimination, one thread for each entry."""
    ...


@cache
def marker_kernels(width: int, on_gpu: bool, number: type = wp.float32) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel, wp.Kernel]:
    """Makes `place`, `look`, `answer` and `push` for markers of this width, in water whose populations are stored as `number`."""
    cells = width**3
    lanes, group = (LANES, GROUP) if on_gpu else (1, 1)
    module = wp.get_module(f"{__name__}.{width}_{lanes}_{number.__name__}")
    wp.set_module_options({"enable_backward": False, "max_unroll": 64 if on_gpu else Q}, module)

    @wp.kernel(module=module, grid_stride=False)
    def place(
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
        slip: wp.array(dtype=float),
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
        """Computes, without the water: pose and Jacobian (`pose`), kernel weights (`weight`), and F_j, j > 0 (`set_target`)."""
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
        cell = wp.vec3i(first(p[0], wp.static(width)), first(p[1], wp.static(width)), first(p[2], wp.static(width)))
        if lane == 0:
            world[k] = point
            normals[k] = normal
            x, y, z = wrap(cell[0] + int(low[0]), shape[0]), wrap(cell[1] + int(low[1]), shape[1]), cell[2] + int(low[2])
            store[k] = wp.vec3i(x, y, wrap(z, shape[2]))
            low_cell[k] = cell
        slides_by = slip[k]
        d = int(lane)
        while d < at.dofs:
            w = ((wp.float64(1.0) - s) * reach[b, d] + s * reach[a, d]) * dt / dx
            axis = point3(host, at.axis + 3 * d)
            column = w * axis
            if slides[d] == 0:
                column = w * wp.cross(axis, point - point3(host, at.anchor + 3 * d))
            v = wp.vec3(float(column[0]), float(column[1]), float(column[2]))
            jacobian[k, d] = v
            force[k, d + 1] = v - slides_by * (v - wp.dot(v, normal) * normal)
            d += wp.static(lanes)
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            weight = phi(p[0] - float(cell[0] + i), wp.static(width)) * phi(p[1] - float(cell[1] + j), wp.static(width))
            weights[wp.static(cells) * k + o] = weight * phi(p[2] - float(cell[2] + l), wp.static(width))
            o += wp.static(lanes)

    @wp.kernel(module=module, grid_stride=False)
    def look(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        slip: wp.array(dtype=float),
        volume: wp.array(dtype=float),
        shape: wp.vec3i,
        box: wp.vec3i,
        wraps: wp.vec3i,
        corner: wp.array(dtype=int),
        f: wp.array(dtype=number),
        body_acceleration: wp.vec3,
        normals: wp.array(dtype=wp.vec3),
        store: wp.array(dtype=wp.vec3i),
        low_cell: wp.array(dtype=wp.vec3i),
        weights: wp.array(dtype=float),
        acts: wp.array(dtype=int),
        pushed: wp.array(dtype=wp.vec3i),
        thinned: wp.array(dtype=float),
        force: wp.array2d(dtype=wp.vec3),
        scratch: wp.array4d(dtype=wp.vec3),
        acceleration: wp.array3d(dtype=wp.vec3),
    ):
        """Clears the last force (`clear_force`), reads u* (`read_cells`), sets F0 (`set_target`), spreads all F (`spread`)."""
        tid = wp.tid()
        k, lane = tid // wp.static(lanes), tid % wp.static(lanes)
        if tid == 0:
            for x in range(3):
                acts[x] = wp.where(wraps[x] == 1, corner[x], int(host[at.box + x]))
                acts[x + 3] = acts[x] + wp.where(wraps[x] == 1, shape[x], box[x])
        old, here, cell, normal = pushed[k], store[k], low_cell[k], normals[k]
        slides_by, push = slip[k], volume[k]
        u = wp.vec3(0.0, 0.0, 0.0)
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(here[0] + i, shape[0]), wrap(here[1] + j, shape[1]), wrap(here[2] + l, shape[2])
            rho, momentum = pulled(f, x, y, z, shape)
            weight = weights[wp.static(cells) * k + o]
            # divided by the local density, so that sum rho G = sum V F; otherwise the water would gain rho times the force
            thinned[wp.static(cells) * k + o] = weight / rho
            u += weight * (momentum / rho + body_acceleration)
            o += wp.static(lanes)
        o = int(lane)
        while o < wp.static(cells):  # what the last step pushed
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(old[0] + i, shape[0]), wrap(old[1] + j, shape[1]), wrap(old[2] + l, shape[2])
            acceleration[x, y, z] = wp.vec3(0.0, 0.0, 0.0)
            o += wp.static(lanes)
        met = wp.vec3(over_warp(u[0]), over_warp(u[1]), over_warp(u[2]))
        if lane == 0:
            force[k, 0] = slides_by * (met - wp.dot(met, normal) * normal) - met
            pushed[k] = here  # all lanes have read the old one: `over_warp` waits for them
        wait_for_warp()
        e = int(lane)
        while e < wp.static(cells) * (at.dofs + 1):
            o = e // (at.dofs + 1)
            side = e - o * (at.dofs + 1)
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            value = thinned[wp.static(cells) * k + o] * (push * force[k, side])
            wp.atomic_add(scratch, cell[0] + i, cell[1] + j, cell[2] + l, side, value)
            e += wp.static(lanes)

    @wp.kernel(module=module, grid_stride=False)
    def answer(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        markers: int,
        chunk: int,
        jacobian: wp.array2d(dtype=wp.vec3),
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
        """Does the second pass (`correct`), sums K and b0 (`response_part`, `response_total`), and solves for v+ (`solve`)."""
        tid, threads = wp.tid(), wp.block_dim()
        me, block = tid % threads, tid // threads
        sides = at.dofs + 1
        begin = block * chunk
        end = wp.min(begin + chunk, markers)
        item, g = me // wp.static(group), me % wp.static(group)
        while item < (end - begin) * sides:
            k, r = begin + item // sides, item % sides
            p, got = low_cell[k], wp.vec3(0.0, 0.0, 0.0)
            for turn in range(wp.static(-(-cells // group))):
                o = turn * wp.static(group) + g
                if o < wp.static(cells):
                    i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
                    got += weights[wp.static(cells) * k + o] * scratch[p[0] + i, p[1] + j, p[2] + l, r]
            got = wp.vec3(over_group(got[0]), over_group(got[1]), over_group(got[2]))
            if g == 0:
                wanted = force[k, r]
                force[k, r] = wanted + wanted - got
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
        ends = ends_last(done, part.shape[0])
        if ends == 1 and wp.static(on_gpu) and at.dofs <= wp.static(MOST):
            if me == 0:
                done[0] = 0
            finish_response(
                part, part.shape[0], scale, host, at.system, at.momentum, at.fixed, at.value, at.dofs, water, pivots, v, target,
                me, threads,
            )  # fmt: skip
        elif ends == 1:
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

    @wp.kernel(module=module, grid_stride=False)
    def push(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        before: wp.array(dtype=int),
        after: wp.array(dtype=int),
        share: wp.array(dtype=wp.float64),
        volume: wp.array(dtype=float),
        world: wp.array(dtype=wp.vec3d),
        store: wp.array(dtype=wp.vec3i),
        low_cell: wp.array(dtype=wp.vec3i),
        thinned: wp.array(dtype=float),
        force: wp.array2d(dtype=wp.vec3),
        v: wp.array(dtype=wp.float64),
        shape: wp.vec3i,
        impulse: wp.float64,
        final: wp.array(dtype=wp.vec3),
        scratch: wp.array4d(dtype=wp.vec3),
        acceleration: wp.array3d(dtype=wp.vec3),
        wrench: wp.array2d(dtype=wp.float64),
    ):
        """Computes the final force (`combine`), adds it to G (`spread_force`), sums the wrench (`wrench`), clears `scratch`."""
        tid = wp.tid()
        k, lane = tid // wp.static(lanes), tid % wp.static(lanes)
        total = force[k, 0]
        for d in range(at.dofs):
            total += float(v[d]) * force[k, d + 1]
        if lane == 0:
            final[k] = total
        whole, p, here = volume[k] * total, low_cell[k], store[k]
        o = int(lane)
        while o < wp.static(cells):
            i, j, l = o // wp.static(width**2), (o // wp.static(width)) % wp.static(width), o % wp.static(width)
            x, y, z = wrap(here[0] + i, shape[0]), wrap(here[1] + j, shape[1]), wrap(here[2] + l, shape[2])
            wp.atomic_add(acceleration, x, y, z, thinned[wp.static(cells) * k + o] * whole)
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

    return place, look, answer, push


class MarkerWarps:
    """Runs the four kernels over the arrays of a `Boundary` with two passes, and owns their additional arrays."""

    def __init__(self, boundary: Boundary, number: type = wp.float32):
        b, device = boundary, boundary.device
        self.boundary, on_gpu = boundary, device.is_cuda
        self._place, self._look, self._answer, self._push = marker_kernels(b.width, on_gpu, number)
        self._threads = b.count * (LANES if on_gpu else 1)
        least, most = fsi_solve.BLOCK // (GROUP * b.rhs), -(-b.count // BLOCKS)
        self._chunk = max(1, least, most) if on_gpu else b.count  # markers of a block in `answer`
        blocks = -(-b.count // self._chunk)
        self._answering = blocks * (fsi_solve.BLOCK if on_gpu else 1)
        empty = lambda shape, dtype: wp.zeros(shape, dtype=dtype, device=device)
        self._low_cell, self._pushed, self._done = empty(b.count, wp.vec3i), empty(b.count, wp.vec3i), empty(1, wp.int32)
        self._weights, self._thinned = (empty(b.count * b.width**3, wp.float32) for _ in range(2))
        self._velocity = empty(b.dofs, wp.float64)
        self._part = empty((blocks, b.dofs, b.rhs), wp.float64)

    def begin(self) -> None:
        """Queues the clearing of the scratch box, which another user may have left filled."""
        self.boundary.scratch.zero_()

    def place(self) -> None:
        """Queues `place`: all that follows from the pose of the body in `boundary.host` without the water."""
        b, lat = self.boundary, self.boundary.lattice
        args = [b.host, b.layout, b.rest, b.rest_normal, b.pivot, b.before, b.after, b.share, b.moves, b.slides, b.slips]
        found = [b.world, b.normal, b.store, b.jacobian, self._low_cell, self._weights, b.force]
        self._launch(self._place, self._threads, [*args, lat.dx, lat.dt, wp.vec3i(*b.shape), *found])

    def look(self, f: wp.array, corner: wp.array, acts: wp.array, acceleration: wp.array) -> None:
        """Queues `look`; arguments as `Boundary.assemble_response`, and the fluid's G, in which the last force is cleared."""
        b = self.boundary
        args = [b.host, b.layout, b.slips, b.volume, wp.vec3i(*b.shape), wp.vec3i(*b.box_shape), b.wraps, corner, f]
        args += [b.body_acceleration, b.normal, b.store, self._low_cell, self._weights]
        found = [acts, self._pushed, self._thinned, b.force, b.scratch]
        self._launch(self._look, self._threads, [*args, *found, acceleration])

    def answer(self) -> None:
        """Queues `answer`: K, b0 and v+."""
        b, lat = self.boundary, self.boundary.lattice
        scale = lat.mass * lat.velocity**2 * lat.dt / lat.dx * lat.velocity
        args = [b.host, b.layout, b.count, self._chunk, b.jacobian, b.volume, self._low_cell, self._weights, b.scratch, scale]
        args += [b.force, self._part, self._done, b.water, *b.elimination, self._velocity, b.target]
        self._launch(self._answer, self._answering, args)

    def push(self, acceleration: wp.array) -> None:
        """Queues `push`: the force into the fluid's G, and the wrench on the links."""
        b, lat = self.boundary, self.boundary.lattice
        args = [b.host, b.layout, b.before, b.after, b.share, b.volume, b.world, b.store, self._low_cell, self._thinned, b.force]
        args += [b.target, wp.vec3i(*b.shape), lat.mass * lat.velocity, b.final, b.scratch, acceleration, b.wrench_sum]
        self._launch(self._push, self._threads, args)

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.boundary.device, block_dim=fsi_solve.BLOCK)
