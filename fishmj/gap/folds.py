"""Every record predicted by what the others say: three folds, a fit without each.

S_f   = S + J^T C J,  C = (J^T S^-1 J of the others + prior)^-1       what the others leave open of the parameters counts
loss  = sum_f |z_f|^2 + log det S_f                                   twice the negative log likelihood of all records, unseen
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.candidates import PRIOR, Candidate, Search
from fishmj.gap.evidence import Evidence
from fishmj.gap.records import Record

FOLDS = 3


class Fitted(NamedTuple):
    """A set of effects. near: the evidence around it. best: on all records. fits: without each fold."""

    near: Evidence
    best: Candidate
    fits: tuple[Candidate, ...]

    def unseen(self, folds: np.ndarray) -> list[tuple[Search, Candidate]]:
        """Each fold (F, L) with the fit that did not see it."""
        slopes = self.near.slopes(self.best) if self.best.places else np.zeros((0, self.near.layout.size))
        return [predicted(self.near, f, c, slopes) for f, c in zip(folds, self.fits, strict=True)]

    def loss(self, folds: np.ndarray) -> float:
        """Over all records, each unseen."""
        return sum(c.cost + search.whiten.logdet for search, c in self.unseen(folds))


def predicted(e: Evidence, fold: np.ndarray, fit: Candidate, slopes: np.ndarray) -> tuple[Search, Candidate]:
    """One fold (L,). slopes: (K, m) of the parameters, per typical size."""
    here = fold[e.layout.record]
    told = e.part(~fold).whiten(slopes[:, ~here])
    root = np.linalg.cholesky(told @ told.T + np.eye(len(slopes)) / PRIOR**2)
    search = e.part(fold, np.linalg.solve(root, slopes[:, here]))
    return search, search.at(fit.row, fit.names, fit.places)


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
