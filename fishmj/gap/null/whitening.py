"""The empirical null: residuals of this model on fish without any missing effect.

    r_i = measured_i - predicted, i = 1..n     from an independent simulator: same commands, random constants within their
                                               tolerance, its own water, servos, network and noise
    S = (1/n) sum r_i r_i^T + D                their covariance, plus the part outside their span, per channel and time
    z = S^-1/2 (measured - predicted)          mean square 1 if nothing is missing

S includes the model-form error and every constant that a fit could change. So the gap needs no fit, and an effect
counts only beyond every combination of those (generalised least squares with the
nuisance integrated out; Kennedy & O'Hagan 2001 with an empirical prior, Efron 2004). S is applied through its factors F:
S = F^T F + D.

D is the leave-one-out rest: each r_i is predicted from the other n - 1, and the squared remainders are averaged.

A rotated camera turns an error ahead into an error sideways. So null runs pass through a candidate's sensors,

    r_i' = g(p + r_i) - g(p)      g: measurement effects of a parameter row applied to a pose, p: the predicted pose

Other effects do not change the null runs directly; they change the response to the constants (likelihood.py).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import bmat, csr_array
from scipy.sparse.csgraph import connected_components

from fishmj.effects.sites import SensorReadings
from fishmj.gap.records.records import ResidualLayout

RIDGE = 1e-9  # of the largest eigenvalue
FLOOR = 0.5  # least D, as a share of the sensors' noise
SMOOTH = 0.5  # s
WIDE = 0.5  # share of a record's samples from which a factor counts as one across all samples


class RecordWhitening(NamedTuple):
    """C^-1/2 of C = D + A^T A, each row of A within one record: y = x / d, then in each part of a record z = y - U (1 - g) U^T y.

    parts: (samples (m_l,), U (m_l, k), g (k,)), applied in order: first blocks that share no sample, then rows across them.
    """

    d: np.ndarray  # (m,)
    parts: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Whitens (..., m)."""
        z = x / self.d
        for where, u, g in self.parts:
            z[..., where] -= ((z[..., where] @ u) * (1.0 - g)) @ u.T
        return z

    @property
    def logdet(self) -> float:
        """log det C."""
        return float(2.0 * np.sum(np.log(self.d)) - 2.0 * sum(np.sum(np.log(g)) for _, _, g in self.parts))


def record_whitening(d: np.ndarray, by_record: Sequence[np.ndarray] = (), record: np.ndarray | None = None) -> RecordWhitening:
    """Whitening from D's square root (m,) and factors (k, m_l) of each record. record: (m,) ascending number of each sample's."""
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for i, factors in enumerate(by_record):
        begin, end = np.searchsorted(np.asarray(record), [i, i + 1]).tolist()
        if not len(factors) or end <= begin:
            continue
        scaled, known, own = factors / d[begin:end], len(parts), separate_blocks(factors)
        for rows, samples in own:
            inner = scaled[np.ix_(rows, samples)]
            for where, u, g in parts[known:] if len(samples) == end - begin else ():
                inner[:, where - begin] -= ((inner[:, where - begin] @ u) * (1.0 - g)) @ u.T
            parts.append((begin + samples, *directions(inner)))
    return RecordWhitening(d, tuple(parts))


