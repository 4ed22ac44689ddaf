"""Every record predicted by what the others say: k-fold cross-validation, a fit without each fold.

S_f   = S + J^T C J + b b^T,  C = (J^T S^-1 J + prior)^-1 of the others      what those leave open of the parameters counts
b     = (r(theta) - r(theta_f) - J (theta - theta_f)) / max(1, cost(theta) - cost(theta_f) of the others)^1/2    not linear
loss  = sum_f |z_f|^2 + log det S_f                                  twice the negative log likelihood of all records, held out
conditional_loss = sum_f loss(all) - loss(others), both at theta_f   each fold given what the others tell of the constants
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.records.records import Record
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, refine
from fishmj.gap.search.likelihood import Likelihood, gap, relinearise
from fishmj.gap.thresholds import thresholds


class CrossValidated(NamedTuple):
    """A set of effects. near: the likelihood linearised at it. best: on all records. fits: without each fold."""

    near: Likelihood
    best: Candidate
    fits: tuple[Candidate, ...]

    def held_out(self, folds: np.ndarray) -> list[tuple[EffectFitter, Candidate]]:
        """Each fold (F, L) with the fit that did not see it."""
        given = zip(folds, self.fits, self.uncertainty_factors(folds), strict=True)
        fitters = [(self.near.subset(f, more[:, f[self.near.layout.record]]), c) for f, c, more in given]
        return [(fitter, fitter.at(c.row, c.names, c.places)) for fitter, c in fitters]

    def uncertainty_factors(self, folds: np.ndarray) -> list[np.ndarray]:
        """For each fold (F, L) factors of S (K + 1, m): what the others leave open of the parameters."""
        jacobian = self.near.jacobian(self.best) if self.best.places else np.zeros((0, self.near.layout.size))
        given = zip(folds, self.fits, strict=True)
        return [parameter_uncertainty_factors(self.near, fold, fit, self.best, jacobian) for fold, fit in given]

    def loss(self, folds: np.ndarray) -> float:
        """Over all records, each held out."""
        return sum(c.cost + fitter.whiten.logdet for fitter, c in self.held_out(folds))

    def conditional_loss(self, folds: np.ndarray) -> float:
        """The same, given what the other records tell of the fish's constants, which all of them share."""
        near = self.near
        out = 0.0
        for fold, fit, more in zip(folds, self.fits, self.uncertainty_factors(folds), strict=True):
            others = near.subset(~fold, more[:, ~fold[near.layout.record]])
            out += near.subset(near.everything, more).loss(fit.row) - others.loss(fit.row)
        return out

    def gap(self, folds: np.ndarray) -> float:
        """The gap, in units of the floor, each fold (F, L) by the fit that did not see it."""
        layout = self.near.layout
        predicted = self.near.model.predict(self.near.records, np.stack([fit.row for fit in self.fits]))
        whole = layout.residuals(predicted)
        mine = np.where(folds[:, layout.record], whole, 0.0).sum(0)
        return gap(mine, self.near.scale, layout)


def converge(e: Likelihood, folds: np.ndarray, best: Candidate, fits: tuple[Candidate, ...]) -> CrossValidated:
    """A candidate and its fits without each fold, in the likelihood linearised at it."""
    near, best = relinearise(e, best)
    return CrossValidated(near, best, tuple(refine(near.subset(~f), c) for f, c in zip(folds, fits, strict=True)))


def parameter_uncertainty_factors(
    e: Likelihood, fold: np.ndarray, fit: Candidate, best: Candidate, jacobian: np.ndarray
) -> np.ndarray:
    """Factors (K + 1, m) about the fit without one fold (L,). jacobian: (K, m) of the parameters, per typical size.

    The last is the bend: on the way to where all records lead, what is not linear, over the standard deviations that the others
    put between. A limit that only one record reaches has no slope in the others, which leave it at its null.
    """
    others = e.subset(~fold)
    white = others.whiten(jacobian[:, ~fold[e.layout.record]])
    root = np.linalg.cholesky(white @ white.T + np.eye(len(jacobian)) / thresholds().fit.prior_sd ** 2)
    places = list(best.places)
    way = (best.row - fit.row)[places] / bounds(e.model)[2][places]
    distance = max(others.at(best.row).cost - others.at(fit.row).cost, 1.0)
    bend = e.change(fit.row, best.row) - way @ jacobian
    return np.concatenate([np.linalg.solve(root, jacobian), bend[None] / np.sqrt(distance)])


def split(records: list[Record], seed: int = 0) -> np.ndarray:
    """(F, L) bool: three parts of the records, two of two, the smallest first; replicates of one excitation in different ones,
    where that can be."""
    rng = np.random.default_rng(seed)
    part = np.full(len(records), -1)
    names = np.array([r.excitation or r.name for r in records])
    count = min(thresholds().cross_validation.folds, len(records))
    for i in rng.permutation(len(records)):
        part[i] = min(range(count), key=lambda f: (np.sum((part == f) & (names == names[i])), np.sum(part == f)))
    folds = part == np.arange(count)[:, None]
    return folds[np.argsort(folds.sum(1), kind="stable")]
