"""Small dense work on the device: K and b0 from the markers, the joint-space solve, and the wrench on every link.

Sums run in float64 and in a fixed order (markers of a chunk, then chunks) without atomics. They repeat to the bit, on the CPU
and on a GPU.
"""

import warp as wp

from fishmj.lbm_oracle.fluid.storage import point3
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays

wp.set_module_options({"enable_backward": False})

BLOCK = 256  # threads of the one block that solves on a GPU: Warp's own number, with any other the module is compiled twice
MOST = 24  # degrees of freedom that are solved for in shared memory (`finish_response`)
WARP = 32  # of them run in step: they take the columns of a row, or the chunks of a sum, and read and write side by side

SUM_OVER_WARP = """
#if defined(__CUDA_ARCH__)
    for (int o = 16; o > 0; o /= 2) x += __shfl_xor_sync(0xffffffffu, x, o);
#endif
    return x;
"""  # the sum of a number of any kind over the lanes of a warp


@wp.kernel
def fetch(sent: wp.array(dtype=wp.float64), host: wp.array(dtype=wp.float64)):
    """Copies the host's block from the host's memory."""
    k = wp.tid()
    host[k] = sent[k]


@wp.kernel
def response_part(
    jacobian: wp.array2d(dtype=wp.vec3),
    volume: wp.array(dtype=float),
    force: wp.array2d(dtype=wp.vec3),
    part: wp.array3d(dtype=wp.float64),
):
    """part[c, i, r] = sum over the markers of chunk c of V_k J_k,i . F_k,r; r = 0 is b0, the rest K."""
    c, i, r = wp.tid()
    total = wp.float64(0.0)
    k = c
    while k < volume.shape[0]:
        total += wp.float64(volume[k] * wp.dot(jacobian[k, i], force[k, r]))
        k += part.shape[0]
    part[c, i, r] = total


@wp.func_native(SUM_OVER_WARP)
def sum_over_warp(x: wp.float64) -> wp.float64:
    """Sum of x over the lanes of a warp."""
    ...


@wp.func
def sum_over_chunks(part: wp.array3d(dtype=wp.float64), i: int, j: int, lane: int, lanes: int):
    """Sum over c of part[c, i, j], by the lanes of a warp together; by one thread on the CPU."""
    s = wp.float64(0.0)
    c = int(lane)
    while c < part.shape[0]:
        s += part[c, i, j]
        c += lanes
    return sum_over_warp(s)


@wp.kernel
def response_total(part: wp.array3d(dtype=wp.float64), scale: wp.float64, lanes: int, total: wp.array2d(dtype=wp.float64)):
    """total[i, r] = scale sum_c part[c, i, r]."""
    i, r, lane = wp.tid()
    s = sum_over_chunks(part, i, r, lane, lanes)
    if lane == 0:
        total[i, r] = scale * s


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def wait_for_block():
    """Waits for all threads of the block; does nothing on the CPU."""
    ...


@wp.func_native("return values.data[i];")  # plain: Warp's own index folds and multiplies, in loops that wait for each load
def read(values: wp.array(dtype=wp.float64), i: int) -> wp.float64:
    """Plain load of a double."""
    ...


@wp.func_native("return values.data[i];")
def read(values: wp.array(dtype=wp.int32), i: int) -> wp.int32:  # noqa: F811  an overload
    """Plain load of an integer."""
    ...


@wp.func_native("values.data[i] = value;")
def write(values: wp.array(dtype=wp.float64), i: int, value: wp.float64):
    """Plain store of a double."""
    ...


@wp.func
def assemble_system(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    water: wp.array2d(dtype=wp.float64),
    implicit: int,
    rows: wp.array(dtype=wp.float64),
    step: wp.array(dtype=int),
    me: int,
    threads: int,
):
    """Assembles [A + K | right - b0] in `rows`; a prescribed velocity replaces its row."""
    n, k, i = at.dofs, int(me), int(me)
    while k < n * n:
        row = k // n
        column = k - n * row
        entry = host[at.system + k]  # the host's side, which came while K was made up
        if implicit == 1:
            entry += water[row, column + 1]
        held = wp.where(row == column, wp.float64(1.0), wp.float64(0.0))
        write(rows, k + row, wp.where(host[at.fixed + row] < wp.float64(0.5), entry, held))
        k += threads
    while i < n:
        right = host[at.momentum + i] - water[i, 0]
        if implicit == 0:
            for j in range(n):
                right -= water[i, j + 1] * host[at.before + j]
        write(rows, n * (i + 1) + i, wp.where(host[at.fixed + i] < wp.float64(0.5), right, host[at.value + i]))
        step[i] = n  # not a pivot's yet
        i += threads


@wp.func
def pivot_row(rows: wp.array(dtype=wp.float64), step: wp.array(dtype=int), p: int, n: int) -> int:
    """First row with the greatest entry in column p, of the rows that no earlier step took."""
    found, greatest = int(n), wp.float64(0.0)
    for i in range(n):
        size = wp.abs(read(rows, (n + 1) * i + p))
        # >= p: a faster thread may already have written this step's choice
        if read(step, i) >= p and (found == n or size > greatest):
            found, greatest = i, size
    return found


