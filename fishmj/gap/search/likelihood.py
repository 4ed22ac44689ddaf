"""The likelihood of a set of records, linearised at the effects of a candidate.

    -2 log L(theta) = |z|^2 + log det S,   z = S^-1/2 (measured - predicted)      z, S of a `subset` of the records: fit.py

S comes from the null runs (null/whitening.py). It depends on the point of linearisation, since a delayed, stiff or slow fish
responds differently to its constants:

    S(theta) = F^T F + D,   F: null runs through the sensors of theta; the structural error (null/structural_error.py); the
                            error of a launch (`launch_factors`); the change of the constants' tangents with theta
                            D: residual variance of the null runs, structural error, the nonlinear part of the response to the
                            constants, and model error (form c)^2, where c is the change that the effects make
                            (model_error.py)

A random effect (RobotForm.scatter) adds the covariance of its draws to S: the mean of a jittering latency is a constant latency,
and only the scatter distinguishes them.

gap       |z|^2 / m, before in the S of the present model, after in that of the fish with the effects; about 1 for healthy
          robots. Input of the gates `adequacy` and `rest`
floor     W(t), root mean square of null runs and structural error. The residual must shrink relative to it, too: S grows
          with the found effects, the floor does not
closure   gain / (|z_0|^2 - m): share of the excess that an effect explains, m = length of z
p_best    share of Bayesian bootstrap draws over records (Rubin 1981) in which a candidate has the least cost
"""

from copy import copy

import numpy as np

from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.null import structural_error
from fishmj.gap.null.structural_error import StructuralErrorScales
from fishmj.gap.null.whitening import as_sensed, changes_sensing, leftover, record_whitening, smooth, whitening
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, difference_rows, on_records, refine
from fishmj.gap.search.model_error import ModelError, ModelResponse, channel_changes
from fishmj.gap.thresholds import Gates, thresholds


class KnownLayout(ResidualLayout):
    """A layout that subtracts a known part, (m,) `known`, from each residual."""

    def __init__(self, records: list[Record], known: np.ndarray):
        super().__init__(records)
        self.known = known

    def residuals(self, predictions: list[dict]) -> np.ndarray:
        """(R, size) measured minus predicted, less the known part."""
        return super().residuals(predictions) - self.known


