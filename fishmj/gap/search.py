"""From records to an answer: the whole workflow on one page.

    null -> gap -> [ screen -> refine -> judge -> accept -> settle -> prune ] x at most 4 -> decide

Parameters are fitted on two thirds of the records and accepted on the others; candidates are ranked on all of them, each by the
likelihood in the evidence around itself. The thresholds were frozen before the benchmark was scored (`data/calib/gap.toml`).
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from fishmj.calib import read_toml, resolve
from fishmj.gap import evidence
from fishmj.gap.candidates import Candidate, Search
from fishmj.gap.features import Layout
from fishmj.gap.null import leftover, smooth, whitening
from fishmj.gap.records import Record

DRAWS = 16  # of the constants, to see what is not linear in them
SETTLE = 2  # times that the constants' tolerance is carried to where the effects have moved
CHANCES = 3  # finalists that may show what they gain on held-out records


@dataclass(frozen=True)
class Gates:
    """Thresholds.

    adequacy: held-out |z|^2 / m that null runs do not reach. gain: held-out drop of |z|^2 below which nothing is added. A further
    effect must also take away `again` of the held-out |z|^2 and `beside` of the gain so far. closure, rest, transfer: gates of
    decide.py. margin: of the gain, between the best and the next; p_best: as in evidence.py. shortlist, finalists: candidates
    fitted, and ranked on all records.
    """

    adequacy: float
    gain: float
    again: float
    beside: float
    closure: float
    margin: float
    p_best: float
    rest: float
    transfer: float
    most: int
    shortlist: int
    finalists: int


class Evidence:
    """Records with their null, and searches on any part of them.

    null: (n, m) residuals of null runs on the layout of all records. form: relative error of an accepted effect's own signature,
    because no formula is the robot's.
    """

    def __init__(self, plant, records: list[Record], null: np.ndarray, form: float = 0.1):
        self.plant, self.records, self.form = plant, records, form
        self.layout = Layout(records)
        self._draws = np.random.default_rng(0).standard_normal((DRAWS, len(plant.constants)))
        tangents, self._bent = self._constants(plant.null)
        self.factors = np.concatenate([null / np.sqrt(len(null)), tangents])
        self.d = leftover(null, tangents, self.layout)
        self.scale = np.sqrt(np.mean(null**2, 0) + self.d**2)

    def _constants(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the constants' tolerance does to the residual of a parameter row: (C, m) tangents, (m,) mean square of what is
        not linear in them."""
        sigma = np.array([constant.sigma for constant in self.plant.constants])
        draws = np.concatenate([np.zeros((1, len(sigma))), np.eye(len(sigma)), self._draws])
        rows = np.tile(row, (len(draws), 1))
        rows[:, : len(sigma)] += draws * sigma
        residuals = np.nan_to_num(self.layout.residuals(self.plant.predict(self.records, rows)))
        moved = residuals[1:] - residuals[0]
        tangents = moved[: len(sigma)]
        bent = np.mean((moved[len(sigma) :] - self._draws @ tangents) ** 2, 0)
        return tangents, smooth(np.sqrt(bent), self.layout) ** 2

    def around(self, row: np.ndarray) -> "Evidence":
        """The same for a fish that has the effects of `row`, right to within `form` of what they change.

        D also grows by what is not linear in the constants: when a joint slips or a gear's play is taken up hangs on all of them,
        and no two fish do it at the same moments.
        """
        there = copy(self)
        tangents, bent = self._constants(row)
        there.factors = np.concatenate([self.factors[: -len(tangents)], tangents])
        ours, changed = self.layout.residuals(self.plant.predict(self.records, np.stack([self.plant.null, row])))
        form = smooth(self.form * np.nan_to_num(changed - ours), self.layout)
        there.d = np.sqrt(self.d**2 + np.maximum(bent - self._bent, 0.0) + form**2)
        return there

    def part(self, keep: np.ndarray) -> Search:
        """A search on the records where keep (L,) is true."""
        records = [r for r, k in zip(self.records, keep, strict=True) if k]
        columns = keep[self.layout.record]
        return Search(self.plant, records, Layout(records), whitening(self.factors[:, columns], self.d[columns]))

    def gap(self, row) -> tuple[float, dict]:
        """The gap of a parameter row over all records and by channel, in units of the floor."""
        residual = self.layout.residuals(self.plant.predict(self.records, row))[0]
        return evidence.gap(residual, self.scale, self.layout), evidence.by_channel(residual, self.scale, self.layout)


