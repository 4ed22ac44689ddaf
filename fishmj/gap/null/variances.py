"""Maximum-likelihood variances of the parts of a covariance, from several robots.

    S_i = F_i^T F_i + sum_g u_g sum_(k in g) a_ik a_ik^T + diag(d_i + sum_c p_c R_ic)       robot i, residual r_i
        = F_i^T F_i + sum_j u_j f_ij f_ij^T + C_i,    C_i: parts within one record each, block by block
    -2 log L = sum_i r_i^T S_i^-1 r_i + log det S_i

`score_variances` computes the sums for a step of the MM algorithm of Zhou, Hu, Zhou & Lange (2019), which multiplies each
variance by the square root of observed over expected sums of its part:

    u_g <- u_g (sum_ik (a_ik^T S_i^-1 r_i)^2 / sum_ik a_ik^T S_i^-1 a_ik)^1/2

It never lowers the likelihood and keeps every variance positive.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

TINY = 1e-300


class Sample(NamedTuple):
    """One robot.

    null (n, m): F. shared (J, m): f; group (J,): index of each one's variance. parts (K_l, m_l): a of each record; groups (K_l,):
    their indices. record (m,): of each sample, -1 without parts. variance (m,): d. spread (m,): R^2. channel (m,): index of each
    sample's p. residual (m,).
    """

    null: np.ndarray
    shared: np.ndarray
    group: np.ndarray
    parts: list[np.ndarray]
    groups: list[np.ndarray]
    record: np.ndarray
    variance: np.ndarray
    spread: np.ndarray
    channel: np.ndarray
    residual: np.ndarray


class VarianceScore(NamedTuple):
    """Sums of one robot: -2 log L, |z|^2 / m, and the observed and expected sums of each variance, (G + C,) each."""

    loss: float
    adequacy: float
    seen: np.ndarray
    expected: np.ndarray


def score_variances(sample: Sample, u: np.ndarray, p: np.ndarray) -> VarianceScore:
    """The sums of the formula above at variances u (G,) of the parts and p (C,) of the channels."""
    d = sample.variance + p[sample.channel] * sample.spread
    factors = np.concatenate([sample.null, sample.shared * np.sqrt(u[sample.group])[:, None]])
    solved, residual, white, logdet = factors / d, sample.residual / d, 1.0 / d, float(np.sum(np.log(d)))
    kept = []  # for each record: its samples, and 1 - diag M^-1 = u diag(a^T C^-1 a)
    for i, (part, group) in enumerate(zip(sample.parts, sample.groups, strict=True)):
        # C^-1 = 1/d - own^T own, own = M^-1/2 u^1/2 a / d, M = 1 + u^1/2 a d^-1 a^T u^1/2
        mine, wide = sample.record == i, part * np.sqrt(u[group])[:, None]
        root = np.linalg.cholesky(np.eye(len(wide)) + (wide / d[mine]) @ wide.T)
        own = solve_triangular(root, wide / d[mine], lower=True)
        logdet += 2.0 * float(np.sum(np.log(np.diag(root))))
        less = 1.0 - np.sum(solve_triangular(root, np.eye(len(root)), lower=True) ** 2, 0)
        kept.append((mine, less))
        solved[:, mine] = factors[:, mine] / d[mine] - (factors[:, mine] @ own.T) @ own
        residual[mine] = sample.residual[mine] / d[mine] - (own @ sample.residual[mine]) @ own
        white[mine] = 1.0 / d[mine] - np.sum(own**2, 0)
    # S^-1 = C^-1 - half^T half: the factors that all records share, by Woodbury
    root = np.linalg.cholesky(np.eye(len(factors)) + solved @ factors.T)
    half = solve_triangular(root, solved, lower=True)
    logdet += 2.0 * float(np.sum(np.log(np.diag(root))))
    residual = residual - half.T @ (half @ sample.residual)
    seen, expected = np.zeros(len(u)), np.zeros(len(u))
    for (mine, less), part, group in zip(kept, sample.parts, sample.groups, strict=True):
        trace = less / np.maximum(u[group], TINY) - np.sum((part @ half[:, mine].T) ** 2, 1)
        seen += np.bincount(group, (part @ residual[mine]) ** 2, len(u))
        expected += np.bincount(group, trace, len(u))
        white[mine] -= np.sum(half[:, mine] ** 2, 0)
    own = solved[len(sample.null) :] / np.sqrt(np.maximum(u[sample.group], TINY))[:, None]  # f C^-1
    trace = np.sum(own * sample.shared, 1) - np.sum((sample.shared @ half.T) ** 2, 1)
    seen += np.bincount(sample.group, (sample.shared @ residual) ** 2, len(u))
    expected += np.bincount(sample.group, trace, len(u))
    of_channel = lambda values: np.bincount(sample.channel, sample.spread * values, len(p))
    squared = float(sample.residual @ residual)
    both = np.append(seen, of_channel(residual**2)), np.append(expected, of_channel(white))
    return VarianceScore(squared + logdet, squared / len(d), *both)
