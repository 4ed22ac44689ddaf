"""What a rollout was between its samples: the cubic through values and rates, straight lines where only values are known.

Half of a search is asking for values at stamps, so the loops are compiled.
"""

from functools import cache

from fishmj.engines.numba_build import require_numba


def hermite(values, rates, h: float, t):
    """Cubic through samples (R, K, C) every h s with their rates, at times t (R, N); held outside. (R, N, C)."""
    return _loops()[0](values, rates, h, t)


def linear(values, h: float, t):
    """The same along straight lines, (R, K) at t (R, N): (R, N)."""
    return _loops()[1](values, h, t)


@cache
def _loops():
    import numpy as np

    numba = require_numba()

    @numba.njit(cache=True, nogil=True, error_model="numpy")
    def cubic(values, rates, h, t):
        rows, samples, columns = values.shape
        out = np.empty((rows, t.shape[1], columns))
        for r in range(rows):
            for n in range(t.shape[1]):
                place = min(max(t[r, n] / h, 0.0), samples - 1.000001)
                i = int(place)
                s = place - i
                for c in range(columns):
                    a, b, da, db = values[r, i, c], values[r, i + 1, c], h * rates[r, i, c], h * rates[r, i + 1, c]
                    out[r, n, c] = a + s * (da + s * (3.0 * (b - a) - 2.0 * da - db + s * (2.0 * (a - b) + da + db)))
        return out

    @numba.njit(cache=True, nogil=True, error_model="numpy")
    def straight(values, h, t):
        rows, samples = values.shape
        out = np.empty((rows, t.shape[1]))
        for r in range(rows):
            for n in range(t.shape[1]):
                place = min(max(t[r, n] / h, 0.0), samples - 1.000001)
                i = int(place)
                out[r, n] = values[r, i] + (place - i) * (values[r, i + 1] - values[r, i])
        return out

    return cubic, straight
