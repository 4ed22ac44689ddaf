"""Small dense work on the device: K and b0 from the markers, the joint-space solve, and the wrench on every link.

Sums run in float64 and in a fixed order (chunks of markers, then chunks), so that a run repeats to the bit on the CPU and
no atomics of these sums differ on a GPU.
"""

from functools import cache

import warp as wp

from fishmj.lbm_oracle.fluid.storage import point3
from fishmj.lbm_oracle.immersed.kernels import CouplingArrays

wp.set_module_options({"enable_backward": False})


@wp.kernel
def fetch(sent: wp.array(dtype=wp.float64), host: wp.array(dtype=wp.float64)):
    """What the host sent, out of its own memory."""
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


@wp.kernel
def response_total(part: wp.array3d(dtype=wp.float64), scale: wp.float64, total: wp.array2d(dtype=wp.float64)):
    """total[i, r] = scale sum_c part[c, i, r]."""
    i, r = wp.tid()
    s = wp.float64(0.0)
    for c in range(part.shape[0]):
        s += part[c, i, r]
    total[i, r] = scale * s


@cache
def solver(n: int) -> wp.Kernel:
    """The kernel for n degrees of freedom. Every index is known beforehand: its one thread keeps the matrix in registers."""
    rows = wp.types.matrix(shape=(n, n + 1), dtype=wp.float64)
    column = wp.types.vector(length=n, dtype=wp.float64)
    module = wp.get_module(f"{__name__}.{n}")  # by name: Warp's own do not see static expressions that depend on an unrolled loop
    wp.set_module_options({"enable_backward": False, "max_unroll": n + 1}, module)

    @wp.kernel(module=module)
    def solve(
        host: wp.array(dtype=wp.float64),
        at: CouplingArrays,
        water: wp.array2d(dtype=wp.float64),
        implicit: int,
        v: wp.array(dtype=wp.float64),
        target: wp.array(dtype=wp.float64),
    ):
        """(A + K) v = right - b0 by elimination with pivots; prescribed velocities replace their rows.

        implicit = 0 is the explicit coupling (the water sees the old velocity), kept to show that it fails.
        """
        a, x = rows(), column()
        for i in range(wp.static(n)):
            free = host[at.fixed + i] < wp.float64(0.5)
            right = host[at.momentum + i] - water[i, 0]
            for j in range(wp.static(n)):
                response = water[i, j + 1]
                entry = host[at.system + n * i + j]  # the host's side, which came while K was made up
                if implicit == 1:
                    entry += response
                else:
                    right -= response * host[at.before + j]
                a[i, j] = wp.where(free, entry, wp.where(wp.static(i == j), wp.float64(1.0), wp.float64(0.0)))
            a[i, wp.static(n)] = wp.where(free, right, host[at.value + i])
        # pivots, though M is symmetric: K is so only without slip, and a row that a tether replaced is not
        for p in range(wp.static(n)):
            for i in range(wp.static(n)):
                if wp.static(i > p):
                    swap = wp.abs(a[i, p]) > wp.abs(a[p, p])  # after the last of them, row p has the greatest
                    for j in range(wp.static(n + 1)):
                        upper, lower = wp.where(swap, a[i, j], a[p, j]), wp.where(swap, a[p, j], a[i, j])
                        a[p, j] = upper
                        a[i, j] = lower
            for i in range(wp.static(n)):
                if wp.static(i > p):
                    ratio = a[i, p] / a[p, p]
                    for j in range(wp.static(n + 1)):
                        if wp.static(j >= p):
                            a[i, j] = a[i, j] - ratio * a[p, j]
        for back in range(wp.static(n)):
            rest = a[wp.static(n - 1 - back), wp.static(n)]
            for j in range(wp.static(n)):
                if wp.static(j > n - 1 - back):
                    rest -= a[wp.static(n - 1 - back), j] * x[j]
            x[wp.static(n - 1 - back)] = rest / a[wp.static(n - 1 - back), wp.static(n - 1 - back)]
        for i in range(wp.static(n)):
            v[i] = x[i]
            old = implicit == 0 and host[at.fixed + i] < wp.float64(0.5)
            # the explicit scheme pushes the water by the old velocity, which is what makes it explicit
            target[i] = wp.where(old, host[at.before + i], x[i])

    return solve


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

    A marker of the bend zone pushes on its two links by its share.
    """
    c, l = wp.tid()
    push, turn = wp.vec3d(), wp.vec3d()
    origin = point3(host, at.frame + 12 * l)
    k = c
    while k < volume.shape[0]:
        w = wp.float64(0.0)  # a thread sums for one link: atomics over links would add in another order every time
        if before[k] == l:
            w += wp.float64(1.0) - share[k]
        if after[k] == l:
            w += share[k]
        if w > wp.float64(0.0):
            f = (-w * wp.float64(volume[k])) * wp.vec3d(wp.float64(final[k][0]), wp.float64(final[k][1]), wp.float64(final[k][2]))
            push += f
            turn += wp.cross(world[k] - origin, f)
        k += part.shape[0]
    for i in range(3):
        part[c, l, i] = push[i]
        part[c, l, 3 + i] = turn[i]


@wp.kernel
def add_wrench(
    part: wp.array3d(dtype=wp.float64),
    scale: wp.float64,
    host: wp.array(dtype=wp.float64),
    at: CouplingArrays,
    total: wp.array2d(dtype=wp.float64),
    on_host: wp.array2d(dtype=wp.float64),
):
    """total[l] += scale sum_c part[c, l], from zero where the host has taken the sum so far; `on_host` is the host's copy."""
    l, i = wp.tid()
    s = wp.float64(0.0)
    for c in range(part.shape[0]):
        s += part[c, l, i]
    before = wp.where(host[at.fresh] > wp.float64(0.5), wp.float64(0.0), total[l, i])
    total[l, i] = before + scale * s
    on_host[l, i] = before + scale * s
