"""What a set of records says for and against candidates: gaps, gains, closure, who is best.

gap       mean over records and channels of mean_t (r / W)^2,  W^2(t) the null's own mean square: agreement is about 1
gain      |z_0|^2 - |z_1|^2 on records that no parameter was fitted to
closure   gain / (|z_0|^2 - m): share of what is unexpected that an effect explains, m = length of z
p_best    share of Bayesian bootstrap draws over records (Rubin 1981) in which a candidate has the least cost
"""

from copy import copy

import numpy as np

from fishmj.gap.null.through_sensors import sensed, through
from fishmj.gap.null.whitening import leftover, smooth, whitening
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record
from fishmj.gap.records.residual import ResidualLayout
from fishmj.gap.search.effect_fitter import STEP, Candidate, EffectFitter, bounds
from fishmj.gap.search.model_error import ModelError, ModelResponse

DRAWS = 2000
TURNS = 16  # draws of the constants, to see what is not linear in them
FORM = 0.1  # relative error of a formula where the records have not told


class Likelihood:
    """Records with their null, and searches on any part of them.

    null: (n, m) residuals of null runs on the layout of all records. form: relative error of each sample of what the effects
    change, in the evidence around a candidate. origin: the evidence around the model as it is.
    """

    def __init__(self, plant, records: list[Record], null: np.ndarray, form: float = FORM):
        self.plant, self.records, self.form, self.origin = plant, records, form, self
        self.runs = len(null)
        self.layout = ResidualLayout(records)
        self._draws = np.random.default_rng(0).standard_normal((TURNS, len(plant.constants)))
        self._held, self._bent = self._constants(getattr(plant, "nothing", plant.null))
        self.factors = null / np.sqrt(len(null))
        self.d = leftover(null, self.layout)
        self.scale = np.sqrt(np.mean(null**2, 0) + self.d**2)
        self.changed = ModelResponse(self.factors, self.d**2, *np.zeros((2, self.layout.size)))

    @property
    def everything(self) -> np.ndarray:
        """(L,) bool: all records."""
        return np.ones(len(self.records), bool)

    def on(self, plant) -> "Likelihood":
        """The same records and null with other effects in question; `plant` at its null is the same model."""
        there = copy(self.origin)
        there.plant, there.origin = plant, there
        return there

    def _constants(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the constants' tolerance does to the residual of a parameter row: (C, m) tangents, (m,) mean square of what is
        not linear in them."""
        sigma = np.array([constant.sigma for constant in self.plant.constants])
        draws = np.concatenate([np.zeros((1, len(sigma))), np.eye(len(sigma)), self._draws])
        rows = np.tile(row, (len(draws), 1))
        rows[:, : len(sigma)] += draws * sigma
        residuals = self._residuals(rows)
        moved = residuals[1:] - residuals[0]
        tangents = moved[: len(sigma)]
        bent = np.mean((moved[len(sigma) :] - self._draws @ tangents) ** 2, 0)
        return tangents, smooth(np.sqrt(bent), self.layout) ** 2

    def _residuals(self, rows) -> np.ndarray:
        return np.nan_to_num(self.layout.residuals(self.plant.predict(self.records, rows)))

    def around(self, row: np.ndarray, form: float | None = None) -> "Likelihood":
        """The same for a fish that has the effects of `row`, right to within `form` of what they change at each moment.

        D also grows by what is not linear in the constants: when a joint slips or a gear's play is taken up hangs on all of them,
        and no two fish do it at the same moments.
        """
        start = self.origin
        tangents, bent = self._constants(row)
        factors = np.concatenate([self._seen(row), tangents - start._held])
        known = start.d**2 + np.maximum(bent - self._bent, 0.0)
        change = self.change(row, self.plant.null) * (self.layout.channel != mass_properties.CHANNEL)
        there = copy(self)
        there.factors, there.changed = factors, ModelResponse(factors, known, change, smooth(change, self.layout))
        return there.within(start.form if form is None else form)

    def _seen(self, row: np.ndarray) -> np.ndarray:
        """(n, m) null runs over sqrt(n), through the sensors of a parameter row."""
        null, root = self.origin.factors, np.sqrt(self.runs)
        if not sensed(self.plant, row):
            return null
        shown = self.layout.measured - self._residuals(row[None])[0]
        return through(self.plant, self.layout, row, shown, null * root) / root

    def within(self, form: float) -> "Likelihood":
        """The same effects, trusted to within another relative error."""
        there = copy(self)
        there.form, there.d = form, self.changed.d(form)
        return there

    def trusted(self, row: np.ndarray) -> "Likelihood":
        """Evidence around a row with the form error that makes the records most likely: how far a formula holds is measured."""
        there = self.around(row)
        return there.within(there.changed.likely(self._residuals(row[None])[0]))

    def doubted(self, row: np.ndarray) -> "Likelihood":
        """For values: what the constants do is no better known than the formulas, F also gets their tangents times `form`."""
        there = copy(self)
        there.factors = np.concatenate([self.factors, self.form * self._constants(row)[0]])
        return there

    def error(self, row: np.ndarray, most: float, keep: np.ndarray | None = None) -> ModelError:
        """How wrong the formulas of the row are, around which this is. most: form error that they should have. keep: (m,) bool,
        samples that count; default, all."""
        return self.changed.error(self._residuals(row[None])[0], self.layout, most, keep)

    def part(self, keep: np.ndarray, more: np.ndarray | None = None) -> EffectFitter:
        """A search on the records where keep (L,) is true. more: (K, n) further factors of S there."""
        records = [r for r, k in zip(self.records, keep, strict=True) if k]
        columns = keep[self.layout.record]
        factors = self.factors[:, columns]
        factors = factors if more is None else np.concatenate([factors, more])
        return EffectFitter(self.plant, records, ResidualLayout(records), whitening(factors, self.d[columns]))

    def loss(self, row: np.ndarray) -> float:
        """Twice the negative log likelihood of all records, of one parameter row."""
        return self.part(self.everything).loss(row)

    def slopes(self, c: Candidate) -> np.ndarray:
        """(K, m) what a typical size of each parameter of a candidate does to the residual, about its values."""
        _, high, size = bounds(self.plant)
        rows = np.tile(c.row, (1 + len(c.places), 1))
        for row, place in zip(rows[1:], c.places, strict=True):
            step = STEP * size[place]
            row[place] += step if row[place] + step <= high[place] else -step
        residuals = self._residuals(rows)
        moves = np.array([(row[p] - c.row[p]) / size[p] for row, p in zip(rows[1:], c.places, strict=True)])
        return (residuals[1:] - residuals[0]) / moves.reshape(-1, 1)

    def change(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(m,) what going from one parameter row to another does to the residual."""
        before, after = self._residuals(np.stack([start, end]))
        return after - before

    def gap(self, row) -> tuple[float, dict]:
        """The gap of a parameter row over all records and by channel, in units of the floor."""
        residual = self.layout.residuals(self.plant.predict(self.records, row))[0]
        return gap(residual, self.scale, self.layout), by_channel(residual, self.scale, self.layout)


def gap(residual: np.ndarray, scale: np.ndarray, layout) -> float:
    """Mean square in units of the floor; every record and channel counts alike."""
    return float(np.mean(list(by_channel(residual, scale, layout).values())))


def by_channel(residual: np.ndarray, scale: np.ndarray, layout) -> dict[str, float]:
    """The same for each channel: joint, position, heading, power."""
    ratio = (residual / scale) ** 2
    found: dict[str, list] = {}
    for b in layout.blocks:
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
    weights = np.random.default_rng(seed).dirichlet(np.ones(per_record.shape[1]), DRAWS)
    winners = np.argmin(weights @ per_record.T, 1)
    return np.bincount(winners, minlength=len(per_record)) / DRAWS
