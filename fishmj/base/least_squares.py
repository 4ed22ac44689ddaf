"""Damped least squares on residuals that are cheap in batches, and the jackknife.

    min |r(x)|^2 + (x - mean)^T P (x - mean),   low <= x <= high
    x' = x - (A + d diag A)^-1 g,               A = J^T J + P,   g = J^T r + P (x - mean)       Levenberg 1944, Marquardt 1963

A round is two batches: all differences for J, then the steps of all dampings d, of which the best is taken. A rollout of sixteen
rows costs a compiled model as much as one of a single row, so a failing step costs nothing.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


class DampedStep(NamedTuple):
    """The best step of a round. x (K,), its residual (m,) and cost, and the damping's place in the list."""

    x: np.ndarray
    residual: np.ndarray
    cost: float
    place: int


class Problem(NamedTuple):
    """One fit. residual: (B, K) -> (B, m). step: (K,) of the differences. mean, precision: (K,), (K, K) of the prior."""

    residual: Callable[[np.ndarray], np.ndarray]
    step: np.ndarray
    mean: np.ndarray
    precision: np.ndarray
    low: "np.ndarray | float" = -np.inf
    high: "np.ndarray | float" = np.inf

    def cost(self, residual: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(B,) objective of rows x (B, K) with residuals (B, m); infinite where it is no number."""
        off = x - self.mean
        cost = np.einsum("bm,bm->b", residual, residual) + np.einsum("bi,ij,bj->b", off, self.precision, off)
        return np.where(np.isfinite(cost), cost, np.inf)

    def linear(self, x: np.ndarray, residual: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Residual (m,) at x and its slopes (K, m) per difference step, in one batch; a known residual is not evaluated again."""
        rows, moved = differences(x, self.step, self.high)
        values = self.residual(rows if residual is not None else np.concatenate([x[None], rows]))
        residual, values = (values[0], values[1:]) if residual is None else (residual, values)
        return residual, slopes(values, residual, moved, self.step)

    def quadratic(self, x: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix A (K, K) and half the slope g (K,) of the objective per difference step."""
        prior = self.precision * np.outer(self.step, self.step)
        return jacobian @ jacobian.T + prior, jacobian @ residual + prior @ ((x - self.mean) / self.step)

    def best(self, x: np.ndarray, changes: np.ndarray) -> DampedStep:
        """The best of the steps (D, K), in difference steps from x."""
        tried = np.clip(x + changes * self.step, self.low, self.high)
        residual = self.residual(tried)
        costs = self.cost(residual, tried)
        place = int(np.argmin(costs))
        return DampedStep(tried[place], residual[place], float(costs[place]), place)


def differences(x: np.ndarray, step: np.ndarray, high) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) x with one entry changed in each row, up, or down at the upper bound; and the K changes as made."""
    rows = np.tile(x, (len(x), 1))
    place = np.arange(len(x))
    rows[place, place] += np.where(x + step <= high, step, -step)
    return rows, rows[place, place] - x


def slopes(values: np.ndarray, residual: np.ndarray, moved: np.ndarray, step: np.ndarray) -> np.ndarray:
    """(K, m) slopes per step from the residuals (K, m) of `differences`."""
    return (values - residual) / moved[:, None] * step[:, None]


def damped_steps(normal: np.ndarray, slope: np.ndarray, dampings: Sequence[float], ridge: float = 0.0) -> np.ndarray:
    """(D, K) steps to the minimum of the quadratic with each damping; with a ridge, parameters without effect do not move."""
    scale, small = np.diag(np.diag(normal)), ridge * np.eye(len(slope))
    return np.array([-np.linalg.solve(normal + d * scale + small, slope) for d in dampings])


def jackknife(values: np.ndarray) -> np.ndarray:
    """(K, K) covariance of an estimate from its values (G, K), each without one of G groups (Quenouille 1956)."""
    off = values - values.mean(0)
    return (len(values) - 1) / len(values) * off.T @ off


def jackknife_sd(values: np.ndarray) -> np.ndarray:
    """Standard deviations of the same values, (G,) or (G, K)."""
    return np.sqrt((len(values) - 1) / len(values) * np.sum((values - values.mean(0)) ** 2, 0))