@dataclass(frozen=True)
class Step:
    """One round of the search.

    ranked: candidates on all records, the accepted one first, then by cost. fitted: the same without the held-out ones.
    """

    ranked: tuple[Candidate, ...]
    fitted: dict[tuple[str, ...], Candidate]
    gain: float  # of the best, held out
    accepted: bool


@dataclass(frozen=True)
class Found:
    """What the rounds led to."""

    base: Candidate  # the model as it is, on all records
    best: Candidate  # on all records
    best_fit: Candidate  # fitted without the held-out ones
    steps: tuple[Step, ...]
    near: Evidence  # around `best`, its effects trusted to within the form error
    start_logdet: float  # log det S of the model as it is, on all records
    held_before: float  # |z|^2 of the model as it is, held out
    held_size: int


def split(records: list[Record], seed: int = 0) -> np.ndarray:
    """(L,) bool: a third of the records held out; of replicates of one excitation never all, where that can be."""
    rng = np.random.default_rng(seed)
    held = np.zeros(len(records), bool)
    order = rng.permutation(len(records))
    names = [r.excitation or r.name for r in records]
    for i in order:
        if held.sum() >= max(1, len(records) // 3):
            break
        others = [j for j in range(len(records)) if names[j] == names[i] and j != i]
        if not others or not all(held[j] for j in others):
            held[i] = True
    return held


def find(e: Evidence, gates: Gates, held: np.ndarray, effects=None, progress=None) -> Found:
    """Add effects while records that no parameter saw get better."""
    effects = [x for x in effects or e.plant.active.effects if absent(e.plant, x)]
    rest, near = e.part(held), e
    whole = e.part(np.ones(len(held), bool))
    base = best = fitted = whole.base()
    steps, seen = [], set()
    while len(best.names) < gates.most and frozenset(best.names) not in seen:
        seen.add(frozenset(best.names))
        free = [x for x in effects if x.name not in best.names]
        step = round_of(e, near, held, fitted, free, gates, sum(s.gain for s in steps))
        steps.append(step)
        if progress:
            progress(step)
        if not step.accepted:
            break
        near, best, fitted = settled(e, held, step.ranked[0], step.fitted[step.ranked[0].names])
        near, best, fitted = pruned(e, held, near, best, fitted, gates)
    return Found(base, best, fitted, tuple(steps), near, whole.whiten.logdet, _cost(rest, base.row), rest.layout.size)


def settled(e: Evidence, held: np.ndarray, best: Candidate, fitted: Candidate, times: int = SETTLE):
    """(Evidence around the best candidate, it and the fit without the held-out records): what the constants may do depends on the
    effects. A step that makes the best candidate less likely in the evidence around itself is not taken."""
    everything = np.ones(len(held), bool)
    near = e.around(best.row)
    loss = near.part(everything).loss(best.row)
    for _ in range(times):
        ahead = polished(near.part(everything), best)
        there = e.around(ahead.row)
        less = there.part(everything).loss(ahead.row)
        if less > loss:
            break
        near, best, loss = there, ahead, less
    return near, moved(near.part(everything), best), polished(near.part(~held), fitted)


def polished(search: Search, c: Candidate) -> Candidate:
    """The candidate with its parameters at their best there."""
    return search.refine([moved(search, c)], 3)[0] if c.places else moved(search, c)


def pruned(e: Evidence, held: np.ndarray, near: Evidence, best: Candidate, fitted: Candidate, gates: Gates):
    """The same without what the others no longer need: an effect that stood in for one that came later."""
    everything = np.ones(len(held), bool)
    while len(best.names) > 1:
        tried = []
        for name in best.names:
            less = (without(near.part(everything), best, name), without(near.part(~held), fitted, name))
            there, whole, fit = settled(e, held, *less)
            unseen = there.part(held).loss(fit.row) - near.part(held).loss(fitted.row)
            seen = there.part(everything).loss(whole.row) - near.part(everything).loss(best.row)
            tried.append((max(unseen, seen), there, whole, fit))
        lost, *shorter = min(tried, key=lambda t: t[0])
        if lost > gates.gain:
            break
        near, best, fitted = shorter
    return near, best, fitted


def absent(plant, effect) -> bool:
    """Whether the model that is questioned does not have the effect yet."""
    places = [plant.index(effect.name, p.name) for p in effect.parameters]
    return tuple(plant.null[places]) == effect.null


def round_of(e: Evidence, known: Evidence, held: np.ndarray, base: Candidate, effects, gates: Gates, gained: float) -> Step:
    """One round: candidates one effect larger than `base`, and where it pays, with an earlier choice swapped.

    Each finalist is judged by the likelihood in the evidence around itself; `known` is the one around `base`.
    """
    fit, rest = known.part(~held), known.part(held)
    start = moved(fit, base)
    short = fit.refine(fit.screen(start, effects)[: gates.shortlist])
    if base.names:
        short = sorted([*short, *swaps(fit, short, effects, gates)], key=lambda c: c.cost)[: gates.shortlist]
    judged, everything = [], np.ones(len(held), bool)
    for c in short[: gates.finalists]:
        own, best, fitted = settled(e, held, c, c, 1)
        best = replace(best, cost=best.cost + own.part(everything).whiten.logdet)
        judged.append((best, fitted, rest.loss(base.row) - own.part(held).loss(fitted.row)))
    judged.sort(key=lambda j: j[0].cost)
    before = _cost(rest, base.row)
    enough = max(gates.gain + gates.again * before, gates.beside * gained) if base.names else gates.gain
    first = next((i for i, (_, _, gain) in enumerate(judged[:CHANCES]) if gain > enough), 0)
    judged = [judged[first], *judged[:first], *judged[first + 1 :]]
    gain = judged[0][2]
    return Step(tuple(best for best, _, _ in judged), {f.names: f for _, f, _ in judged}, gain, gain > enough)


def swaps(fit: Search, short: list[Candidate], effects, gates: Gates) -> list[Candidate]:
    """The best new sets with an earlier effect replaced by another: what was taken first may have stood in for a pair."""
    out = []
    last = short[0]
    for old in last.names[:-1]:
        kept = tuple(n for n in last.names if n != old)
        shrunk = without(fit, last, old)
        tried = fit.screen(shrunk, [x for x in effects if x.name not in kept])[: gates.finalists]
        out += fit.refine(tried, 3)
    return [c for c in out if set(c.names) not in [set(s.names) for s in short]]


def without(search: Search, c: Candidate, name: str) -> Candidate:
    """The candidate with one effect at its null."""
    effect = next(x for x in search.plant.active.effects if x.name == name)
    gone = {search.plant.index(name, p.name) for p in effect.parameters}
    row = c.row.copy()
    row[list(gone)] = search.plant.null[list(gone)]
    return search.at(row, tuple(n for n in c.names if n != name), tuple(p for p in c.places if p not in gone))


def moved(search: Search, c: Candidate) -> Candidate:
    """The same effects and parameters on another part of the records."""
    return search.at(c.row, c.names, c.places)


def _cost(search: Search, row) -> float:
    z = search.z(np.asarray(row)[None])[0]
    return float(z @ z)


def frozen() -> Gates:
    """The thresholds of `data/calib/gap.toml`, set on null runs and planted effects before any benchmark was scored."""
    return Gates(**read_toml(resolve("gap"))["gates"])
