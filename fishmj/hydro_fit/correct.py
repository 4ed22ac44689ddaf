"""A water corrected while it runs: a few factors, followed recursively from short stretches of a better one.

    dF = sum_g (s_g - 1) F_g + noise             F_g: force of one kind on each link, dF: what the oracle's wrench has beyond
    P_k = (lambda^n P^-1 + A^T W A)^-1,   s += P A^T W (dF - A (s - 1))              n ticks since the last row, A = [F_g]
Recursive least squares with a forgetting factor (Ljung 1999, section 11.2): without rows nothing moves but the certainty, which
fades at most to the prior's, so a factor that is no longer seen stays where it is and none runs away. Factors are held within
`BOUNDS`; the residual stays as it is.

A right surrogate has an error, too, that no factor mends. Its mean square, over that of all drags, is `own`; rows count only as
far as the uncorrected error exceeds it, from `CALM` times (not at all) to `ALARM` times (fully). So forces never talk a surrogate
out of coefficients that were fitted to whole swims.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fishmj.hydro_fit import chain, terms

DRAGS = [1, 2, 3, 6, 9]  # of the ten factors: all but added mass, whose force may be any
KINDS = ("added_mass", "cross_flow", "friction", "form", "edge")
BOUNDS = (0.3, 3.0)
WIDER = (0.001, 30.0)  # of friction, which is all of a hull that holds the water and next to none of one that lets it slide
LIMITS = np.array([[b if kind != "friction" else w for kind in 2 * KINDS] for b, w in zip(BOUNDS, WIDER, strict=True)])[..., None]
SPREAD = np.array([0.15, 0.5, 1.0, 0.7, 0.5])  # standard deviation of each factor before any row
MEMORY = 30.0  # s of rows, after which they count for 1/e
HANG = 15.0  # rows that one error lasts, as in the fit
CALM, ALARM = 0.7, 1.1  # uncorrected mean square error over the surrogate's own
FREE = [0, 1, 2, 3, 5, 6, 9]  # factors of the ten that touch a coefficient
ROUNDS, NUDGE, DAMPING, LEAST = 4, 0.05, (0.0, 0.1, 1.0, 10.0), 0.01  # Gauss-Newton: of ln factor, of the objective
FAINT = np.array([2e-3, 2e-3, 2e-4])  # N, N, N m: a tenth of the drags of a gentle swim; nobody needs such errors corrected


class Correction(NamedTuple):
    """Factors and what is known of them. Order: `KINDS` for the body's links, then for the last link."""

    factors: np.ndarray  # (10,)
    information: np.ndarray  # (10, 10) inverse covariance
    noise: np.ndarray  # (3,) running mean square of the remaining error by component
    left: np.ndarray  # (3,) running mean square of the uncorrected error
    size: np.ndarray  # (3,) and of the uncorrected drags
    rows: float  # ticks seen

    def excess(self, own) -> float:
        """Uncorrected mean square error over what a right surrogate has."""
        return float(np.mean(self.left / (self.size * np.asarray(own) + FAINT**2)))


class Row(NamedTuple):
    """One tick: what the links did (N,), and the oracle's wrench on each, (3, N) F_t, F_n, moment about its origin."""

    u: np.ndarray
    w: np.ndarray
    omega: np.ndarray
    normal: np.ndarray  # n.a of the origin, m/s2
    alpha: np.ndarray
    attached: float
    extra: np.ndarray  # (3, N) forces that no factor touches: the residual's
    force: np.ndarray


def fresh() -> Correction:
    """Nothing corrected yet."""
    none = np.zeros(3)
    return Correction(np.ones(10), np.diag(1 / np.tile(SPREAD, 2) ** 2), none, none, none, 0.0)


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


def parts(s: terms.Strips, c: terms.Coefficients, row: Row) -> np.ndarray:
    """Force of every kind, (10, 3, N), for the uncorrected coefficients."""
    n = len(s.mu)
    out = np.zeros((10, 3, n))
    none = [0.0] * n
    for i in range(n):
        first = 5 if i == n - 1 else 0
        u, w, omega, a, alpha = row.u[i], row.w[i], row.omega[i], row.normal[i], row.alpha[i]
        m0, m1, m2 = (c.k[i] * m for m in s.mu[i])
        inertia = np.array([0.0, -(m0 * a + m1 * alpha), -(m1 * a + m2 * alpha)])
        out[first, :, i] = inertia + np.array(terms.reactive(s, c, i, u, w, omega))
        out[first + 1, :, i] = terms.resistive(np, s, c._replace(cf=0.0), i, u, w, omega)
        out[2, :, i] = terms.resistive(np, s, c._replace(cn=none), i, u, w, omega)
    out[3, 0, 0] = terms.head_form(np, s, c, row.u[0])
    out[9, :, -1] = terms.trailing_edge(np, s, c, row.u[-1], row.w[-1], row.omega[-1], row.attached)
    return out


