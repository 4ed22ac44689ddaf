"""Offset between two clocks from the motion of two channels: the shift of the whole records at which their rates fit best."""

import numpy as np

from fishmj.log.trial import gaps

REACH = 0.4  # s, largest lag looked for
LONGEST = 5_000_000  # points of the common grid: 83 minutes at 1 ms
LEAST = 4.0  # s of the shorter record from which on an offset is looked for
SURE, OTHER, CLOSE = 0.6, 0.8, 0.25  # least correlation of an offset; part of it that no other shift reaches, but within CLOSE s


def offset_between(
    earlier: tuple[str, np.ndarray, np.ndarray], later: tuple[str, np.ndarray, np.ndarray], *, either_sign: bool = False
) -> tuple[float, float] | None:
    """Clock offset as (excess of the stamps of `later` [s], correlation), or None if the motion shows no more than a lag.

    The whole records are laid over each other at every shift that leaves half of the shorter in common. The best shift must be
    beyond `REACH`, and no other may be nearly as good, because a steady beat also fits itself one beat later.
    """
    (_, ta, a), (_, tb, b) = earlier, later
    n = min(a.shape[1], b.shape[1])
    if min(len(ta), len(tb)) < 8 or not n:
        return None
    step = max(float(np.median(np.diff(ta))), float(np.median(np.diff(tb))))
    grids = [np.arange(t[0], t[-1], step) for t in (ta, tb)]
    shortest = min(map(len, grids))
    if shortest * step < LEAST or sum(map(len, grids)) > LONGEST:
        return None
    one, two = (rates(t, v[:, :n], grid, 1.5) for t, v, grid in zip((ta, tb), (a, b), grids, strict=True))
    length = 1 << int(np.ceil(np.log2(len(one) + len(two))))
    spectrum = np.conj(np.fft.rfft(one, length, axis=0)) * np.fft.rfft(two, length, axis=0)
    product = np.fft.irfft(spectrum, length, axis=0).sum(axis=1)
    shifts = np.arange(-(len(one) - shortest // 2), len(two) - shortest // 2 + 1)  # rows of two behind those of one
    first, last = np.maximum(0, -shifts), np.minimum(len(one), len(two) - shifts)
    sums = [np.concatenate([[0.0], np.cumsum(np.sum(v**2, axis=1))]) for v in (one, two)]
    energy = (sums[0][last] - sums[0][first]) * (sums[1][last + shifts] - sums[1][first + shifts])
    curve = product[shifts] / np.sqrt(np.maximum(energy, 1e-6 * sums[0][-1] * sums[1][-1]) + 1e-300)
    curve = np.abs(curve) if either_sign else curve
    best = int(np.argmax(curve))
    offset = float(tb[0] - ta[0] + shifts[best] * step)
    inner = np.flatnonzero((curve[1:-1] >= curve[:-2]) & (curve[1:-1] > curve[2:])) + 1
    others = curve[inner[np.abs(inner - best) * step > CLOSE]]
    if abs(offset) <= REACH or curve[best] < SURE or np.any(others > OTHER * curve[best]):
        return None
    return offset, float(curve[best])


def in_common(one: np.ndarray, two: np.ndarray) -> tuple[float, float]:
    """(seconds that two tables' stamps have in common, negative where they are apart; its share of the longer)."""
    both = float(min(one[-1], two[-1]) - max(one[0], two[0]))
    return both, both / max(float(np.ptp(one)), float(np.ptp(two)), 1e-9)


def rates(t: np.ndarray, values: np.ndarray, grid: np.ndarray, blur: float) -> np.ndarray:
    """Smoothed rates (G, N) on the grid, less their mean; zero inside gaps."""
    reach = int(np.ceil(4 * blur))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(blur, 1e-9)) ** 2)
    kernel /= kernel.sum()
    step = grid[1] - grid[0]
    out = np.zeros((len(grid), values.shape[1]))
    for k in range(values.shape[1]):
        curve = np.interp(grid, t, values[:, k])
        smooth = np.convolve(np.pad(curve, reach, mode="edge"), kernel, mode="valid")
        out[:, k] = np.gradient(smooth, step)
    for i in gaps(t):
        out[(grid > t[i] - 4 * blur * step) & (grid < t[i + 1] + 4 * blur * step)] = 0.0
    return out - out.mean(axis=0)
