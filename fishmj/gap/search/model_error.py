"""Measures the error of a candidate's formulas on the records that they should explain.

form    relative error of the effects' change c, independent in each sample
gain    relative error of its size, common to a channel of a record, c_b the change there
    S = F^T F + gain^2 sum_b c_b c_b^T + D + form^2 c^2

The most likely pair of a grid is taken. Values are fitted with the first error alone, so that strong and weak channels keep their
weights. The second shows the kind of error: a correct formula in another robot is mostly wrong in its size, and in weak channels.
An imitation is wrong from sample to sample, or needs another size in strong channels.

Outlier records. Small errors accumulate along a path, so a correct formula may look wrong where one path bends away. The gate
`transfer` lets some records get worse; the paths of as many are left out here, if the found effects gain on held-out records.
Joints are held by their servos and do not accumulate errors. They are never left out: an effect that imitates another in a servo
is wrong there.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.null.whitening import record_whitening
from fishmj.gap.thresholds import Gates, thresholds

PATH = ("position", "heading")  # channels


class ModelError(NamedTuple):
    """Error of a candidate's formulas.

    form: relative error by sample, with sizes free. gain_error_rms: root mean square over channels and records of the errors of
    size, weighted by information. excess_log_likelihood: gain of |z|^2 + log det S by a `form` above the allowed one.
    """

    form: float
    gain_error_rms: float
    excess_log_likelihood: float


class ModelResponse(NamedTuple):
    """Known covariance without the effects, and the effects' change.

    factors (K, m), by_record (K_l, m_l), known (m,): F, A of each record and D. record (m,): number of each sample's. change,
    scatter (m,): the change, and its running root mean square.
    """

    factors: np.ndarray
    by_record: tuple[np.ndarray, ...]
    record: np.ndarray
    known: np.ndarray
    change: np.ndarray
    scatter: np.ndarray

    def subset(self, columns: np.ndarray) -> "ModelResponse":
        """The same on a part of the samples, columns (m,) bool."""
        by_record = tuple(mine[:, columns[self.record == i]] for i, mine in enumerate(self.by_record))
        whole = (values[..., columns] for values in (self.record, self.known, self.change, self.scatter))
        return ModelResponse(self.factors[:, columns], by_record, *whole)

    def d(self, form: float) -> np.ndarray:
        """D^1/2 (m,)."""
        # The running mean of the change: a formula is no more accurate at the zero crossings of the change than elsewhere, so D
        # must not vanish there.
        return np.sqrt(self.known + (form * self.scatter) ** 2)

    def products(self, factors: np.ndarray, form: float, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Products of factors (K, m) over C^1/2: Gram matrix, product with the residual, and |C^-1/2 r|^2 + log det C."""
        alone = record_whitening(self.d(form), self.by_record, self.record)
        scaled, r = alone(factors), alone(residual)
        return scaled @ scaled.T, scaled @ r, float(r @ r + alone.logdet)

    def losses(self, residual: np.ndarray, forms, gains=(0.0,), channels: np.ndarray | None = None) -> np.ndarray:
        """|z|^2 + log det S, twice the negative log likelihood, of a residual (m,) for each of gains (rows) and of forms.

        channels: (B, m) the effects' change on each channel of each record.
        """
        # log det S must be included: a large form error lowers |z|^2 of any formula, and only log det S penalises it. One Gram
        # matrix per form error serves all gain errors, which only scale its rows.
        out = np.empty((len(gains), len(forms)))
        factors = self.factors if channels is None else np.concatenate([self.factors, channels])
        for j, form in enumerate(forms):
            gram, projected, rest = self.products(factors, form, residual)
            for i, gain in enumerate(gains):
                weight = np.where(np.arange(len(factors)) < len(self.factors), 1.0, gain)
                # Woodbury: S is m x m with m in the thousands, its factors number in the hundreds.
                root = np.linalg.cholesky(np.eye(len(gram)) + weight[:, None] * gram * weight)
                explained = np.linalg.solve(root, weight * projected)
                out[i, j] = rest - explained @ explained + 2.0 * np.sum(np.log(np.diag(root)))
        return out

    def most_likely_form(self, residual: np.ndarray, finer: tuple[float, ...] = ()) -> float:
        """The form error that makes a residual (m,) most likely, with exact sizes. finer: tried beside the usual grid."""
        # A grid suffices: the likelihood is flat in the form error, and an answer must not depend on its third digit.
        grid = (*finer, *thresholds().model_error.form_grid)
        return grid[int(np.argmin(self.losses(residual, grid)))]

    def error(self, residual: np.ndarray, layout, allowed: float, keep: np.ndarray | None = None) -> ModelError:
        """Both most likely errors for a residual (m,).

        allowed: allowed form error. keep: (m,) bool, samples that count; default, all.
        """
        if keep is not None:
            return self.subset(keep)._error(residual[keep], channel_changes(layout, self.change * keep)[:, keep], allowed)
        return self._error(residual, channel_changes(layout, self.change), allowed)

    def _error(self, residual: np.ndarray, channels: np.ndarray, allowed: float) -> ModelError:
        """Both errors, from the change on each channel of each record (B, m)."""
        forms = thresholds().model_error.form_grid
        gains = thresholds().model_error.gain_grid
        losses = self.losses(residual, forms, gains, channels)
        i, j = np.unravel_index(np.argmin(losses), losses.shape)
        # The gate uses the gain in likelihood of a too large form error, not its size: with little information 10 % and 50 % are
        # equally likely.
        within = self.losses(residual, (allowed,), gains, channels).min() if forms[j] > allowed else losses[i, j]
        rms = self._gain_error_rms(residual, channels, forms[j], gains[i])
        return ModelError(forms[j], rms, float(max(within - losses[i, j], 0.0)))

    def _gain_error_rms(self, residual: np.ndarray, channels: np.ndarray, form: float, gain: float) -> float:
        """Root mean square of the channels' gain errors, each weighted by its information beyond all other factors."""
        n = len(self.factors)
        gram, projected, _ = self.products(np.concatenate([self.factors, channels]), form, residual)
        weight = np.where(np.arange(len(gram)) < n, 1.0, gain)
        estimate = weight * np.linalg.solve(np.eye(len(gram)) + weight[:, None] * gram * weight, weight * projected)
        # Schur complement: information of a channel on its gain beyond the possible compensation by the fish's constants.
        inner = np.linalg.solve(np.eye(n) + gram[:n, :n], gram[:n, n:])
        information = np.diag(gram)[n:] - np.sum(gram[:n, n:] * inner, 0)
        return float(np.sqrt(np.sum(information * estimate[n:] ** 2) / max(float(np.sum(information)), 1e-300)))


