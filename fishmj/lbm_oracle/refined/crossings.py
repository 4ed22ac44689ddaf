"""Lists of the populations that cross the faces of a box of finer cells, made once for each box for exchange.py."""

from functools import cache
from typing import Any

import numpy as np

from fishmj.lbm_oracle.fluid.lattice import RATIO, VELOCITIES, Q
from fishmj.lbm_oracle.refined.exchange import CELL_BITS

Cells = tuple[int, int, int]


@cache
def lists_of(size: Cells, ghost: Cells) -> tuple[np.ndarray, ...]:
    """Lists of `_entering`, `_leaving` and `_covered` for a box of `size` coarse cells: a second for a million fine cells."""
    coarse, width = np.array(size), np.array(ghost)
    return *_entering(coarse, width), *_leaving(coarse, width), *_covered(coarse, width)


def _shell(size: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Cells on both sides of the faces of a box, on the axes that have `ends`, (n, 3)."""
    r = np.indices(tuple(size + 2 * ends)).reshape(3, -1).T - ends
    return r[~np.all((r > 0) & (r < size - 1) | ~ends, 1)]


def _inside(r: np.ndarray, size: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Mask (...) of the cells (..., 3) that are in a box of `size` from (0, 0, 0) on; only axes that have `ends` count."""
    return np.all((r >= 0) & (r < size) | ~ends, -1)


def _words(at: np.ndarray, shape: np.ndarray, directions: Any = 0) -> np.ndarray:
    """Words (n,) int32 of cells (n, 3) of a box of `shape`, each with a direction (exchange.py, `CELL_BITS`)."""
    cells = np.ravel_multi_index(tuple(at.T), tuple(shape.tolist()))
    return (np.asarray(directions, np.int64) << CELL_BITS | cells).astype(np.uint32).view(np.int32)


def _arriving(x: np.ndarray, steps: int, size: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Bits (Q, n) of coarse cells (n, 3): one for each child that is in the box `steps` fine steps later.

    `size` in coarse cells.
    """
    bits = np.zeros((Q, len(x)), int)
    for child, r in enumerate(np.ndindex(RATIO, RATIO, RATIO)):
        for i, c in enumerate(VELOCITIES):
            bits[i] |= _inside(RATIO * x + r + steps * c, RATIO * size, ends).astype(int) << child
    return bits


def _entering(size: np.ndarray, ghost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of `explode` for a box of `size` coarse cells, by direction and in order of memory.

    Returns:
        Words (n,) of coarse cells beside the box; for each, bits (n,) of its children that count, as `explode` reads them.
    """
    ends, shape = ghost > 0, size + 2 * ghost
    x = _shell(size, ends)
    x = x[~_inside(x, size, ends)]
    first = _arriving(x, 1, size, ends)
    children = first | (_arriving(x, 2, size, ends) & ~first) << 8
    for child, r in enumerate(np.ndindex(RATIO, RATIO, RATIO)):  # at rest: those within a layer of the box
        children[0] |= _inside(RATIO * x + r + ghost, RATIO * size + 2 * ghost, ends).astype(int) << child
    direction, cell = np.nonzero(children)
    return _words(x[cell] + ghost, shape, direction), children[direction, cell].astype(np.int32)


def _leaving(size: np.ndarray, ghost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of `coalesce` for a box of `size` coarse cells, by direction.

    Returns:
        Words (n,) of coarse cells on both sides of the box's faces; for each, a bit (n,) for every child x with x + c_i in it.
    """
    ends, shape = ghost > 0, size + 2 * ghost
    x = _shell(size, ends)
    later = _arriving(x, 1, size, ends)
    moves = np.array([~_inside(x + c, size, ends) for c in VELOCITIES]) & (_inside(x, size, ends) | (later > 0))
    direction, cell = np.nonzero(moves)
    return _words(x[cell] + ghost, shape, direction), later[direction, cell].astype(np.int32)


def _covered(size: np.ndarray, ghost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of `restrict`, words as in `_leaving`: all coarse cells of a box, (n,), and those at its faces, (m,)."""
    cells = lambda r: _words(r + ghost, size + 2 * ghost)
    shell = _shell(size, ghost > 0)
    return cells(np.indices(tuple(size)).reshape(3, -1).T), cells(shell[_inside(shell, size, ghost > 0)])