def update(
    state: Correction, s: terms.Strips, c: terms.Coefficients, row: Row, *, own, tick: float, idle: float = 0.0
) -> Correction:
    """Take one row in.

    Args:
        c: the uncorrected coefficients. own: (3,) mean square error over mean square drag that a right surrogate has, by
            component; 0 takes every row at its word. tick: s that the row stands for. idle: s since the row before without any.
    """
    a = parts(s, c, row)
    left = row.force - row.extra - a.sum(0)  # beyond the uncorrected water
    error = left - np.tensordot(state.factors - 1.0, a, axes=1)
    seen = state.rows + 1.0
    share = 1.0 / min(seen, MEMORY / tick)
    follow = lambda old, values: old + ((values**2).mean(1) - old) * share  # noqa: E731
    new = state._replace(
        left=follow(state.left, left), size=follow(state.size, a[DRAGS].sum(0)), noise=follow(state.noise, error)
    )
    weight = np.clip((new.excess(own) - CALM) / (ALARM - CALM), 0.0, 1.0) / (HANG * (new.noise + FAINT**2))
    prior = np.diag(1 / np.tile(SPREAD, 2) ** 2)
    keep = np.exp(-(tick + idle) / MEMORY)
    information = prior + keep * (state.information - prior)
    rows = a.reshape(10, -1)
    w = np.repeat(weight, a.shape[2])
    information = information + (rows * w) @ rows.T
    step = np.linalg.solve(information, (rows * w) @ error.ravel())
    factors = np.clip(state.factors + step, *BOUNDS)
    return new._replace(factors=factors, information=information, rows=seen)


def matched(state: Correction, misses: Callable[[np.ndarray], np.ndarray], *, idle: float = 0.0) -> Correction:
    """Follow a stretch that was swum by both: factors with which the surrogate moves as the better water's fish did.

        min |r(s)|^2 + (ln s - ln s')^T P^-1 (ln s - ln s')             Gauss-Newton; s', P: before, P grown by forgetting
    Speed is what large forces leave over, each wrong by a few per cent in a right model, too: so movement is compared.

    Args:
        misses: (10, B) factors of B surrogates -> (R, B) differences of movement over what a right one differs by. idle: s since
            the stretch before.
    """
    prior = np.diag(1 / np.tile(SPREAD, 2) ** 2)
    belief = prior + np.exp(-idle / MEMORY) * (state.information - prior)
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
    return state._replace(factors=np.exp(x), information=belief)


def rows_between(ch: chain.Chain, q, v, q_new, v_new, flow, wrench, attached: float, extra: np.ndarray, tick: float) -> Row:
    """A row from the state before and after a tick.

    Args:
        q, v, q_new, v_new: (3 + J,). flow: (N, 2) m/s. wrench: (N, 3) F_x, F_y, M in the tank frame, mean over the tick.
        extra: (3, N) the residual's force on each link in its own axes.
    """
    mid, rate, accel = (q + q_new) / 2, (v + v_new) / 2, (v_new - v) / tick
    k = chain.kinematics(np, ch, list(mid), list(rate), [tuple(f) for f in flow])
    cp, sp = np.cos(mid[2]), np.sin(mid[2])
    ax, ay = cp * accel[0] + sp * accel[1], cp * accel[1] - sp * accel[0]
    alpha, normal, force = np.cumsum(accel[2:]), [], []
    for i in range(ch.n):
        (tx, ty), (nx, ny) = k.t[i], k.n[i]
        if i:
            lever = ch.d[i - 1] * alpha[i - 1]
            ax, ay = ax + lever * k.n[i - 1][0], ay + lever * k.n[i - 1][1]
        normal.append((ax + k.bias[i][0]) * nx + (ay + k.bias[i][1]) * ny)
        fx, fy = cp * wrench[i][0] + sp * wrench[i][1], cp * wrench[i][1] - sp * wrench[i][0]
        force.append((fx * tx + fy * ty, fx * nx + fy * ny, wrench[i][2]))
    u, w, omega = (np.array(part, float) for part in (k.u, k.w, k.omega))
    return Row(u, w, omega, np.array(normal), alpha, attached, extra, np.array(force).T)
