"""Online correction of a water: factors and a stream offset, fitted to motion in a reference water over short segments.

    min |r(x)|^2 + |x - x'|^2_P                                 Gauss-Newton; x', P: prior mean, and covariance after forgetting
    P_k^-1 = prior + lambda (P_k-1^-1 - prior) + J^T J          lambda = exp(-t / MEMORY), t since the segment before

x holds the logarithms of ten factors on the coefficients, and the offset of the mean stream from the simulation's, m/s. r (K, C)
are the differences of motion in K windows and C channels, divided by the surrogate's irreducible error. Four hypotheses explain a
segment. `right`: x is unchanged. In the other three, the factors, the stream, or both are wrong and distributed as in P. x is
updated by the hypothesis with the greatest evidence, if

    max_c mean_k r(x')^2 > 1    and    2 ln(p_wrong / p_right) = |r(x')|^2 - |r(x)|^2 - |x - x'|^2_P - ln det(1 + J P J^T) > 0

The first condition is needed because the errors of a correct surrogate are correlated between windows: any pattern within the
irreducible error may be its own. It is tested by channel, because an error of the stream, for example, shows in one channel only.
The second condition is Laplace's approximation of the evidence ratio: free unknowns must gain more than by chance. Seven factors
then do not explain a wrong stream, nor a stream a wrong hull. A segment within the irreducible error leaves x bit-identical.
`WRONG` is the prior range of wrong factors: half and more for friction, which separates a no-slip hull from a frictionless one,
and for cross-flow drag. The other factors have a smaller range, because two seconds hardly separate them from these two. Wrenches
are not fitted: speed and turning are small differences of large forces, each wrong by a few per cent, and ten factors could
correct their sum in many ways.

Recursive least squares with a forgetting factor: Ljung 1999, System Identification, section 11.2. Evidence of a hypothesis with
free parameters: MacKay 1992, Bayesian interpolation, Neural Computation 4.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.base.least_squares import Problem, damped_steps
from fishmj.water.dynamics import strip_forces
from fishmj.water.prior import unflat

KINDS = ("added_mass", "cross_flow", "friction", "form", "edge")
FACTORS = 2 * len(KINDS)  # unknowns 0 to 9 are factors, 10 and 11 the stream
BOUNDS = (0.3, 3.0)
WIDER = (0.001, 30.0)  # bounds for friction, which is large on a no-slip hull and nearly zero on one with free slip
PLATE = 0.005  # friction of a smooth plate at Re 1e5 (Blasius 0.0042; turbulent 0.007)
FASTEST = 0.3  # m/s, bound on the stream's offset
WRONG = np.array([0.02, 0.5, 1.5, 0.2, 0.1])  # prior standard deviation of ln factor by kind, of a wrong surrogate
STREAM = 0.05  # m/s, prior standard deviation of each component of the stream's offset
MEMORY = 30.0  # s, time constant of forgetting
FREE = [0, 1, 2, 3, 5, 6, 9]  # those of the ten factors that act on a coefficient
BELIEFS = (FREE, [10, 11], [*FREE, 10, 11])  # free unknowns of each hypothesis
ROUNDS, DAMPING, LEAST = 6, (0.0, 0.1, 1.0, 10.0), 0.01  # Gauss-Newton: iterations, dampings, relative gain to go on
NUDGE = np.array([0.05] * FACTORS + [0.005] * 2)  # step of the finite differences
_LOW, _HIGH = ([*np.log(2 * [w if kind == "friction" else b for kind in KINDS]), f, f]
               for b, w, f in zip(BOUNDS, WIDER, (-FASTEST, FASTEST), strict=True))  # fmt: skip
LIMITS = np.array([_LOW, _HIGH])[..., None]

Misses = Callable[[np.ndarray, np.ndarray], np.ndarray]  # factors (10, B), stream (2, B) m/s -> (K, C, B)


class Correction(NamedTuple):
    """Corrections and their uncertainty. Order of the factors: `KINDS` for the body's links, then for the last link."""

    factors: np.ndarray  # (10,)
    stream: np.ndarray  # (2,) m/s, world frame: offset of the mean stream from the simulation's
    information: np.ndarray  # (12, 12) inverse covariance of the factors' logarithms and the stream

    @property
    def unknowns(self) -> np.ndarray:
        """Logarithms of the factors, and the stream, (12,)."""
        return np.concatenate([np.log(self.factors), self.stream])

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the unknowns, (12,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.information)))


def fresh() -> Correction:
    """Initial correction, which changes nothing."""
    return Correction(np.ones(FACTORS), np.zeros(2), _prior())