def separate_blocks(factors: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """(rows, samples) of each block of factors (k, m) that shares no sample with another, then of the rows across all samples.

    Errors of one segment change no other, and blocks save time: the cost grows with the cube of the size.
    """
    there = factors != 0.0
    wide = there.mean(1) > WIDE
    narrow = np.flatnonzero(~wide)
    blocks = []
    if len(narrow):
        graph = csr_array(there[narrow])
        count, label = connected_components(bmat([[None, graph], [graph.T, None]], format="csr"), directed=False)
        rows, samples = label[: len(narrow)], label[len(narrow) :]
        blocks = [(narrow[rows == b], np.flatnonzero(samples == b)) for b in range(count) if np.any(rows == b)]
    across = [(np.flatnonzero(wide), np.arange(factors.shape[1]))] if wide.any() else []
    return [(rows, samples) for rows, samples in blocks if len(samples)] + across


def directions(scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(U, g) of 1 + F^T F, F (k, m): eigenvectors whose eigenvalues differ from 1, and 1 over their square roots."""
    square, v = np.linalg.eigh(scaled @ scaled.T)
    keep = square > RIDGE * max(float(square.max(initial=0.0)), 1e-300)
    return scaled.T @ (v[:, keep] / np.sqrt(square[keep])), 1.0 / np.sqrt(1.0 + square[keep])


class Whitening(NamedTuple):
    """S^-1/2 in parts, S = F^T F + C: y = C^-1/2 x, z = y - U (1 - g) U^T y."""

    alone: RecordWhitening  # of C
    u: np.ndarray  # (m, k)
    g: np.ndarray  # (k,)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Whitens (..., m)."""
        y = self.alone(x)
        return y - ((y @ self.u) * (1.0 - self.g)) @ self.u.T

    @property
    def logdet(self) -> float:
        """log det S."""
        return self.alone.logdet - float(2.0 * np.sum(np.log(self.g)))


def whitening(
    factors: np.ndarray, d: np.ndarray, by_record: Sequence[np.ndarray] = (), record: np.ndarray | None = None
) -> Whitening:
    """Whitening from shared factors (k, m), D's square root (m,), and factors of one record each (`record_whitening`).

    The factors of single records are hundreds in total but a few tens in each record, so record by record they cost little.
    """
    alone = record_whitening(d, by_record, record)
    return Whitening(alone, *directions(alone(factors)))


def residual_and_tangents(model, records, layout: ResidualLayout, row) -> tuple[np.ndarray, np.ndarray]:
    """((m,) residual of a parameter row, (C, m) its change by the tolerance of each constant of the model)."""
    sigma = np.array([constant.sigma for constant in model.constants])
    rows = np.tile(row, (1 + len(sigma), 1))
    rows[1:, : len(sigma)] += np.diag(sigma)
    residuals = layout.residuals(model.predict(records, rows))
    return residuals[0], residuals[1:] - residuals[0]


def leftover(residuals: np.ndarray, layout: ResidualLayout, rounds: int = 3) -> np.ndarray:
    """D^1/2 (m,): standard deviation of a null run unexplained by the others, smooth over time in each block.

    Iterates from the sensors' noise, because D sets the weights of the other runs; a few rounds suffice.
    """
    noise = layout.noise()
    d = np.where(np.isfinite(noise), noise, 0.1 * residuals.std(0) + 1e-9)
    least = FLOOR * d
    for _ in range(rounds):
        rest = unexplained(residuals, d)
        d = np.maximum(smooth(np.sqrt(np.mean(rest**2, 0)), layout), least)
    return d


def unexplained(residuals: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Residual of each null run (n, m) minus its expectation given the others: r - F^T (1 + F D^-1 F^T)^-1 F D^-1 r.

    F: the other runs over sqrt(n - 1); all products come from one Gram matrix.
    """
    n = len(residuals)
    factors = residuals / np.sqrt(n - 1) / d
    gram = factors @ factors.T
    weights = np.zeros((n, n))
    for i in range(n):
        others = np.arange(n) != i
        inner = np.eye(n - 1) + gram[np.ix_(others, others)]
        weights[i, others] = np.linalg.solve(inner, gram[others, i]) * np.sqrt(n - 1)
    return residuals - (weights @ factors) * d


def smooth(values: np.ndarray, layout: ResidualLayout) -> np.ndarray:
    """Running root mean square over a second in each block."""
    out = values.copy()
    for b in layout.blocks:
        part = values[b.where] ** 2
        width = max(1, int(round(SMOOTH / max(float(np.median(np.diff(b.t))), 1e-3)))) if len(part) > 2 else 1
        kernel = np.ones(2 * width + 1)
        total = np.convolve(part, kernel)[width : width + len(part)]
        out[b.where] = np.sqrt(total / np.convolve(np.ones(len(part)), kernel)[width : width + len(part)])
    return out


SENSORS = ("pose", "placed")


def as_sensed(model, layout, row: np.ndarray, shown: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """(n, m) residuals of null runs through the sensors of a parameter row. shown: (m,) prediction of the row."""
    values = row[len(model.constants) :]
    out = residuals.copy()
    for i in range(len(layout.records)):
        for sensor in SENSORS:
            where = [b.where for b in layout.blocks if b.record == i and b.sensor == sensor]
            if where:
                pose = np.stack([shown[w] for w in where])
                run = pose[:, None] + np.stack([residuals[:, w] for w in where])
                moved = camera_view(model.active, values, run) - camera_view(model.active, values, pose[:, None])
                for w, change in zip(where, moved, strict=True):
                    out[:, w] = change
    return out


def changes_sensing(model, row: np.ndarray) -> bool:
    """Returns True if a parameter row has a measurement effect."""
    measuring = [x for x in model.active.effects if x.measure]
    return any(row[model.index(x.name, p.name)] != p.null for x in measuring for p in x.parameters if not p.shape)


def camera_view(active, values, pose: np.ndarray) -> np.ndarray:
    """(3, n, k) poses as a camera measures them, from poses (3, n, k)."""
    none = np.zeros((1, 1))
    seen = SensorReadings(t=none, x=pose[0], y=pose[1], yaw=pose[2], joint=np.zeros((1, 1, active.joints)), power=none)
    seen = active.measure(np, [np.full((1, 1), v) for v in values], seen)
    return np.stack([np.broadcast_to(a, pose[0].shape) for a in (seen.x, seen.y, seen.yaw)])