def channel_changes(layout, change: np.ndarray) -> np.ndarray:
    """(B, m) the change (m,) on each channel of each record, zero elsewhere; channels without change are left out."""
    channels = np.unique(layout.channel)
    masks = [(layout.record == i) & (layout.channel == channel) for i in range(len(layout.records)) for channel in channels]
    return np.array([change * mask for mask in masks if np.any(change[mask] != 0.0)]).reshape(-1, layout.size)


# ------------------------------------------------------------------------------------------------------------ outlier records
def error_without_outliers(near, row: np.ndarray, gain: float, gates: Gates) -> tuple[ModelError, tuple[str, ...]]:
    """(error of the formulas of a row, names of the records whose path is left out).

    near: the `Likelihood` linearised at the row. gain: on records predicted without their fold.
    """
    whole = near.error(row, gates.form)
    few = int((1.0 - gates.transfer) * len(near.records) + 1e-9)
    if not few or gain < gates.gain or believable(whole, gain, gates):
        return whole, ()
    # Each record is left out alone, then the worst of them together. A search over all sets would find one that makes any
    # formula plausible.
    alone = [near.error(row, gates.form, without_paths_of(near, [i])) for i in range(len(near.records))]
    allowed = allowed_excess(gain)
    badness = [max(e.excess_log_likelihood / allowed, e.gain_error_rms / gates.size) for e in alone]
    worst = np.argsort(badness)[:few]
    less = near.error(row, gates.form, without_paths_of(near, worst))
    return (less, tuple(near.records[i].name for i in worst)) if believable(less, gain, gates) else (whole, ())


def without_paths_of(near, outliers) -> np.ndarray:
    """(m,) bool: all samples but the paths of those records."""
    return ~(np.isin(near.layout.record, list(outliers)) & np.isin(near.layout.channel, PATH))


def believable(error: ModelError, gain: float, gates: Gates) -> bool:
    """Returns True if a right formula may have this error."""
    return not error.excess_log_likelihood > allowed_excess(gain) and error.gain_error_rms <= gates.size


def misformed(checks: dict) -> bool:
    """Returns True if the form error is above the gate of a verdict.

    False if it was not tested, or the effect needs an exact value.
    """
    return checks.get("strain", 0.0) > allowed_excess(checks.get("gain", 0.0)) and not checks.get("pinned", False)


def allowed_excess(gain: float) -> float:
    """Gain that a form error above the allowed one may have by chance, for a total gain of `gain`."""
    limits = thresholds().model_error
    return max(limits.excess, limits.excess_fraction * gain)
