"""The rounds: effects are added while records that no parameter saw get better.

    null -> gap -> [ screen -> refine -> judge -> accept -> settle -> prune ] x at most 4 -> decide

Every record is predicted by parameters from the other folds (folds.py); candidates are ranked on all of them, each by the
likelihood in the evidence around itself. The thresholds were frozen before the benchmark was scored (gates.py).
"""

from dataclasses import dataclass

import numpy as np

from fishmj.gap.search.cross_validation import CrossValidated
from fishmj.gap.search.effect_fitter import Candidate
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.model_error import FORMS
from fishmj.gap.search.refit import converge, drop_effect
from fishmj.gap.search.stepwise_rounds import RoundProgress, SelectionStep, round_of
from fishmj.gap.thresholds import Gates
from fishmj.gap.watch import Bar


@dataclass(frozen=True)
class Selection:
    """What the rounds led to. base: the model as it is, on all records. fitted: what was found. folds: (F, L) bool."""

    base: Candidate
    fitted: CrossValidated
    folds: np.ndarray
    steps: tuple[SelectionStep, ...]
    start_logdet: float  # log det S of the model as it is, on all records

    @property
    def near(self) -> Likelihood:
        """Around what was found."""
        return self.fitted.near

    @property
    def best(self) -> Candidate:
        """On all records."""
        return self.fitted.best

    def share(self, name: str, otherwise: float) -> float:
        """Of what all rounds gained, the part of the round that added an effect; `otherwise` where it came by a swap."""
        gains = [(s.ranked[0].names[-1], s.gain) for s in self.steps if s.accepted]
        mine = [gain for newest, gain in gains if newest == name]
        return sum(mine) / sum(gain for _, gain in gains) if mine else otherwise


def find(e: Likelihood, gates: Gates, folds: np.ndarray, effects=None, progress=None, bar: Bar | None = None) -> Selection:
    """Add effects while records that no parameter saw get better. bar: of rounds, in parts."""
    effects = [x for x in effects or e.plant.active.effects if absent(e.plant, x)]
    whole = e.part(e.everything)
    base = whole.base()
    fitted = CrossValidated(e, base, (base,) * len(folds))
    steps: list[SelectionStep] = []
    seen: set[frozenset] = set()
    while len(fitted.best.names) < gates.most and frozenset(fitted.best.names) not in seen:
        seen.add(frozenset(fitted.best.names))
        free = [x for x in effects if x.name not in fitted.best.names]
        step = round_of(fitted, folds, free, gates, sum(s.gain for s in steps), RoundProgress(bar, len(steps)))
        steps.append(step)
        if progress:
            progress(step)
        if not step.accepted or step.fitted is None:
            break
        fitted = pruned(e, folds, converge(e, folds, step.fitted.best, step.fitted.fits), gates)
        if len(fitted.best.names) > 2 and fitted.near.form >= FORMS[-1]:
            break  # what three effects do not describe to within a half is not in the catalogue
    return Selection(base, fitted, folds, tuple(steps), whole.whiten.logdet)


def pruned(e: Likelihood, folds: np.ndarray, fitted: CrossValidated, gates: Gates) -> CrossValidated:
    """The same without what the others no longer need: an effect that stood in for one that came later."""
    while len(fitted.best.names) > 1:
        tried = [(lost(fitted, less, folds), less) for less in (shorter(e, folds, fitted, n) for n in fitted.best.names)]
        least, less = min(tried, key=lambda t: t[0])
        if least > gates.gain:
            break
        fitted = less
    return fitted


def shorter(e: Likelihood, folds: np.ndarray, fitted: CrossValidated, name: str) -> CrossValidated:
    """The same without one effect, fitted anew."""
    near = fitted.near
    fits = tuple(drop_effect(near.part(~f), c, name) for f, c in zip(folds, fitted.fits, strict=True))
    return converge(e, folds, drop_effect(near.part(near.everything), fitted.best, name), fits)


def lost(fitted: CrossValidated, less: CrossValidated, folds: np.ndarray) -> float:
    """What the records lose with the shorter set: the larger of all at once, and each without its fold."""
    whole = [f.near.loss(f.best.row) for f in (less, fitted)]
    return max(less.loss(folds) - fitted.loss(folds), whole[0] - whole[1])


def absent(plant, effect) -> bool:
    """Whether the model that is questioned does not have the effect yet."""
    places = [plant.index(effect.name, p.name) for p in effect.parameters]
    return tuple(plant.null[places]) == effect.null
