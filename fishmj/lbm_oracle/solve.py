"""Small dense work on the device: K and b0 from the markers, the joint-space solve, and the wrench on every link.

Sums run in float64 and in a fixed order (chunks of markers, then chunks), so that a run repeats to the bit on the CPU and
no atomics of these sums differ on a GPU.
"""

import warp as wp

from fishmj.lbm_oracle.immersed import Layout

wp.set_module_options({"enable_backward": False})


@wp.kernel
def weigh(
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
def gather(part: wp.array3d(dtype=wp.float64), scale: wp.float64, total: wp.array2d(dtype=wp.float64)):
    """total[i, r] = scale sum_c part[c, i, r]."""
    i, r = wp.tid()
    s = wp.float64(0.0)
    for c in range(part.shape[0]):
        s += part[c, i, r]
    total[i, r] = scale * s


@wp.kernel
def solve(
    host: wp.array(dtype=wp.float64),
    at: Layout,
    water: wp.array2d(dtype=wp.float64),
    implicit: int,
    a: wp.array2d(dtype=wp.float64),
    v: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
):
    """(A + K) v = right - b0 by elimination with pivots; prescribed velocities replace their rows.

    implicit = 0 is the explicit coupling (the water sees the old velocity), kept to show that it fails.
    """
    n = at.dofs
    for i in range(n):
        right = host[at.momentum + i] - water[i, 0]
        for j in range(n):
            a[i, j] = host[at.system + n * i + j]
            if implicit == 1:
                a[i, j] = a[i, j] + water[i, j + 1]
            else:
                right -= water[i, j + 1] * host[at.before + j]
        if host[at.fixed + i] > wp.float64(0.5):
            for j in range(n):
                a[i, j] = wp.float64(0.0)
            a[i, i] = wp.float64(1.0)
            right = host[at.value + i]
        a[i, n] = right
    for p in range(n):
        best = int(p)
        for i in range(p + 1, n):
            if wp.abs(a[i, p]) > wp.abs(a[best, p]):
                best = i
        for j in range(p, n + 1):
            keep = a[p, j]
            a[p, j] = a[best, j]
            a[best, j] = keep
        for i in range(p + 1, n):
            ratio = a[i, p] / a[p, p]
            for j in range(p, n + 1):
                a[i, j] = a[i, j] - ratio * a[p, j]
    for back in range(n):
        i = n - 1 - back
        s = a[i, n]
        for j in range(i + 1, n):
            s -= a[i, j] * v[j]
        v[i] = s / a[i, i]
    for i in range(n):
        target[i] = v[i]
        if implicit == 0 and host[at.fixed + i] < wp.float64(0.5):
            target[i] = host[at.before + i]


@wp.kernel
def wrench(
    world: wp.array(dtype=wp.vec3d),
    before: wp.array(dtype=int),
    after: wp.array(dtype=int),
    share: wp.array(dtype=wp.float64),
    volume: wp.array(dtype=float),
    final: wp.array(dtype=wp.vec3),
    host: wp.array(dtype=wp.float64),
    at: Layout,
    part: wp.array2d(dtype=wp.spatial_vectord),
):
    """part[c, l] = impulse of the water on link l and its moment about the link's origin, before scaling to SI.

    A marker of the bend zone pushes on its two links by its share. spatial_vectord holds (force, moment).
    """
    c, l = wp.tid()
    push, turn = wp.vec3d(), wp.vec3d()
    origin = wp.vec3d(host[at.frame + 12 * l], host[at.frame + 12 * l + 1], host[at.frame + 12 * l + 2])
    k = c
    while k < volume.shape[0]:
        w = wp.float64(0.0)
        if before[k] == l:
            w += wp.float64(1.0) - share[k]
        if after[k] == l:
            w += share[k]
        if w > wp.float64(0.0):
            f = (-w * wp.float64(volume[k])) * wp.vec3d(wp.float64(final[k][0]), wp.float64(final[k][1]), wp.float64(final[k][2]))
            push += f
            turn += wp.cross(world[k] - origin, f)
        k += part.shape[0]
    part[c, l] = wp.spatial_vectord(push[0], push[1], push[2], turn[0], turn[1], turn[2])


@wp.kernel
def add_wrench(
    part: wp.array2d(dtype=wp.spatial_vectord),
    scale: wp.float64,
    host: wp.array(dtype=wp.float64),
    at: Layout,
    total: wp.array2d(dtype=wp.float64),
):
    """total[l] += scale sum_c part[c, l], from zero where the host has taken the sum so far."""
    l = wp.tid()
    s = wp.spatial_vectord()
    for c in range(part.shape[0]):
        s += part[c, l]
    for i in range(6):
        before = wp.where(host[at.fresh] > wp.float64(0.5), wp.float64(0.0), total[l, i])
        total[l, i] = before + scale * s[i]
