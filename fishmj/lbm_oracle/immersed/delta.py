"""Regularised delta functions: the same kernel interpolates and spreads, so that the two are adjoint.

    3-point (Roma 1999):     phi = (1 + sqrt(1 - 3 r^2)) / 3                         |r| <= 1/2
                             phi = (5 - 3|r| - sqrt(1 - 3 (1 - |r|)^2)) / 6          |r| <= 3/2
    4-point (Peskin 2002):   phi = (3 - 2|r| + sqrt(1 + 4|r| - 4 r^2)) / 8           |r| <= 1
                             phi = (5 - 2|r| - sqrt(-7 + 12|r| - 4 r^2)) / 8         |r| <= 2

r in cells. Both sum to one and conserve the first moment wherever the marker lies between the cells.
"""

import warp as wp

from fishmj.errors import UnknownName

WIDTHS = (3, 4)


@wp.func
def phi(r: float, width: int) -> float:
    """One-dimensional weight at distance r [cells] of the kernel with `width` points."""
    a = wp.abs(r)
    if width == 3:
        if a <= 0.5:
            return (1.0 + wp.sqrt(wp.max(1.0 - 3.0 * a * a, 0.0))) / 3.0
        if a <= 1.5:
            return (5.0 - 3.0 * a - wp.sqrt(wp.max(1.0 - 3.0 * (1.0 - a) * (1.0 - a), 0.0))) / 6.0
        return 0.0
    if a <= 1.0:
        return (3.0 - 2.0 * a + wp.sqrt(wp.max(1.0 + 4.0 * a - 4.0 * a * a, 0.0))) / 8.0
    if a <= 2.0:
        return (5.0 - 2.0 * a - wp.sqrt(wp.max(-7.0 + 12.0 * a - 4.0 * a * a, 0.0))) / 8.0
    return 0.0


@wp.func
def first(x: float, width: int) -> int:
    """Index of the first of the `width` cells that a marker at x [cells] touches."""
    if width == 3:
        return int(wp.floor(x + 0.5)) - 1
    return int(wp.floor(x)) - 1


@wp.func
def weight(x: wp.vec3, i: int, j: int, k: int, width: int) -> float:
    """Weight of the cell (i, j, k) for a marker at x; all in the same cell coordinates."""
    return phi(x[0] - float(i), width) * phi(x[1] - float(j), width) * phi(x[2] - float(k), width)


def check_width(width: int) -> int:
    """`width` if there is such a kernel."""
    if width not in WIDTHS:
        raise UnknownName("kernel width", str(width), WIDTHS)
    return width