def _prior() -> np.ndarray:
    return np.diag(1 / np.array([*WRONG, *WRONG, STREAM, STREAM]) ** 2)


def applied(c: strip_forces.Coefficients, factors) -> strip_forces.Coefficients:
    """Coefficients times their factors (10,) or (10, B); friction and head form drag use the body's factors.

    The friction factor multiplies friction plus `PLATE`, so that it can also add friction to a water without any.
    """
    (mass, cross, skin, form, _), (tail_mass, tail_cross, _, _, edge) = factors[:5], factors[5:]
    body = len(c.k) - 1
    return c._replace(
        k=[v * mass for v in c.k[:body]] + [c.k[body] * tail_mass],
        cn=[v * cross for v in c.cn[:body]] + [c.cn[body] * tail_cross],
        cf=np.maximum(c.cf + (c.cf + PLATE) * (skin - 1.0), 0.0),
        ca_forward=c.ca_forward * form,
        ca_backward=c.ca_backward * form,
        ke=c.ke * edge,
    )


def applied_to_rows(water: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Flat coefficients (B, P) of B fish times their factors (10, B)."""
    c = applied(unflat(list(np.asarray(water, float).T)), factors)
    return np.stack(np.broadcast_arrays(*c.k, *c.cn, *c[2:]), 1)


def matched(state: Correction, misses: Misses, *, idle: float = 0.0) -> Correction:
    """Updates the correction by a segment, so that the surrogate moves as the fish in the reference water did.

    Args:
        misses: function of factors (10, B) and streams (2, B) of B surrogates that returns the residuals (K, C, B): differences
            of motion in K windows and C channels, divided by the irreducible error.
        idle: s since the previous segment.
    Returns:
        The new correction. If the segment does not refute the present one, only its uncertainty grows, by forgetting.
    """
    belief = _prior() + np.exp(-idle / MEMORY) * (state.information - _prior())
    start = state.unknowns
    seen = misses(state.factors[:, None], state.stream[:, None])[..., 0]
    if not refuted(seen):
        return state._replace(information=belief)
    of, first = (lambda x: misses(np.exp(x[:FACTORS]), x[FACTORS:]).reshape(seen.size, -1)), seen.ravel()
    found = max((_fitted(start, free, belief, first, of) for free in BELIEFS), key=lambda fit: fit.gain)
    if not found.gain > 0:
        return state._replace(information=belief)
    belief[np.ix_(found.free, found.free)] += found.normal
    return Correction(np.exp(found.x[:FACTORS]), found.x[FACTORS:], belief)


def refuted(misses: np.ndarray) -> bool:
    """Returns True if the residuals (K, C) exceed the irreducible error of a correct surrogate in any channel."""
    return bool((misses**2).mean(0).max() > 1.0)


class _Fit(NamedTuple):
    """Fit of one hypothesis: its free unknowns, their fitted values, J^T J there, and 2 ln(p / p_right)."""

    free: list
    x: np.ndarray
    normal: np.ndarray
    gain: float


def _fitted(start: np.ndarray, free: list, belief: np.ndarray, first: np.ndarray, of: Callable) -> _Fit:
    """Gauss-Newton fit of the free unknowns from `start`; first: the residuals there."""
    held = belief[np.ix_(free, free)]

    def residual(rows: np.ndarray) -> np.ndarray:
        unknowns = np.repeat(start[:, None], len(rows), 1)
        unknowns[free] = rows.T
        return of(unknowns).T

    problem = Problem(residual, NUDGE[free], start[free], held, *LIMITS[:, free, 0])
    x, last, now = start[free], first, float(first @ first)
    jacobian = np.zeros((len(free), len(first)))
    for _ in range(ROUNDS):
        _, jacobian = problem.linear(x, last)
        if not np.isfinite(jacobian).all():  # a replay diverged
            jacobian = 0.0 * np.nan_to_num(jacobian)
            break
        best = problem.best(x, damped_steps(*problem.quadratic(x, last, jacobian), DAMPING))
        if not best.cost < now:
            break
        enough = best.cost > (1 - LEAST) * now
        x, last, now, _ = best
        if enough:
            break
    slopes = jacobian / NUDGE[free][:, None]
    off, normal, found = x - start[free], slopes @ slopes.T, start.copy()
    found[free] = x
    chance = np.linalg.slogdet(held + normal)[1] - np.linalg.slogdet(held)[1]  # ln det(1 + J P J^T)
    return _Fit(free, found, normal, float(first @ first - last @ last - off @ held @ off - chance))