class Likelihood:
    """Likelihood of records given their null runs, with fitters on any part of them.

    null: (n, m) residuals of null runs on the layout of all records. form: relative error of the effects'
    change, sample by sample. widths: scales of the structural error; default, as measured on all families. origin: the
    likelihood at the present model.
    """

    def __init__(
        self,
        model,
        records: list[Record],
        null: np.ndarray,
        form: float | None = None,
        widths: StructuralErrorScales | None = None,
    ):
        limits = thresholds().likelihood
        self.model = model
        self.records = records
        self.origin = self
        self.form = limits.model_error if form is None else form
        self.runs = len(null)
        self.drawn = True  # True if the first factors are the individual null runs; False with healthy swims
        self.layout = ResidualLayout(records)
        # All linearisations use the same draws, so that the draws do not cause differences between them and the origin.
        self._draws = np.random.default_rng(0).standard_normal((limits.nonlinearity_draws, len(model.constants)))
        self._null_tangents, self._null_nonlinear = self._constants(getattr(model, "nothing", model.null))
        self._left = leftover(null, self.layout)
        self._null_factors = null / np.sqrt(len(null))
        # The null runs draw their constants, too. The nonlinear part within the runs' scatter is smooth in time; on the
        # diagonal it costs small effects more than they gain. For a fish in water of the literature this was not measured.
        self.calibrated = structural_error.applies(model)
        self.measured = self.calibrated or isinstance(model, RigidRobot)
        self._null_scatter = np.mean(null**2, 0) if self.measured else 0.0
        self._launches = launch_factors(model, records, self.layout)
        self._cover(null, structural_error.widths() if widths is None else widths)

    def _cover(self, null: np.ndarray, widths: StructuralErrorScales, moved: "structural_error.Tangents | None" = None) -> None:
        """Sets everything that depends on the structural error.

        null: (n, m) residuals of null runs; moved: as in `structural_error.of`.
        """
        self.widths = widths
        self._structural = structural_error.of(self.model, self.records, self.layout, null, self._left, widths, moved)
        self.scatter: tuple[np.ndarray, ...] = ()
        self.factors = np.concatenate([self._null_factors, self._structural.shared, self._launches])
        self.d = np.sqrt(self._left**2 + self._structural.variance)
        self.scale = np.sqrt(np.mean(null**2, 0) + self._left**2 + self._structural.total)
        known = self.d**2
        self.response = ModelResponse(self.factors, self.by_record, self.layout.record, known, *np.zeros((2, self.layout.size)))

    def with_record_errors(self, model) -> "Likelihood":
        """Copy with a model that differs in its `record_errors` only."""
        there = copy(self)
        there.model, there.origin = model, there
        there._cover(self._null_factors * np.sqrt(self.runs), self.widths)
        return there

    def with_own_widths(self) -> "Likelihood":
        """Copy, for healthy swims of one robot, with their own most likely scales (`structural_error.own_widths`)."""
        null, moved, there = self._null_factors * np.sqrt(self.runs), self._structural.moved, copy(self)
        if moved is not None:
            residual = self._residuals(self.model.null[None])[0]
            own = structural_error.own_widths(self.widths, self.layout, null, self._left, moved, residual)
            there.origin = there
            there._cover(null, own, moved)
        return there

    def allowed(self, gates: Gates, calibration_residual: float = 0.0) -> Gates:
        """The gates, widened by the structural error of healthy robots; unchanged for a model without one.

        calibration_residual: baseline misfit, |z|^2 / m on healthy swims of this robot (healthy_swims.py); 0 if not measured.
        """
        applies = structural_error.applies(self.model)
        return structural_error.allowed(gates, self.widths, calibration_residual) if applies else gates

    def healthy_gain(self, stage: str) -> float:
        """Largest reduction of |z|^2 by an effect of a stage on a healthy robot of another water; 0 if unknown."""
        return self.widths.gains.get(stage, 0.0) * len(self.records) if structural_error.applies(self.model) else 0.0

    def formula_error(self, stage: str) -> float:
        """Relative error of an effect's size from the formula of its stage, in an unknown water.

        It is that of any formula if the model is not calibrated or the stage was not measured.
        """
        any_formula = thresholds().intervals.formula_error
        return max(any_formula, self.widths.formula.get(stage, 0.0)) if self.calibrated else any_formula

    @property
    def by_record(self) -> tuple[np.ndarray, ...]:
        """Factors (K_l, m_l) of each record alone: of its errors, then of random effects."""
        alone = self._structural.by_record
        return tuple(np.concatenate(both) for both in zip(alone, self.scatter, strict=True)) if self.scatter else alone

    def with_scatter(self, row: np.ndarray, keep: np.ndarray | None = None) -> "Likelihood":
        """Copy with the scatter of the random effects of a row, and of no others. keep: (L,) bool, records that will be used."""
        drawn: tuple[np.ndarray, ...] = self.model.scatter(self.records, self.layout, row, keep) if draws(self.model) else ()
        if not drawn and not self.scatter:
            return self
        there = copy(self)
        there.scatter = drawn
        there.response = self.response._replace(by_record=there.by_record)
        return there

    @property
    def draws(self) -> int:
        """Number of factors that are null runs, or what remains of them after healthy swims."""
        return len(self._null_factors)

    def given(self, swims: "Likelihood") -> "Likelihood":
        """Copy for a robot with known healthy swims, which reduce the uncertainty of the deviations that its records share.

            e  ~ N(m, P)      shared by the records of a robot: its constants (null runs), the effects of a healthy one
            P  = (1 + F_h C_h^-1 F_h^T)^-1,   m = P F_h C_h^-1 r_h        of the swims; C: the part of each record alone
            S  = F^T P F + C,   r <- r - F^T m

        swims: of the same model, null and scales, at the present model.
        """
        alone = record_whitening(swims.d, swims.by_record, swims.layout.record)
        seen = alone(swims.factors)
        left = np.linalg.inv(np.eye(len(seen)) + seen @ seen.T)
        mean = left @ (seen @ alone(swims._residuals(swims.model.null[None])[0]))
        shared = np.concatenate([self._null_factors, self._structural.shared])
        count = len(shared)  # launch errors of the swims affect no other record
        there = copy(self)
        there.drawn = False
        there.origin = there
        there._null_factors = np.linalg.cholesky(left[:count, :count]).T @ shared
        there._structural = self._structural._replace(shared=shared[:0])
        there.layout = KnownLayout(self.records, mean[:count] @ shared)
        there.factors = np.concatenate([there._null_factors, self._launches])
        there.response = self.response._replace(factors=there.factors)
        return there

    def with_model(self, model) -> "Likelihood":
        """Copy with other candidate effects; `model` at its null is the same model."""
        there = copy(self.origin)
        there.model = model
        there.origin = there
        return there

    def _constants(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Response of a row's residual to the constants' tolerance: (C, m) tangents, (m,) mean square of the nonlinear part."""
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
        """Copy linearised at `row`, whose effects have a relative error `form` of their change in each sample."""
        start = self.origin
        tangents, nonlinear = self._constants(row)
        # Only the change of the tangents is added: the null runs include the scatter of the constants already.
        known_factors = [self._null_through_sensors(row), self._structural.shared, self._launches]
        factors = [*known_factors, tangents - start._null_tangents]
        # The moments at which a joint slips or play closes depend on all constants and differ between fish. One factor per
        # draw would let a fit choose them; on the diagonal they count as noise.
        known = start.d**2 + np.maximum(nonlinear - start._null_nonlinear - start._null_scatter, 0.0)
        change = self._effects_change(row)
        there = copy(self)
        there.factors = np.concatenate(factors)
        scatter = smooth(change, self.layout)
        there.response = ModelResponse(there.factors, self.by_record, self.layout.record, known, change, scatter)
        return there.with_scatter(row).with_model_error(start.form if form is None else form)

    def _null_through_sensors(self, row: np.ndarray) -> np.ndarray:
        """(n, m) null runs over sqrt(n), through the sensors of a parameter row."""
        null = self._null_factors
        root = np.sqrt(self.runs)
        if not changes_sensing(self.model, row):
            return null
        shown = self.layout.measured - self._residuals(row[None])[0]
        return as_sensed(self.model, self.layout, row, shown, null * root) / root

    def with_model_error(self, form: float) -> "Likelihood":
        """Copy with another relative error of the formulas."""
        there = copy(self)
        there.form = form
        there.d = self.response.d(form)
        return there

    def with_estimated_model_error(self, row: np.ndarray) -> "Likelihood":
        """Linearised at a row, with the form error that makes the records most likely: the accuracy of a formula is measured."""
        there = self.linearised_at(row)
        finer = thresholds().model_error.fine_form_grid if self.measured else ()
        return there.with_model_error(there.response.most_likely_form(self._residuals(row[None])[0], finer))

    def tolerating(self, row: np.ndarray, gates: Gates) -> tuple["Likelihood", float]:
        """(copy in which the formulas of a row have their largest allowed error, gain that such an error can imitate).

            S += form^2 diag(c^2) + size^2 sum_b c_b c_b^T        imitated = sum (e c)^2 / D

        c (m,) is the change by the row, c_b that on one channel of a record, e the error of any formula. If another
        effect gains more than `imitated` there, the error of these formulas is not the cause.
        """
        change = self._effects_change(row)
        there = copy(self)
        there.d = np.sqrt(self.response.known + (gates.form * smooth(change, self.layout)) ** 2)
        there.factors = np.concatenate([self.factors, gates.size * channel_changes(self.layout, change)])
        return there, float(np.sum((thresholds().intervals.formula_error * change / there.d) ** 2))

    def _effects_change(self, row: np.ndarray) -> np.ndarray:
        """(m,) change by the effects of a row; zero for a weighing, which has no formula error."""
        return self.change(row, self.model.null) * (self.layout.channel != mass_properties.CHANNEL)

    def with_parameter_uncertainty(self, row: np.ndarray) -> "Likelihood":
        """Copy for estimating values: F also gets the constants' tangents times `form`, since these depend on the formulas."""
        there = copy(self)
        there.factors = np.concatenate([self.factors, self.form * self._constants(row)[0]])
        return there

    def error(self, row: np.ndarray, allowed: float, keep: np.ndarray | None = None) -> ModelError:
        """Error of the formulas of the row at which this is linearised.

        allowed: their allowed form error. keep: (m,) bool, samples to use; default, all.
        """
        return self.response.error(self._residuals(row[None])[0], self.layout, allowed, keep)

    def subset(self, keep: np.ndarray | None = None, more: np.ndarray | None = None) -> EffectFitter:
        """Fitter on the records with keep (L,) true; default, all. more: (K, n) further factors of S there."""
        keep = np.ones(len(self.records), bool) if keep is None else keep
        records = [r for r, k in zip(self.records, keep, strict=True) if k]
        columns = keep[self.layout.record]
        factors, layout = self.factors[:, columns], self._layout_of(records, columns)
        factors = factors if more is None else np.concatenate([factors, more])
        by_record = [mine for mine, kept in zip(self.by_record, keep, strict=True) if kept] if self.by_record else ()
        return EffectFitter(self.model, records, layout, whitening(factors, self.d[columns], by_record, layout.record))

    def _layout_of(self, records: list[Record], columns: np.ndarray) -> ResidualLayout:
        """Layout of a part of the records, columns (m,) bool."""
        return (
            KnownLayout(records, self.layout.known[columns]) if isinstance(self.layout, KnownLayout) else ResidualLayout(records)
        )

    def loss(self, row: np.ndarray) -> float:
        """Twice the negative log likelihood of all records, of one parameter row."""
        return self.subset().loss(row)

    def jacobian(self, c: Candidate) -> np.ndarray:
        """(K, m) derivatives of the residual by each parameter of a candidate, in units of its typical size."""
        size = bounds(self.model)[2]
        rows, moved = difference_rows(self.model, c)
        residuals = self._residuals(np.concatenate([c.row[None], rows]))
        return (residuals[1:] - residuals[0]) / (moved / size[list(c.places)])[:, None]

    def change(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(m,) change of the residual from one parameter row to another."""
        before, after = self._residuals(np.stack([start, end]))
        return after - before

    def gap(self, row, keep: np.ndarray | None = None) -> tuple[float, dict]:
        """(gap, {channel: gap}) of a parameter row. keep: (L,) bool, records to use; default, all."""
        part = self.subset(keep)
        return by_channel(part.z(row[None])[0] ** 2, part.layout)

    def gap_there(self, row) -> tuple[float, dict]:
        """The gap of a parameter row, linearised at the row, with the form error that makes the records most likely."""
        there = self if np.array_equal(row, self.model.null) else self.with_estimated_model_error(row)
        return there.gap(row)

    def over_floor(self, row) -> tuple[float, dict]:
        """Mean square of the residual of a row over the floor, records and channels alike, and by channel."""
        return over_floor(self._residuals(row[None])[0], self.scale, self.layout)


def draws(model, names=None) -> list:
    """Random effects (RobotForm.scatter) of a model, among `names`."""
    known = model.active.effects if hasattr(model, "scatter") else ()
    return [x for x in known if x.robot.scatter and (names is None or x.name in names)]


def likelihood_of(model, records: list[Record], null, bars: Bars = silent_bar, swims: Likelihood | None = None) -> Likelihood:
    """Likelihood of records with the null runs of `null` (a `SimulatedNull`).

    bars: of new runs. swims: healthy ones of this robot with its own scales, which shrink the structural error.
    """
    runs = null.residuals(model, records, ResidualLayout(records), bars)
    if swims is not None:
        return Likelihood(model, records, runs, widths=swims.widths).given(swims)
    return Likelihood(model, records, runs, widths=structural_error.widths(null.without if isinstance(null.without, str) else ""))


def relinearise(e: Likelihood, best: Candidate, times: int | None = None) -> tuple[Likelihood, Candidate]:
    """(likelihood linearised at the candidate, candidate refitted there): the response to the constants depends on the effects.

    A step that makes the candidate less likely in the likelihood linearised at itself is rejected: otherwise the iteration could
    end at a covariance so wide that it explains everything.
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


def by_channel(squared: np.ndarray, layout) -> tuple[float, dict]:
    """(mean, {channel: mean}) of z^2 (m,)."""
    channels = dict.fromkeys(layout.channel.tolist())
    return float(np.mean(squared)), {str(c): float(np.mean(squared[layout.channel == c])) for c in channels}


def over_floor(residual: np.ndarray, scale: np.ndarray, layout) -> tuple[float, dict]:
    """Mean square in units of the floor: over all, every record and channel alike, and over each channel."""
    ratio = (residual / scale) ** 2
    found: dict[str, list] = {}
    for b in layout.blocks:
        found.setdefault(b.channel, []).append(float(np.mean(ratio[b.where])))
    channels = {channel: float(np.mean(values)) for channel, values in found.items()}
    return float(np.mean(list(channels.values()))), channels


def costs(z: np.ndarray, layout) -> np.ndarray:
    """|z|^2 of each record, (..., L)."""
    out = np.zeros((*z.shape[:-1], len(layout.records)))
    for b in layout.blocks:
        out[..., b.record] += np.sum(z[..., b.where] ** 2, -1)
    return out


def closure(cost_before: float, cost_after: float, size: float) -> float:
    """Share of the excess over m that is removed; all of it once |z|^2 is below m."""
    gone = cost_before - cost_after
    return float(gone / max(cost_before - size, gone)) if gone > 0 else 0.0


def losses(fitter: EffectFitter, z: np.ndarray) -> np.ndarray:
    """|z|^2 + log det S of each record (L,), z (m,); the shared part of log det S is divided equally."""
    whiten, record = fitter.whiten, fitter.layout.record
    out = np.bincount(record, weights=2.0 * np.log(whiten.alone.d)) - 2.0 * np.sum(np.log(whiten.g)) / len(fitter.records)
    for where, _, g in whiten.alone.parts:
        out[record[where[0]]] -= 2.0 * np.sum(np.log(g))
    return out + costs(z, fitter.layout)


def p_best(per_record: np.ndarray, seed: int = 0) -> np.ndarray:
    """(C,) share of bootstrap draws that each candidate wins, from its loss in each record (C, L)."""
    draws = thresholds().likelihood.bootstrap_draws
    weights = np.random.default_rng(seed).dirichlet(np.ones(per_record.shape[1]), draws)
    totals = weights @ per_record.T
    winners = totals == totals.min(1, keepdims=True)  # effects that are the same by construction share a draw
    return np.mean(winners / winners.sum(1, keepdims=True), 0)


def launch_factors(model, records: list[Record], layout: ResidualLayout) -> np.ndarray:
    """(K, m) factors c of every record that states the error of its launch, `push_sigma`: one standard deviation each.

        S += sum_k c_k c_k^T        c_k = residual at push + sigma_k e_k less that at push: surge, sway [m/s], yaw rate [rad/s]

    A launch by a carriage of known speed needs none. A velocity from the camera is known to 1 cm/s, and its error grows along the
    path.
    """
    row = np.asarray(getattr(model, "nothing", model.null))[None]
    found = [np.zeros((0, layout.size))]
    for i, record in enumerate(records):
        sigma = np.asarray(record.push_sigma, float)
        if not sigma.any():
            continue
        others = [record._replace(push=record.push + step) for step in np.diag(sigma)]
        alone = ResidualLayout([record])
        seen = np.nan_to_num([alone.residuals([one])[0] for one in model.predict([record, *others], row)])
        moved = np.zeros((len(sigma), layout.size))
        moved[:, layout.record == i] = seen[1:] - seen[0]
        found.append(moved)
    return np.concatenate(found)