@wp.func
def solve_block(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    water: wp.array2d(dtype=wp.float64),
    implicit: int,
    rows: wp.array(dtype=wp.float64),
    step: wp.array(dtype=int),
    pivots: wp.array(dtype=int),
    v: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
    me: int,
    threads: int,
):
    """Does the work of `solve` in thread `me` of a block of `threads`, all of which call it."""
    n = at.dofs
    wide = n + 1
    across = wp.min(threads, wp.static(WARP))
    column, row, down = me % across, me // across, threads // across
    assemble_system(host, at, water, implicit, rows, step, me, threads)
    wait_for_block()
    # pivots although M is symmetric: K is symmetric only without slip, and a row that a tether replaced is not
    for p in range(n):
        found = pivot_row(rows, step, p, n)  # every thread finds the same: one wait less than if one told the others
        if me == 0:
            step[found] = p
            pivots[p] = found
        i = int(row)
        while i < n:
            if i != found and read(step, i) > p:
                ratio = read(rows, wide * i + p) / read(rows, wide * found + p)
                j = p + 1 + column
                while j <= n:
                    write(rows, wide * i + j, read(rows, wide * i + j) - ratio * read(rows, wide * found + j))
                    j += across
            i += down
        wait_for_block()
    if me == 0:  # from the last to the first, each in the place of its right-hand side
        for back in range(n):
            p = n - 1 - back
            start = wide * pivots[p]
            rest = read(rows, start + n)
            for j in range(p + 1, n):
                rest -= read(rows, start + j) * read(rows, wide * read(pivots, j) + n)
            write(rows, start + n, rest / read(rows, start + p))
    wait_for_block()
    k = int(me)
    while k < n:
        x = read(rows, wide * pivots[k] + n)
        v[k] = x
        # the explicit scheme pushes the water with the old velocity
        target[k] = wp.where(implicit == 0 and host[at.fixed + k] < wp.float64(0.5), host[at.before + k], x)
        k += threads


@wp.kernel
def solve(
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    water: wp.array2d(dtype=wp.float64),
    implicit: int,
    rows: wp.array(dtype=wp.float64),
    step: wp.array(dtype=int),
    pivots: wp.array(dtype=int),
    v: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
):
    """Solves (A + K) v = right - b0 by elimination with pivots; prescribed velocities replace their rows.

    One block of threads for any number n of degrees of freedom; one thread on the CPU. The loops are not unrolled: unrolled for
    n, with the matrix in the registers of one thread, they take minutes to compile from n = 18 on.

    Args:
        implicit: 0 is the explicit coupling (the water sees the old velocity), kept to show that it fails.
        rows: n (n + 1), the matrix and the right-hand side by rows. step: (n,) step in which each row is the pivot row.
        pivots: (n,) row of each step.
    """
    solve_block(host, at, water, implicit, rows, step, pivots, v, target, wp.tid(), wp.block_dim())


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
def finishes_last(done: wp.array(dtype=wp.int32), blocks: int) -> int:
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


@wp.kernel
def wrench(
    world: wp.array(dtype=wp.vec3d),
    before: wp.array(dtype=int),
    after: wp.array(dtype=int),
    share: wp.array(dtype=wp.float64),
    volume: wp.array(dtype=float),
    final: wp.array(dtype=wp.vec3),
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    part: wp.array3d(dtype=wp.float64),
):
    """part[c, l] = impulse (3) of the water on link l and its moment (3) about the link's origin, before scaling to SI.

    A marker of the bend zone acts on its two links by its share.
    """
    c, l = wp.tid()
    push, turn = wp.vec3d(), wp.vec3d()
    origin = point3(host, at.frame + 12 * l)
    k = c
    while k < volume.shape[0]:
        force, place, s, v = final[k], world[k], share[k], volume[k]  # all loads at once, whoever needs them
        w = wp.float64(0.0)  # a thread sums for one link: atomics over links would add in another order every time
        if before[k] == l:
            w += wp.float64(1.0) - s
        if after[k] == l:
            w += s
        if w > wp.float64(0.0):
            f = (-w * wp.float64(v)) * wp.vec3d(wp.float64(force[0]), wp.float64(force[1]), wp.float64(force[2]))
            push += f
            turn += wp.cross(place - origin, f)
        k += part.shape[0]
    for i in range(3):
        part[c, l, i] = push[i]
        part[c, l, 3 + i] = turn[i]


@wp.kernel
def add_wrench(
    part: wp.array3d(dtype=wp.float64),
    scale: wp.float64,
    lanes: int,
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    total: wp.array2d(dtype=wp.float64),
    on_host: wp.array2d(dtype=wp.float64),
):
    """total[l] += scale sum_c part[c, l]; it restarts from zero after the host has read the sum. `on_host` is the host's copy."""
    l, i, lane = wp.tid()
    s = sum_over_chunks(part, l, i, lane, lanes)
    if lane == 0:
        before = wp.where(host[at.reset_wrench] > wp.float64(0.5), wp.float64(0.0), total[l, i])
        total[l, i] = before + scale * s
        on_host[l, i] = before + scale * s
