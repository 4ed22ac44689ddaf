"""The likelihood of a set of records, linearised at the effects of a candidate.

    -2 log L(theta) = |z|^2 + log det S,   z = S^-1/2 (measured - predicted)      z, S of a `subset` of the records: fit.py

S comes from the null runs (null/whitening.py) and depends on where it is linearised, since a fish that is late, stiff or slow
answers to its constants in another way:

    S(theta) = F^T F + D,   F: null runs, seen through the sensors of theta; and the change of the constants' tangents with theta
                            D: what null runs leave unexplained, the response to the constants that is not linear, and
                            (form c)^2 where c is what theta changes: no formula is the robot's (model_error.py)

gap       mean over records and channels of mean_t (r / W)^2,  W^2(t) the null's own mean square: agreement is about 1
closure   gain / (|z_0|^2 - m): share of what is unexpected that an effect explains, m = length of z
p_best    share of Bayesian bootstrap draws over records (Rubin 1981) in which a candidate has the least cost
"""

from copy import copy

import numpy as np

from fishmj.gap.null.whitening import as_sensed, changes_sensing, leftover, smooth, whitening
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, difference_rows, on_records, refine
from fishmj.gap.search.model_error import ModelError, ModelResponse
from fishmj.gap.thresholds import thresholds
from fishmj.gap.watch import Bars, silent


