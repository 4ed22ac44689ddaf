"""Significance from a few groups: an exact test in addition to the bootstrap, and intervals that account for their number.

If four groups all improve, a Bayesian bootstrap gives P = 1.00, but an exact test p = 1/16. The answer follows the weaker of
both.
"""

import numpy as np
from scipy import stats

from fishmj.base.least_squares import jackknife_sd

LEAST_GROUPS = 5  # the smallest p of n groups is 1/2^n: with fewer, none below LEVEL
LEVEL = 0.05
DRAWS = 2**14  # all label swaps of up to 14 groups; of more, so many drawn ones
COVERS = 0.9  # of intervals


def exact_p(before: np.ndarray, after: np.ndarray) -> float:
    """One-sided p of the sum of `before - after` (G,), if the two labels of each group were exchangeable.

    All 2^G swaps of labels within groups, or DRAWS drawn ones beyond 14 groups (`scipy.stats.permutation_test`).
    """
    if len(before) < 2:
        return 1.0
    total = lambda a, b, axis: np.sum(a - b, axis=axis)
    given: dict = dict(permutation_type="samples", vectorized=True, n_resamples=DRAWS, alternative="greater")
    found = stats.permutation_test((np.asarray(before), np.asarray(after)), total, rng=np.random.default_rng(0), **given)
    return float(found.pvalue)


def smallest_p(groups: int) -> float:
    """Least possible value of `exact_p` for so many groups."""
    return max(0.5**groups, 1.0 / (DRAWS + 1))


def jackknife(values: np.ndarray, whole: float) -> tuple[float, float]:
    """90 % interval of a value about `whole`, from the K values (K,), each fitted without one part of the groups.

    The delete-a-group jackknife (Quenouille 1956): (K - 1) / K sum (v - mean)^2, Student's t of K - 1.
    """
    k = len(values)
    if k < 2:
        return -np.inf, np.inf
    wide = float(stats.t.ppf(0.5 + 0.5 * COVERS, k - 1)) * float(jackknife_sd(values))
    return whole - wide, whole + wide


def ratio(before: np.ndarray, after: np.ndarray, root: bool, seed: int = 0) -> tuple[float, float, float]:
    """Mean of `after` over that of `before` (G,), each group counting once, and its 90 % interval over groups (bootstrap).

    Args:
        root: use the roots of the mean squares.
    """
    power = 0.5 if root else 1.0
    drawn = np.random.default_rng(seed).integers(0, len(before), (4000, len(before)))
    each = (after[drawn].mean(1) / np.maximum(before[drawn].mean(1), 1e-300)) ** power
    low, high = np.quantile(each, [0.5 - 0.5 * COVERS, 0.5 + 0.5 * COVERS])
    return float((after.mean() / max(float(before.mean()), 1e-300)) ** power), float(low), float(high)
