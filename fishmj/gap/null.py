"""What a fish without any missing effect looks like to this model: the empirical null.

    r_i = measured_i - predicted, i = 1..n     from an independent simulator: same commands, other constants within their
                                               tolerance, its own water, servos, network and noise
    S = (1/n) sum r_i r_i^T + D                scatter of those, and what they do not span, per channel and time
    z = S^-1/2 (measured - predicted)          mean square 1 when nothing is missing

The scatter carries the model-form error and every constant that a fit could turn, so nothing needs to be fitted before the
gap can be read, and an effect only counts as far as no combination of those explains it (generalised least squares with the
nuisance integrated out; Kennedy & O'Hagan 2001 with an empirical prior, Efron 2004). S is applied through n vectors.

D is what leave-one-out leaves unexplained: each r_i is predicted from the other n - 1 and its remainder averaged.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.features import Layout

RIDGE = 1e-9  # of the largest singular value
FLOOR = 0.5  # of the sensors' noise: D never goes below


class Whitening(NamedTuple):
    """S^-1/2 in parts: z = (x / d) - U ((1 - g) U^T (x / d))."""

    d: np.ndarray  # (m,)
    u: np.ndarray  # (m, n)
    g: np.ndarray  # (n,)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Whiten (..., m)."""
        x = x / self.d
        return x - ((x @ self.u) * (1.0 - self.g)) @ self.u.T


def whitening(residuals: np.ndarray, d: np.ndarray) -> Whitening:
    """From n null residuals (n, m) and D's square root (m,)."""
    scaled = residuals / d / np.sqrt(len(residuals))
    square, v = np.linalg.eigh(scaled @ scaled.T)
    keep = square > RIDGE * max(float(square[-1]), 1e-300)
    u = scaled.T @ (v[:, keep] / np.sqrt(square[keep]))
    return Whitening(d, u, 1.0 / np.sqrt(1.0 + square[keep]))


def leftover(residuals: np.ndarray, layout: Layout, noise: np.ndarray, rounds: int = 3) -> np.ndarray:
    """D^1/2 (m,): standard deviation of what the other null runs do not explain of one, smooth over time in each block.

    Starts from the sensors' noise; a few rounds settle it, because D decides how far the others are trusted.
    """
    d = np.where(np.isfinite(noise), noise, 0.1 * residuals.std(0) + 1e-9)
    least = FLOOR * d
    for _ in range(rounds):
        rest = residuals - leave_one_out(residuals, d) @ residuals
        d = np.maximum(_smooth(np.sqrt(np.mean(rest**2, 0)), layout), least)
    return d


def leave_one_out(residuals: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Weights (n, n), zero on the diagonal: row i predicts residual i from the others.

    With A the others' residuals over sqrt(n - 1), the expected part of r is A (1 + A^T D^-1 A)^-1 A^T D^-1 r.
    """
    n = len(residuals)
    scaled = residuals / d
    gram = scaled @ scaled.T / (n - 1)
    weights = np.zeros((n, n))
    for i in range(n):
        others = np.arange(n) != i
        weights[i, others] = np.linalg.solve(np.eye(n - 1) + gram[np.ix_(others, others)], gram[others, i])
    return weights


def _smooth(values: np.ndarray, layout: Layout) -> np.ndarray:
    """Running root mean square over half a second in each block."""
    out = values.copy()
    for b in layout.blocks:
        part = values[b.where] ** 2
        width = max(1, int(round(0.5 / max(np.median(np.diff(b.t)), 1e-3)))) if len(part) > 2 else 1
        kernel = np.ones(2 * width + 1)
        out[b.where] = np.sqrt(np.convolve(part, kernel, "same") / np.convolve(np.ones(len(part)), kernel, "same"))
    return out
