"""A candidate where it belongs: in the evidence around itself, with its parameters at their best there."""

import numpy as np

from fishmj.gap.search.cross_validation import CrossValidated
from fishmj.gap.search.effect_fitter import Candidate, EffectFitter
from fishmj.gap.search.likelihood import Likelihood

SETTLE = 2  # times that the constants' tolerance is carried to where the effects have moved


def converge(e: Likelihood, folds: np.ndarray, best: Candidate, fits: tuple[Candidate, ...]) -> CrossValidated:
    """A candidate and its fits without each fold, in the evidence around it."""
    near, best = relinearise(e, best)
    return CrossValidated(near, best, tuple(refine(near.part(~f), c) for f, c in zip(folds, fits, strict=True)))


def relinearise(e: Likelihood, best: Candidate, times: int = SETTLE) -> tuple[Likelihood, Candidate]:
    """(Evidence around the candidate, it at its best there): what the constants may do depends on the effects.

    A step that makes the candidate less likely in the evidence around itself is not taken.
    """
    near = e.trusted(best.row)
    loss = near.loss(best.row)
    for _ in range(times):
        ahead = refine(near.part(e.everything), best)
        there = e.trusted(ahead.row)
        less = there.loss(ahead.row)
        if less > loss:
            break
        near, best, loss = there, ahead, less
    return near, on_records(near.part(e.everything), best)


def refine(search: EffectFitter, c: Candidate) -> Candidate:
    """The candidate with its parameters at their best there."""
    return search.refine([on_records(search, c)], 3)[0] if c.places else on_records(search, c)


def on_records(search: EffectFitter, c: Candidate) -> Candidate:
    """The same effects and parameters on another part of the records."""
    return search.at(c.row, c.names, c.places)


def drop_effect(search: EffectFitter, c: Candidate, name: str) -> Candidate:
    """The candidate with one effect at its null."""
    effect = next(x for x in search.plant.active.effects if x.name == name)
    gone = {search.plant.index(name, p.name) for p in effect.parameters}
    row = c.row.copy()
    row[list(gone)] = search.plant.null[list(gone)]
    return search.at(row, tuple(n for n in c.names if n != name), tuple(p for p in c.places if p not in gone))
