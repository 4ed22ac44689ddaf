"""A water corrected while it runs: a few factors that follow how a better water's fish moves over short stretches.

    min |r(s)|^2 + |ln s - ln s'|^2_P                           Gauss-Newton; s', P: before, P grown by forgetting
    P_k^-1 = prior + lambda (P_k-1^-1 - prior) + J^T J          lambda = exp(-t / MEMORY), t since the stretch before

r (R,) are differences of movement over what a right surrogate misses by, whose error has no factor that mends it. Two beliefs
explain a stretch. `right`: the factors stay where they are; `wrong`: they are somewhere in P. The factors move where

    |r(s')|^2 > R    and    2 ln(p_wrong / p_right) = |r(s')|^2 - |r(s)|^2 - |ln s - ln s'|^2_P - ln det(1 + J P J^T) > 0

The first, since a right surrogate is off the same way in window after window: within its own misses any pattern may be its own.
The second is Laplace's approximation of both likelihoods: free factors must gain more than they could by chance. So a stretch
that a right surrogate could have swum moves nothing, to the bit, and P need not protect it: `WRONG` is how far a wrong one may
have to move. Friction, which tells a hull that holds the water from one along which it slides, and cross-flow drag by half and
more; the others less, since two seconds from rest hardly tell them from these two. Wrenches are no guide: large forces, each
wrong by a few per cent, leave speed and turning over, and ten factors find many ways to mend the sum.

Recursive least squares with a forgetting factor: Ljung 1999, System Identification, section 11.2. The likelihood of a belief with
free factors: MacKay 1992, Bayesian interpolation, Neural Computation 4.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.dynamics import strip_forces

KINDS = ("added_mass", "cross_flow", "friction", "form", "edge")
BOUNDS = (0.3, 3.0)
WIDER = (0.001, 30.0)  # of friction, which is all of a hull that holds the water and next to none of one that lets it slide
LIMITS = np.array([[b if kind != "friction" else w for kind in 2 * KINDS] for b, w in zip(BOUNDS, WIDER, strict=True)])[..., None]
WRONG = np.array([0.02, 0.5, 1.5, 0.2, 0.1])  # standard deviation of ln factor by kind, of a surrogate that is wrong
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
    return np.diag(1 / np.tile(WRONG, 2) ** 2)


def applied(c: strip_forces.Coefficients, state: Correction) -> strip_forces.Coefficients:
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
    Returns:
        The state after it: where the stretch does not refute them, the same factors, known as they were but for forgetting.
    """
    belief = _prior() + np.exp(-idle / MEMORY) * (state.information - _prior())
    start = x = np.log(state.factors)
    free = FREE
    held, jacobian = belief[np.ix_(free, free)], np.zeros((0, len(free)))
    first = last = misses(state.factors[:, None])[:, 0]
    if first @ first <= len(first):
        return Correction(state.factors, belief)
    for _ in range(ROUNDS):
        tries = np.repeat(x[:, None], len(free), 1)
        tries[free, np.arange(len(free))] += NUDGE
        jacobian, off = (misses(np.exp(tries)) - last[:, None]) / NUDGE, (x - start)[free]
        normal, slope = jacobian.T @ jacobian + held, jacobian.T @ last + held @ off
        tries = np.repeat(x[:, None], len(DAMPING), 1)
        tries[free] -= np.stack([np.linalg.solve(normal + d * np.diag(np.diag(normal)), slope) for d in DAMPING], 1)
        tries = np.clip(tries, *np.log(LIMITS))
        r, far = misses(np.exp(tries)), (tries - start[:, None])[free]
        costs = (r**2).sum(0) + np.einsum("ib,ij,jb->b", far, held, far)
        costs = np.where(np.isfinite(costs), costs, np.inf)  # a fish that a step too far has lost
        best, now = int(np.argmin(costs)), float(last @ last + off @ held @ off)
        if not costs[best] < now:  # nan, too
            break
        x, last = tries[:, best], r[:, best]
        if costs[best] > (1 - LEAST) * now:
            break
    off = (x - start)[free]
    chance = np.linalg.slogdet(held + jacobian.T @ jacobian)[1] - np.linalg.slogdet(held)[1]  # ln det(1 + J P J^T)
    if not first @ first - last @ last - off @ held @ off > chance:
        return Correction(state.factors, belief)
    belief[np.ix_(free, free)] += jacobian.T @ jacobian
    return Correction(np.exp(x), belief)
