"""Most likely variances of all robots, by the MM algorithm of `fishmj.gap.null.variances`."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.gap.null.variances import TINY, VarianceScore


class VarianceFit(NamedTuple):
    """Variances u (G,), p (C,); loss: -2 log L over all robots; adequacy: |z|^2 / m of each."""

    u: np.ndarray
    p: np.ndarray
    loss: float
    adequacy: list[float]


def most_likely(
    ask: Callable[..., list[VarianceScore]], u: np.ndarray, p: np.ndarray, rounds: int, tick=lambda done: None
) -> VarianceFit:
    """Most likely variances, from a start point. ask(u, p) -> [Asked] of every robot; rounds: of the algorithm."""
    for done in range(rounds):
        told = ask(u, p)
        seen, expected = (np.sum([getattr(one, key) for one in told], 0) for key in ("seen", "expected"))
        factor = np.sqrt(seen / np.maximum(expected, TINY))
        u, p = u * factor[: len(u)], p * factor[len(u) :]
        tick(done + 1)
    told = ask(u, p)
    return VarianceFit(u, p, sum(one.loss for one in told), [one.adequacy for one in told])
