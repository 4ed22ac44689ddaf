"""Vector types and functions of Warp that kernels take from the lattice and the faces, whose plain halves need no Warp."""

import warp as wp

from fishmj.lbm_oracle.fluid.lattice import CS, Q

vec19 = wp.types.vector(length=Q, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)  # symmetric tensor: xx, yy, zz, xy, xz, yz
vec6i = wp.types.vector(length=6, dtype=wp.int32)
vec19i = wp.types.vector(length=Q, dtype=wp.int32)
_CS = wp.constant(CS)


@wp.func
def wrap(i: int, n: int) -> int:
    """i modulo n in 0 .. n - 1, for negative i too: the place of a world node in memory."""
    r = i % n
    if r < 0:
        r += n
    return r


@wp.func
def dragged(six_w: float, c: wp.vec3, wall_velocity: wp.vec3):
    """Momentum that a population takes from a sliding wall."""
    return six_w * wp.dot(c, wall_velocity)


@wp.func
def characteristic(drho: float, u: wp.vec3, target: wp.vec3, n: wp.vec3):
    """Density and velocity of an open node with outward normal n, computed from those of its inner neighbour."""
    away = u - target
    normal = wp.dot(away, n)
    # the incoming wave is set to zero, not extrapolated: that returns a tenth of a pulse (docs/solver/method.md)
    leaving = 0.5 * (_CS * drho + normal)
    enters = wp.dot(target, n) < 0.0
    more = wp.where(enters, leaving, leaving - normal)
    for a in range(3):  # no branch, and number by number: rows.py makes vector instructions of it
        u[a] = wp.where(enters, target[a], u[a]) + more * n[a]
    return leaving / _CS, u


@wp.func
def ramp(low: bool, high: bool, position: int, size: int, width: int):
    """Sponge ramp along one axis: 0 in the interior, up to 1 at the last node of a face with a sponge."""
    depth = wp.max(wp.where(low, width - position, 0), wp.where(high, position - (size - 1 - width), 0))
    s = wp.clamp(float(depth) / float(width), 0.0, 1.0)
    return s * s
