"""D3Q19: nineteen velocities c_i, weights w_i, speed of sound c_s = 1/sqrt 3.

    sum_i w_i = 1,   sum_i w_i c_ia c_ib = c_s^2 delta_ab,   opposite of i: c_j = -c_i

Source: Qian, d'Humieres, Lallemand 1992, Europhys. Lett. 17:479. The order is by opposite pairs, so that the opposite of
an odd i is i + 1 and of an even i > 0 is i - 1.
"""

import numpy as np
import warp as wp

Q = 19
_HALF = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)]
C = ((0, 0, 0), *(tuple(sign * a for a in c) for c in _HALF for sign in (1, -1)))
W = (1 / 3, *(1 / 18,) * 6, *(1 / 36,) * 12)
CS2 = 1 / 3  # c_s^2
CS = CS2**0.5

VELOCITIES = np.array(C)  # (19, 3)
WEIGHTS = np.array(W)  # (19,)

vec19 = wp.types.vector(length=Q, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)  # symmetric tensor: xx, yy, zz, xy, xz, yz


def index_of(c) -> int:
    """The number of a velocity."""
    return C.index(tuple(int(a) for a in c))


def opposite(i: int) -> int:
    return index_of(-VELOCITIES[i])


def mirrored(i: int, *axes: int) -> int:
    """The velocity that a specular reflection on the planes normal to `axes` turns into i."""
    c = VELOCITIES[i].copy()
    c[list(axes)] *= -1
    return index_of(c)


@wp.func
def wrap(i: int, n: int) -> int:
    """i modulo n in 0 .. n - 1, for negative i too: the world's node in memory."""
    r = i % n
    if r < 0:
        r += n
    return r
