"""How wrong the formulas of a candidate are, measured on the records that they should explain.

form    share by which what they change differs from sample to sample: D grows
size    share by which it is larger or smaller on a whole channel of a record: a factor of S each, c_b the change there

    S = F^T F + size^2 sum_b c_b c_b^T + D + form^2 c^2

Of a grid of both, the pair that makes the records most likely counts. Values are fitted with the first alone, so that strong and
weak channels keep their weights. The second tells what kind of error it is: a right formula in another robot is mostly wrong in
its size, and where little is to be seen; one that stands in for something else is wrong from sample to sample, or has to be
resized where it matters.
"""

from typing import NamedTuple

import numpy as np

FORMS = (0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.22, 0.33, 0.5)  # those that are tried
SIZES = (0.0, 0.05, 0.1, 0.2)


class ModelError(NamedTuple):
    """Of the formulas of a candidate. form: of each sample, where sizes may be wrong. resized: root mean square over channels and
    records of what the sizes are wrong by, each as heavy as it can be told. strain: what |z|^2 + log det S gains by a `form` that
    is larger than it should be."""

    form: float
    resized: float
    strain: float


class ModelResponse(NamedTuple):
    """What is known without the effects, and what they change.

    factors (K, m), known (m,): F and D. change, scatter (m,): what they change, and its running root mean square.
    """

    factors: np.ndarray
    known: np.ndarray
    change: np.ndarray
    scatter: np.ndarray

    def on(self, columns: np.ndarray) -> "ModelResponse":
        """The same on a part of the samples, columns (m,) bool."""
        return ModelResponse(*(values[..., columns] for values in self))

    def d(self, form: float) -> np.ndarray:
        """D^1/2 (m,)."""
        return np.sqrt(self.known + (form * self.scatter) ** 2)

    def unlikely(self, residual: np.ndarray, forms=FORMS, sizes=(0.0,), parts=None) -> np.ndarray:
        """|z|^2 + log det S of a residual (m,) for each of sizes (rows) and of forms. parts: (B, m)."""
        out = np.empty((len(sizes), len(forms)))
        factors = self.factors if parts is None else np.concatenate([self.factors, parts])
        for j, form in enumerate(forms):
            gram, seen, rest = products(factors, self.d(form), residual)
            for i, size in enumerate(sizes):
                weight = np.where(np.arange(len(factors)) < len(self.factors), 1.0, size)
                root = np.linalg.cholesky(np.eye(len(gram)) + weight[:, None] * gram * weight)
                taken = np.linalg.solve(root, weight * seen)
                out[i, j] = rest - taken @ taken + 2.0 * np.sum(np.log(np.diag(root)))
        return out

    def likely(self, residual: np.ndarray) -> float:
        """The form error that makes a residual (m,) most likely, sizes taken as right."""
        return FORMS[int(np.argmin(self.unlikely(residual)))]

    def error(self, residual: np.ndarray, layout, most: float, keep: np.ndarray | None = None) -> ModelError:
        """Both errors that a residual (m,) asks for. most: form error that there should be. keep: (m,) bool, samples that count;
        default, all."""
        if keep is not None:
            return self.on(keep)._error(residual[keep], parts(layout, self.change * keep)[:, keep], most)
        return self._error(residual, parts(layout, self.change), most)

    def _error(self, residual: np.ndarray, given: np.ndarray, most: float) -> ModelError:
        """The same, of parts (B, m)."""
        losses = self.unlikely(residual, FORMS, SIZES, given)
        i, j = np.unravel_index(np.argmin(losses), losses.shape)
        within = self.unlikely(residual, (most,), SIZES, given).min() if FORMS[j] > most else losses[i, j]
        return ModelError(FORMS[j], self._resized(residual, given, FORMS[j], SIZES[i]), float(max(within - losses[i, j], 0.0)))

    def _resized(self, residual: np.ndarray, given: np.ndarray, form: float, size: float) -> float:
        """Root mean square of the parts' coefficients, each as heavy as everything else lets it be told."""
        n = len(self.factors)
        gram, seen, _ = products(np.concatenate([self.factors, given]), self.d(form), residual)
        weight = np.where(np.arange(len(gram)) < n, 1.0, size)
        asked = weight * np.linalg.solve(np.eye(len(gram)) + weight[:, None] * gram * weight, weight * seen)
        inner = np.linalg.solve(np.eye(n) + gram[:n, :n], gram[:n, n:])
        told = np.diag(gram)[n:] - np.sum(gram[:n, n:] * inner, 0)
        return float(np.sqrt(np.sum(told * asked[n:] ** 2) / max(float(np.sum(told)), 1e-300)))


def products(factors: np.ndarray, d: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Of factors (K, m) over d (m,): their Gram matrix, with the residual over d, and |r / d|^2 + log det D."""
    scaled, r = factors / d, residual / d
    return scaled @ scaled.T, scaled @ r, float(r @ r + 2.0 * np.sum(np.log(d)))


def parts(layout, change: np.ndarray) -> np.ndarray:
    """(B, m) what is changed (m,) on each channel of each record, zero elsewhere; those where nothing is are left out."""
    channels = np.unique(layout.channel)
    masks = [(layout.record == i) & (layout.channel == channel) for i in range(len(layout.records)) for channel in channels]
    return np.array([change * mask for mask in masks if np.any(change[mask] != 0.0)]).reshape(-1, layout.size)
