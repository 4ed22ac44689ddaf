"""Who else could it be? Each effect that was found against those that came close in its round, in the company of the others.

gain     what the effect takes off |z|^2 over all records, given the others
behind   (|z|^2 of the set with the rival in its place - |z|^2 of the set) / gain
p_best   share of Bayesian bootstrap draws over records in which it beats all of them
"""

from dataclasses import dataclass

import numpy as np

from fishmj.effects.ambiguity import containing
from fishmj.gap.search import likelihood
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, drop_effect, on_records
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import Gates, thresholds


@dataclass(frozen=True)
class Rival:
    """An effect that would do nearly as well."""

    name: str
    p_best: float
    behind: float


@dataclass(frozen=True)
class Support:
    """How firm one effect stands."""

    gain: float
    p_best: float
    rivals: tuple[Rival, ...]


def support_of_each(found: Selection, gates: Gates) -> dict[str, Support]:
    """Every effect of what was found."""
    whole = found.near.subset(found.near.everything)
    best = on_records(whole, found.best)
    rivals = [c for step in found.steps if step.accepted for c in step.ranked]
    return {name: support_of(whole, best, name, rivals, gates) for name in best.names}


def support_of(whole: EffectFitter, best: Candidate, name: str, ranked, gates: Gates) -> Support:
    """One effect against the finalists of all rounds.

    A set in which a parameter came to rest on a bound is no rival: it is a limiting form that mimics the best.
    """
    gain = max(drop_effect(whole, best, name).cost - best.cost, 1e-9)
    tried = (swap_effect(whole, best, name, c) for c in ranked if name not in c.names)
    others = list({frozenset(c.names): c for c in (*tried, *known_twins(whole, best, name)) if c is not None}.values())
    polished = whole.refine([best, *others], 2)
    ours = next(c for c in polished if c.names == best.names)
    free = [c for c in polished if c.names != best.names and not on_bound(whole.model, c)]
    share = likelihood.p_best(np.stack([likelihood.costs(c.z, whole.layout) for c in (ours, *free)]))
    rivals = []
    for c, p in zip(free, share[1:], strict=True):
        behind = (c.cost - ours.cost) / gain
        if behind < min(gates.margin, gates.rival_margin_abs / gain) or p > 1 - gates.p_best:
            rivals.append(Rival(c.names[-1], float(p), float(behind)))
    return Support(gain, float(share[0]), tuple(rivals))


def known_twins(whole: EffectFitter, best: Candidate, name: str) -> list[Candidate]:
    """`best` with the effect replaced by those that are known to look the same."""
    twins = {twin for kind in containing(name) for twin in kind.effects} - {*best.names, name}
    effects = [x for x in whole.model.active.effects if x.name in twins]
    return whole.screen(drop_effect(whole, best, name), effects) if effects else []


def swap_effect(whole: EffectFitter, best: Candidate, name: str, other: Candidate) -> Candidate | None:
    """`best` with the effect `name` at its null and the newest effect of `other` as it was there; None if it is there already."""
    newest = other.names[-1]
    if newest in best.names:
        return None
    effects = {x.name: x for x in whole.model.active.effects}
    places = lambda n: [whole.model.index(n, p.name) for p in effects[n].parameters]
    row = best.row.copy()
    row[places(name)] = whole.model.null[places(name)]
    row[places(newest)] = other.row[places(newest)]
    names = (*(n for n in best.names if n != name), newest)
    return whole.at(row, names, tuple(p for n in names for p in places(n)))


def on_bound(model, c: Candidate) -> bool:
    """Whether a parameter lies on a bound that is not its null."""
    low, high, size = bounds(model)
    tolerance = thresholds().decide.bound_tolerance
    near = lambda place, edge: edge != model.null[place] and abs(c.row[place] - edge) < tolerance * size[place]
    return any(near(place, low[place]) or near(place, high[place]) for place in c.places)