class Likelihood:
    """Of records with their null; fitters on any part of them.

    null: (n, m) residuals of null runs on the layout of all records. form: relative error of each sample of what the effects
    change. origin: the likelihood at the model as it is.
    """

    def __init__(self, model, records: list[Record], null: np.ndarray, form: float | None = None):
        limits = thresholds().likelihood
        self.model = model
        self.records = records
        self.origin = self
        self.form = limits.model_error if form is None else form
        self.runs = len(null)
        self.layout = ResidualLayout(records)
        # One set of draws, kept: whatever is linearised later is compared with the origin draw by draw, so that their
        # difference is not the draws'.
        self._draws = np.random.default_rng(0).standard_normal((limits.nonlinearity_draws, len(model.constants)))
        self._null_tangents, self._null_nonlinear = self._constants(getattr(model, "nothing", model.null))
        self.factors = null / np.sqrt(len(null))
        self.d = leftover(null, self.layout)
        self.scale = np.sqrt(np.mean(null**2, 0) + self.d**2)
        self.response = ModelResponse(self.factors, self.d**2, *np.zeros((2, self.layout.size)))

    def with_model(self, model) -> "Likelihood":
        """The same records and null with other effects in question; `model` at its null is the same model."""
        there = copy(self.origin)
        there.model = model
        there.origin = there
        return there

    def _constants(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the constants' tolerance does to the residual of a parameter row: (C, m) tangents, (m,) mean square of what is
        not linear in them."""
        sigma = np.array([constant.sigma for constant in self.model.constants])
        draws = np.concatenate([np.zeros((1, len(sigma))), np.eye(len(sigma)), self._draws])
        rows = np.tile(row, (len(draws), 1))
        rows[:, : len(sigma)] += draws * sigma
        residuals = self._residuals(rows)
        moved = residuals[1:] - residuals[0]
        tangents = moved[: len(sigma)]
        nonlinear = np.mean((moved[len(sigma) :] - self._draws @ tangents) ** 2, 0)
        return tangents, smooth(np.sqrt(nonlinear), self.layout) ** 2

    def _residuals(self, rows) -> np.ndarray:
        return np.nan_to_num(self.layout.residuals(self.model.predict(self.records, rows)))

    def linearised_at(self, row: np.ndarray, form: float | None = None) -> "Likelihood":
        """The same for a fish that has the effects of `row`, right to within `form` of what they change at each moment."""
        start = self.origin
        tangents, nonlinear = self._constants(row)
        # Only the change of the tangents is added: the null fish already differ by their constants, so the tangents
        # themselves would count that scatter twice.
        factors = np.concatenate([self._null_through_sensors(row), tangents - start._null_tangents])
        # When a joint slips or a gear's play is taken up hangs on all constants, and no two fish do it at the same moment.
        # A factor per draw would let those moments be fitted; on the diagonal they are uncertain.
        known = start.d**2 + np.maximum(nonlinear - start._null_nonlinear, 0.0)
        # A weighing is what mass means, no formula of the water's: no form error is granted there.
        change = self.change(row, self.model.null) * (self.layout.channel != mass_properties.CHANNEL)
        there = copy(self)
        there.factors = factors
        there.response = ModelResponse(factors, known, change, smooth(change, self.layout))
        return there.with_model_error(start.form if form is None else form)

    def _null_through_sensors(self, row: np.ndarray) -> np.ndarray:
        """(n, m) null runs over sqrt(n), through the sensors of a parameter row."""
        null = self.origin.factors
        root = np.sqrt(self.runs)
        if not changes_sensing(self.model, row):
            return null
        shown = self.layout.measured - self._residuals(row[None])[0]
        return as_sensed(self.model, self.layout, row, shown, null * root) / root

    def with_model_error(self, form: float) -> "Likelihood":
        """The same effects, right to within another relative error."""
        there = copy(self)
        there.form = form
        there.d = self.response.d(form)
        return there

    def with_estimated_model_error(self, row: np.ndarray) -> "Likelihood":
        """Linearised at a row, with the form error that makes the records most likely: how far a formula holds is measured."""
        there = self.linearised_at(row)
        return there.with_model_error(there.response.most_likely_form(self._residuals(row[None])[0]))

    def with_parameter_uncertainty(self, row: np.ndarray) -> "Likelihood":
        """For values: what the constants do is no better known than the formulas, F also gets their tangents times `form`."""
        there = copy(self)
        there.factors = np.concatenate([self.factors, self.form * self._constants(row)[0]])
        return there

    def error(self, row: np.ndarray, allowed: float, keep: np.ndarray | None = None) -> ModelError:
        """How wrong the formulas of the row are at which this is linearised. allowed: form error that they may have. keep: (m,)
        bool, samples that count; default, all."""
        return self.response.error(self._residuals(row[None])[0], self.layout, allowed, keep)

    def subset(self, keep: np.ndarray | None = None, more: np.ndarray | None = None) -> EffectFitter:
        """A fitter on the records where keep (L,) is true; default, all. more: (K, n) further factors of S there."""
        keep = np.ones(len(self.records), bool) if keep is None else keep
        records = [r for r, k in zip(self.records, keep, strict=True) if k]
        columns = keep[self.layout.record]
        factors = self.factors[:, columns]
        factors = factors if more is None else np.concatenate([factors, more])
        return EffectFitter(self.model, records, ResidualLayout(records), whitening(factors, self.d[columns]))

    def loss(self, row: np.ndarray) -> float:
        """Twice the negative log likelihood of all records, of one parameter row."""
        return self.subset().loss(row)

    def jacobian(self, c: Candidate) -> np.ndarray:
        """(K, m) what a typical size of each parameter of a candidate does to the residual, about its values."""
        size = bounds(self.model)[2]
        rows = np.concatenate([c.row[None], difference_rows(self.model, c)])
        residuals = self._residuals(rows)
        moves = np.array([(row[p] - c.row[p]) / size[p] for row, p in zip(rows[1:], c.places, strict=True)])
        return (residuals[1:] - residuals[0]) / moves.reshape(-1, 1)

    def change(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(m,) what going from one parameter row to another does to the residual."""
        before, after = self._residuals(np.stack([start, end]))
        return after - before

    def gap(self, row) -> tuple[float, dict]:
        """The gap of a parameter row over all records and by channel, in units of the floor."""
        residual = self.layout.residuals(self.model.predict(self.records, row))[0]
        return gap(residual, self.scale, self.layout), by_channel(residual, self.scale, self.layout)


def likelihood_of(model, records: list[Record], null, bars: Bars = silent) -> Likelihood:
    """Of records with the null runs that `null` (a `SimulatedNull`) makes of them. bars: of runs made anew."""
    return Likelihood(model, records, null.residuals(model, records, ResidualLayout(records), bars))


def relinearise(e: Likelihood, best: Candidate, times: int | None = None) -> tuple[Likelihood, Candidate]:
    """(likelihood linearised at the candidate, it at its best there): what the constants may do depends on the effects.

    A step that makes the candidate less likely in the likelihood linearised at itself is not taken: values and covariance chase
    each other, and a covariance that explains everything must not win.
    """
    near = e.with_estimated_model_error(best.row)
    loss = near.loss(best.row)
    for _ in range(thresholds().likelihood.relinearisations if times is None else times):
        proposal = refine(near.subset(), best)
        there = e.with_estimated_model_error(proposal.row)
        proposal_loss = there.loss(proposal.row)
        if proposal_loss > loss:
            break
        near = there
        best = proposal
        loss = proposal_loss
    return near, on_records(near.subset(), best)


def gap(residual: np.ndarray, scale: np.ndarray, layout) -> float:
    """Mean square in units of the floor; every record and channel counts alike."""
    return float(np.mean(list(by_channel(residual, scale, layout).values())))


def by_channel(residual: np.ndarray, scale: np.ndarray, layout, keep: np.ndarray | None = None) -> dict[str, float]:
    """The same for each channel: joint, position, heading, power. keep: (L,) bool, records that count; default, all."""
    ratio = (residual / scale) ** 2
    found: dict[str, list] = {}
    for b in layout.blocks:
        if keep is None or keep[b.record]:
            found.setdefault(b.channel, []).append(float(np.mean(ratio[b.where])))
    return {channel: float(np.mean(values)) for channel, values in found.items()}


def costs(z: np.ndarray, layout) -> np.ndarray:
    """|z|^2 of each record, (..., L)."""
    out = np.zeros((*z.shape[:-1], len(layout.records)))
    for b in layout.blocks:
        out[..., b.record] += np.sum(z[..., b.where] ** 2, -1)
    return out


def closure(cost_before: float, cost_after: float, size: float) -> float:
    """Share of the excess over m that is gone; all of it once |z|^2 is below m."""
    gone = cost_before - cost_after
    return float(gone / max(cost_before - size, gone)) if gone > 0 else 0.0


def p_best(per_record: np.ndarray, seed: int = 0) -> np.ndarray:
    """Share of draws that each candidate (C, L) wins."""
    draws = thresholds().likelihood.bootstrap_draws
    weights = np.random.default_rng(seed).dirichlet(np.ones(per_record.shape[1]), draws)
    winners = np.argmin(weights @ per_record.T, 1)
    return np.bincount(winners, minlength=len(per_record)) / draws
