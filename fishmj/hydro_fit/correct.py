"""A water corrected while it runs: a few factors that follow how a better water's fish moves over short stretches.

    min |r(s)|^2 + (ln s - ln s')^T P^-1 (ln s - ln s')        Gauss-Newton; s', P: before, P grown by forgetting
    P_k^-1 = prior + lambda (P_k-1^-1 - prior) + J^T J          lambda = exp(-t / MEMORY), t since the stretch before

r are differences of movement over what a right surrogate misses by, too: its error has no factor that mends it. Before any
stretch a fitted water is taken to be right to a few per cent (`TRUST`) but for friction, which tells a hull that holds the
water from one along which it slides: so a right surrogate is hardly moved, and a wrong hull found at once. Wrenches are no
guide: large forces, each wrong by a few per cent, leave speed and turning over, and ten factors find many ways to mend the sum.

Recursive least squares with a forgetting factor: Ljung 1999, System Identification, section 11.2.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.hydro_fit import terms

KINDS = ("added_mass", "cross_flow", "friction", "form", "edge")
BOUNDS = (0.3, 3.0)
WIDER = (0.001, 30.0)  # of friction, which is all of a hull that holds the water and next to none of one that lets it slide
LIMITS = np.array([[b if kind != "friction" else w for kind in 2 * KINDS] for b, w in zip(BOUNDS, WIDER, strict=True)])[..., None]
TRUST = np.array([0.05, 0.1, 2.0, 0.2, 0.1])  # standard deviation of ln factor by kind, before any stretch
MEMORY = 30.0  # s, after which what was seen counts for 1/e
FREE = [0, 1, 2, 3, 5, 6, 9]  # factors of the ten that touch a coefficient
ROUNDS, NUDGE, DAMPING, LEAST = 6, 0.05, (0.0, 0.1, 1.0, 10.0), 0.01  # Gauss-Newton: of ln factor, of the objective


class Correction(NamedTuple):
    """Factors and what is known of them. Order: `KINDS` for the body's links, then for the last link."""

    factors: np.ndarray  # (10,)
    information: np.ndarray  # (10, 10) inverse covariance of their logarithms


def fresh() -> Correction:
    """Nothing corrected yet."""
    return Correction(np.ones(10), _prior())


def _prior() -> np.ndarray:
    return np.diag(1 / np.tile(TRUST, 2) ** 2)


def applied(c: terms.Coefficients, state: Correction) -> terms.Coefficients:
    """Coefficients times their factors; friction and head form have the body's."""
    (mass, cross, skin, form, _), (tail_mass, tail_cross, _, _, edge) = state.factors[:5], state.factors[5:]
    body = len(c.k) - 1
    return c._replace(
        k=[v * mass for v in c.k[:body]] + [c.k[body] * tail_mass],
        cn=[v * cross for v in c.cn[:body]] + [c.cn[body] * tail_cross],
        cf=c.cf * skin,
        ca_forward=c.ca_forward * form,
        ca_backward=c.ca_backward * form,
        ke=c.ke * edge,
    )


def matched(state: Correction, misses: Callable[[np.ndarray], np.ndarray], *, idle: float = 0.0) -> Correction:
    """Follow a stretch that was swum by both: factors with which the surrogate moves as the better water's fish did.

    Args:
        misses: (10, B) factors of B surrogates -> (R, B) differences of movement over what a right one differs by. idle: s since
            the stretch before.
    """
    belief = _prior() + np.exp(-idle / MEMORY) * (state.information - _prior())
    start = x = np.log(state.factors)
    free = FREE
    held, jacobian = belief[np.ix_(free, free)], np.zeros((0, len(free)))
    for _ in range(ROUNDS):
        tries = np.repeat(x[:, None], len(free) + 1, 1)
        tries[free, np.arange(1, len(free) + 1)] += NUDGE
        r = misses(np.exp(tries))
        jacobian, off = (r[:, 1:] - r[:, :1]) / NUDGE, (x - start)[free]
        normal, slope = jacobian.T @ jacobian + held, jacobian.T @ r[:, 0] + held @ off
        tries = np.repeat(x[:, None], len(DAMPING), 1)
        tries[free] -= np.stack([np.linalg.solve(normal + d * np.diag(np.diag(normal)), slope) for d in DAMPING], 1)
        tries = np.clip(tries, *np.log(LIMITS))
        off = (tries - start[:, None])[free]
        costs = (misses(np.exp(tries)) ** 2).sum(0) + np.einsum("ib,ij,jb->b", off, held, off)
        best, now = int(np.argmin(costs)), float(r[:, 0] @ r[:, 0] + (x - start)[free] @ held @ (x - start)[free])
        if not costs[best] < now:  # nan, too
            break
        x = tries[:, best]
        if costs[best] > (1 - LEAST) * now:
            break
    belief[np.ix_(free, free)] += jacobian.T @ jacobian
    return Correction(np.exp(x), belief)
