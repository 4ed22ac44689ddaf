"""Every record predicted by what the others say: three folds, a fit without each.

S_f   = S + J^T C J + b b^T,  C = (J^T S^-1 J + prior)^-1 of the others      what those leave open of the parameters counts
b     = (r(theta) - r(theta_f) - J (theta - theta_f)) / max(1, cost(theta) - cost(theta_f) of the others)^1/2    not linear
loss  = sum_f |z_f|^2 + log det S_f                                   twice the negative log likelihood of all records, unseen
given = sum_f loss(all) - loss(others), both at theta_f               each fold given what the others tell of the constants
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.records.records import Record
from fishmj.gap.search.effect_fitter import PRIOR, Candidate, EffectFitter, bounds
from fishmj.gap.search.likelihood import Likelihood, gap

FOLDS = 3


class CrossValidated(NamedTuple):
    """A set of effects. near: the evidence around it. best: on all records. fits: without each fold."""

    near: Likelihood
    best: Candidate
    fits: tuple[Candidate, ...]

    def unseen(self, folds: np.ndarray) -> list[tuple[EffectFitter, Candidate]]:
        """Each fold (F, L) with the fit that did not see it."""
        given = zip(folds, self.fits, self.left_open(folds), strict=True)
        searches = [(self.near.part(f, more[:, f[self.near.layout.record]]), c) for f, c, more in given]
        return [(search, search.at(c.row, c.names, c.places)) for search, c in searches]

    def left_open(self, folds: np.ndarray) -> list[np.ndarray]:
        """For each fold (F, L) factors of S (K + 1, m): what the others leave open of the parameters."""
        slopes = self.near.slopes(self.best) if self.best.places else np.zeros((0, self.near.layout.size))
        return [parameter_uncertainty_factors(self.near, f, c, self.best, slopes) for f, c in zip(folds, self.fits, strict=True)]

    def loss(self, folds: np.ndarray) -> float:
        """Over all records, each unseen."""
        return sum(c.cost + search.whiten.logdet for search, c in self.unseen(folds))

    def given(self, folds: np.ndarray) -> float:
        """The same, given what the other records tell of the fish's constants, which all of them share."""
        near, out = self.near, 0.0
        for fold, fit, more in zip(folds, self.fits, self.left_open(folds), strict=True):
            others = near.part(~fold, more[:, ~fold[near.layout.record]])
            out += near.part(near.everything, more).loss(fit.row) - others.loss(fit.row)
        return out

    def gap(self, folds: np.ndarray) -> float:
        """The gap, in units of the floor, each fold (F, L) by the fit that did not see it."""
        layout = self.near.layout
        predicted = self.near.plant.predict(self.near.records, np.stack([fit.row for fit in self.fits]))
        whole = layout.residuals(predicted)
        mine = np.where(folds[:, layout.record], whole, 0.0).sum(0)
        return gap(mine, self.near.scale, layout)


def parameter_uncertainty_factors(
    e: Likelihood, fold: np.ndarray, fit: Candidate, best: Candidate, slopes: np.ndarray
) -> np.ndarray:
    """Factors (K + 1, m) about the fit without one fold (L,). slopes: (K, m) of the parameters, per typical size.

    The last is the bend: on the way to where all records lead, what is not linear, over the standard deviations that the others
    put between. A limit that only one record reaches has no slope in the others, which leave it at its null.
    """
    told = e.part(~fold)
    seen = told.whiten(slopes[:, ~fold[e.layout.record]])
    root = np.linalg.cholesky(seen @ seen.T + np.eye(len(slopes)) / PRIOR**2)
    places = list(best.places)
    way = (best.row - fit.row)[places] / bounds(e.plant)[2][places]
    far = max(told.at(best.row).cost - told.at(fit.row).cost, 1.0)
    bend = e.change(fit.row, best.row) - way @ slopes
    return np.concatenate([np.linalg.solve(root, slopes), bend[None] / np.sqrt(far)])


def split(records: list[Record], seed: int = 0) -> np.ndarray:
    """(F, L) bool: three parts of the records, two of two, the smallest first; replicates of one excitation in different ones,
    where that can be."""
    rng = np.random.default_rng(seed)
    part = np.full(len(records), -1)
    names = np.array([r.excitation or r.name for r in records])
    count = min(FOLDS, len(records))
    for i in rng.permutation(len(records)):
        part[i] = min(range(count), key=lambda f: (np.sum((part == f) & (names == names[i])), np.sum(part == f)))
    folds = part == np.arange(count)[:, None]
    return folds[np.argsort(folds.sum(1), kind="stable")]
