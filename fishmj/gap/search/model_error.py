"""How wrong the formulas of a candidate are, measured on the records that they should explain.

form    share by which what they change differs from sample to sample: D grows
gain    share by which it is larger or smaller on a whole channel of a record: a factor of S each, c_b the change there

    S = F^T F + gain^2 sum_b c_b c_b^T + D + form^2 c^2

Of a grid of both, the pair that makes the records most likely counts. Values are fitted with the first alone, so that strong and
weak channels keep their weights. The second tells what kind of error it is: a right formula in another robot is mostly wrong in
its size, and where little is to be seen; one that stands in for something else is wrong from sample to sample, or has to be
resized where it matters.

Outlier records. Small errors add up along a path: where it bends away in one record, a right formula looks wrong there. The gate
of transfer lets some records get worse; the paths of as many are left out here, if what was found gains on records predicted
without their fold. Joints are held by their servos, where nothing adds up, and are never left out: what stands in for something
else in a servo is wrong in them.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.null.whitening import record_whitening
from fishmj.gap.thresholds import Gates, thresholds

PATH = ("position", "heading")  # channels


class ModelError(NamedTuple):
    """Of the formulas of a candidate. form: of each sample, where sizes may be wrong. gain_error_rms: root mean square over
    channels and records of what the sizes are wrong by, each weighted by its information. excess_log_likelihood: what
    |z|^2 + log det S gains by a `form` that is larger than it should be."""

    form: float
    gain_error_rms: float
    excess_log_likelihood: float


class ModelResponse(NamedTuple):
    """What is known without the effects, and what they change.

    factors (K, m), by_record (K_l, m_l), known (m,): F, A of each record and D. record (m,): number of each sample's. change,
    scatter (m,): what they change, and its running root mean square.
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
        # The running mean of the change, not the change itself: at its zero crossings a formula is no better known than beside
        # them, and D must not vanish there.
        return np.sqrt(self.known + (form * self.scatter) ** 2)

    def products(self, factors: np.ndarray, form: float, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Of factors (K, m) over C^1/2: their Gram matrix, with the residual over C^1/2, and |C^-1/2 r|^2 + log det C."""
        alone = record_whitening(self.d(form), self.by_record, self.record)
        scaled, r = alone(factors), alone(residual)
        return scaled @ scaled.T, scaled @ r, float(r @ r + alone.logdet)

    def losses(self, residual: np.ndarray, forms, gains=(0.0,), channels: np.ndarray | None = None) -> np.ndarray:
        """|z|^2 + log det S, twice the negative log likelihood, of a residual (m,) for each of gains (rows) and of forms.

        channels: (B, m) what the effects change on each channel of each record.
        """
        # The determinant is not left out, as a chi-squared would: a large form error lowers |z|^2 of anything, and only
        # log det S charges for it. One Gram matrix per form error serves all gain errors, which only scale its rows.
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
        """The form error that makes a residual (m,) most likely, sizes taken as right. finer: tried beside the usual grid."""
        # A grid, not an optimiser: the likelihood is flat in the form error, and a name must not hang on its third digit.
        grid = (*finer, *thresholds().model_error.form_grid)
        return grid[int(np.argmin(self.losses(residual, grid)))]

    def error(self, residual: np.ndarray, layout, allowed: float, keep: np.ndarray | None = None) -> ModelError:
        """Both errors that a residual (m,) asks for. allowed: form error that there may be. keep: (m,) bool, samples that count;
        default, all."""
        if keep is not None:
            return self.subset(keep)._error(residual[keep], channel_changes(layout, self.change * keep)[:, keep], allowed)
        return self._error(residual, channel_changes(layout, self.change), allowed)

    def _error(self, residual: np.ndarray, channels: np.ndarray, allowed: float) -> ModelError:
        """The same, of what is changed on each channel of each record (B, m)."""
        forms = thresholds().model_error.form_grid
        gains = thresholds().model_error.gain_grid
        losses = self.losses(residual, forms, gains, channels)
        i, j = np.unravel_index(np.argmin(losses), losses.shape)
        # How much a too large form error gains is what is judged, not its size alone: where little is to be seen, 10 % and
        # 50 % are equally likely, and that speaks against nothing.
        within = self.losses(residual, (allowed,), gains, channels).min() if forms[j] > allowed else losses[i, j]
        rms = self._gain_error_rms(residual, channels, forms[j], gains[i])
        return ModelError(forms[j], rms, float(max(within - losses[i, j], 0.0)))

    def _gain_error_rms(self, residual: np.ndarray, channels: np.ndarray, form: float, gain: float) -> float:
        """Root mean square of the channels' gain errors, each weighted by the information on it that all else leaves."""
        n = len(self.factors)
        gram, projected, _ = self.products(np.concatenate([self.factors, channels]), form, residual)
        weight = np.where(np.arange(len(gram)) < n, 1.0, gain)
        estimate = weight * np.linalg.solve(np.eye(len(gram)) + weight[:, None] * gram * weight, weight * projected)
        # Schur complement: what a channel says of its gain beyond what the fish's constants could make up for.
        inner = np.linalg.solve(np.eye(n) + gram[:n, :n], gram[:n, n:])
        information = np.diag(gram)[n:] - np.sum(gram[:n, n:] * inner, 0)
        return float(np.sqrt(np.sum(information * estimate[n:] ** 2) / max(float(np.sum(information)), 1e-300)))


def channel_changes(layout, change: np.ndarray) -> np.ndarray:
    """(B, m) what is changed (m,) on each channel of each record, zero elsewhere; those where nothing is are left out."""
    channels = np.unique(layout.channel)
    masks = [(layout.record == i) & (layout.channel == channel) for i in range(len(layout.records)) for channel in channels]
    return np.array([change * mask for mask in masks if np.any(change[mask] != 0.0)]).reshape(-1, layout.size)


# ------------------------------------------------------------------------------------------------------------ outlier records
def error_without_outliers(near, row: np.ndarray, gain: float, gates: Gates) -> tuple[ModelError, tuple[str, ...]]:
    """(error of the formulas of a row, names of the records whose path is left out). near: the `Likelihood` linearised at the
    row. gain: on records predicted without their fold."""
    whole = near.error(row, gates.form)
    few = int((1.0 - gates.transfer) * len(near.records) + 1e-9)
    if not few or gain < gates.gain or believable(whole, gain, gates):
        return whole, ()
    # Each record is left out by itself and the worst of them together: trying all pairs would find a set that makes anything
    # believable.
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
    """Whether a right formula may be as wrong."""
    return not error.excess_log_likelihood > allowed_excess(gain) and error.gain_error_rms <= gates.size


def misformed(checks: dict) -> bool:
    """Whether the formula is too wrong, by the gates of a verdict; not where that was never asked, nor of what is pinned."""
    return checks.get("strain", 0.0) > allowed_excess(checks.get("gain", 0.0)) and not checks.get("pinned", False)


def allowed_excess(gain: float) -> float:
    """What a form error beyond the allowed may gain by chance, where what was found gains `gain`."""
    limits = thresholds().model_error
    return max(limits.excess, limits.excess_fraction * gain)
