"""One round of the search: which effect would be added next, and do records that did not see it get better?

screen      the whole catalogue on the few records in which most is unexpected
refine      the best of them on all records
judge       the finalists by the likelihood in the evidence around themselves
accept      by what the first of them gains on records predicted without their fold; the first effect also by what it gains on
            all records at once and on each fold given the others, which tell of the constants that all share, the less of both
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fishmj.effects.ambiguity import together
from fishmj.gap.search import likelihood
from fishmj.gap.search.cross_validation import CrossValidated
from fishmj.gap.search.effect_fitter import Candidate, EffectFitter
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.refit import drop_effect, on_records, refine, relinearise
from fishmj.gap.thresholds import Gates
from fishmj.gap.watch import Bar

TELLING = 4  # records that a screen looks at
HOPE = 0.5  # of the gain that is asked for: a round whose best gains less where it was fitted ends there
FAR = 0.3  # of the best finalist's gain: one that gains less is not judged
CHANCES = 3  # finalists that may show what they gain unseen
LEAD = 0.5  # of the gain, by which the first is clear of all that are not its twins


@dataclass(frozen=True)
class SelectionStep:
    """One round.

    ranked: candidates on all records, the one that was tried first, then by cost. fitted: it with its fits; None when no
    candidate was worth judging. gain: what it takes off the loss of all records, each predicted without its fold; or,
    where only that was enough, on all at once or given the others. gap: where it is accepted, the gap of records that are
    predicted without their fold, before (of the model as it is, where that is smaller) and after; it decides nothing.
    """

    ranked: tuple[Candidate, ...]
    fitted: CrossValidated | None
    gain: float
    accepted: bool
    gap: tuple[float, float] | None = None


class RoundProgress(NamedTuple):
    """Where a round stands on a bar of rounds. before: rounds done."""

    bar: Bar | None = None
    before: int = 0

    def at(self, share: float) -> None:
        """Report the share of this round that is done."""
        if self.bar is not None:
            self.bar.update(self.before + share)


NO_BAR = RoundProgress()


def round_of(
    known: CrossValidated, folds: np.ndarray, effects, gates: Gates, gained: float, part: RoundProgress = NO_BAR
) -> SelectionStep:
    """Candidates one effect larger than `known`, and where it pays, with an earlier choice swapped. gained: in earlier rounds."""
    whole = known.near.part(known.near.everything)
    base = on_records(whole, known.best)
    short = shortlist(known.near, base, effects, gates)
    part.at(0.4)
    seen = base.cost - short[0].cost
    if seen < HOPE * required_gain(gates, known, gained, True):
        return SelectionStep(tuple(short[: gates.finalists]), None, 0.0, False)
    judged = []
    for i, c in enumerate(short[: gates.finalists]):
        judged += [relinearise(known.near.origin, c, 1)] if base.cost - c.cost > FAR * seen else []
        part.at(0.4 + 0.3 * (i + 1) / gates.finalists)
    loss = [near.loss(best.row) for near, best in judged]
    order = np.argsort(loss)
    before, tried = known.loss(folds), []
    for i in order[:CHANCES]:
        near, best = judged[i]
        fitted = CrossValidated(near, best, tuple(refine(near.part(~f), best) for f in folds))
        tried.append((i, fitted, before - fitted.loss(folds)))
        part.at(0.7 + 0.3 * len(tried) / CHANCES)
        if tried[-1][2] > required_gain(gates, known, gained, True):
            break
    else:
        tried = tried[:1]
    first, fitted, gain = tried[-1]
    newest = [best.names[-1] for _, best in judged]
    ahead = min((loss[j] for j in order if j != first and not together(newest[first], newest[j])), default=np.inf) - loss[first]
    ranked = [replace(judged[i][1], cost=loss[i]) for i in (first, *(j for j in order if j != first))]
    accepted = gain > required_gain(gates, known, gained, ahead > LEAD * gain)
    if not accepted and not known.best.names:
        joint = min(whole.loss(known.best.row) - loss[first], known.given(folds) - fitted.given(folds))
        accepted, gain = (True, joint) if joint > gates.joint else (False, gain)
    return SelectionStep(tuple(ranked), fitted, gain, accepted, gap_of(known, fitted, folds) if accepted else None)


def gap_of(known: CrossValidated, fitted: CrossValidated, folds: np.ndarray) -> tuple[float, float]:
    """What `SelectionStep.gap` holds."""
    as_it_is = known.near.gap(known.near.plant.null)[0]
    return min(as_it_is, known.gap(folds)), fitted.gap(folds)


def required_gain(gates: Gates, known: CrossValidated, gained: float, clear: bool) -> float:
    """Gain that a round must bring. clear: nothing else comes near its best."""
    if not known.best.names:
        return gates.gain
    share = gates.clear if clear else 1.0
    return max(gates.gain + share * gates.again * known.near.layout.size, min(gates.beside * gained, gates.enough))


def shortlist(e: Likelihood, base: Candidate, effects, gates: Gates) -> list[Candidate]:
    """The best candidates on all records, fitted; best first."""
    whole, few = e.part(e.everything), e.part(informative_records(base, e.layout))
    one = e.part(informative_records(base, e.layout, 1))
    fine = one.scan(on_records(one, base), effects)
    likely = few.screen(on_records(few, base), effects, fine)[: 2 * gates.shortlist]
    likely = sorted((on_records(whole, c) for c in likely), key=lambda c: c.cost)[: gates.shortlist]
    short = whole.refine(whole.refine(likely, 2)[: gates.shortlist // 2], 3)
    if not base.names:
        return short
    return sorted([*short, *swaps(whole, few, short, effects, gates, fine)], key=lambda c: c.cost)[: gates.shortlist]


def informative_records(c: Candidate, layout, most: int = TELLING) -> np.ndarray:
    """(L,) bool: the records in which most is unexpected."""
    excess = likelihood.costs(c.z, layout) - np.bincount(layout.record, minlength=len(layout.records))
    keep = np.zeros(len(layout.records), bool)
    keep[np.argsort(-excess)[:most]] = True
    return keep


def swaps(whole: EffectFitter, few: EffectFitter, short: list[Candidate], effects, gates: Gates, fine: dict) -> list[Candidate]:
    """The best new sets with an earlier effect replaced by another: what was taken first may have stood in for a pair."""
    out = []
    last = short[0]
    for old in last.names[:-1]:
        free = [x for x in effects if x.name not in last.names]
        tried = few.screen(on_records(few, drop_effect(whole, last, old)), free, fine)[: gates.finalists]
        out += whole.refine([on_records(whole, c) for c in tried], 3)
    return [c for c in out if set(c.names) not in [set(s.names) for s in short]]
