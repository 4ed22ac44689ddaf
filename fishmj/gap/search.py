"""From records to an answer: the whole workflow on one page.

    null -> gap -> [ screen -> refine -> rank -> accept, swap ] x at most 4 -> decide

Parameters are fitted on two thirds of the records and accepted on the others; candidates are ranked on all of them. The
thresholds were frozen on one generator before the others were scored (`data/gap/gates.toml`).
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fishmj.gap import evidence
from fishmj.gap.candidates import Candidate, Search
from fishmj.gap.features import Layout
from fishmj.gap.null import leftover, whitening
from fishmj.gap.records import Record


@dataclass(frozen=True)
class Gates:
    """Thresholds.

    gain: held-out drop of |z|^2 below which nothing is added. adequacy: held-out |z|^2 / m that null runs do not reach.
    closure, p_best: as in evidence.py. margin: of the gain, between the best and the next.
    """

    gain: float = 40.0
    adequacy: float = 1.2
    closure: float = 0.6
    margin: float = 0.1
    p_best: float = 0.9
    most: int = 4
    shortlist: int = 12
    finalists: int = 5


class Evidence:
    """Records with their null, and searches on any part of them.

    null: (n, m) residuals of null runs on the layout of all records.
    """

    def __init__(self, plant, records: list[Record], null: np.ndarray):
        self.plant, self.records, self.null = plant, records, null
        self.layout = Layout(records)
        self.d = leftover(null, self.layout, self.layout.noise())
        self.scale = np.sqrt(np.mean(null**2, 0) + self.d**2)

    def part(self, keep: np.ndarray) -> Search:
        """A search on the records where keep (L,) is true."""
        records = [r for r, k in zip(self.records, keep, strict=True) if k]
        columns = keep[self.layout.record]
        return Search(self.plant, records, Layout(records), whitening(self.null[:, columns], self.d[columns]))

    def gap(self, row) -> tuple[float, dict]:
        """The gap of a parameter row over all records and by channel, in units of the floor."""
        residual = self.layout.measured() - self.layout.vectors(self.plant.predict(self.records, row))[0]
        return evidence.gap(residual, self.scale, self.layout), evidence.by_channel(residual, self.scale, self.layout)


@dataclass(frozen=True)
class Step:
    """One round of the search. ranked: candidates on all records, best first; fitted: the same without the held-out ones."""

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
    held_before: float  # |z|^2 held out
    held_after: float
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
    everything = np.ones(len(held), bool)
    fit, rest, whole = e.part(~held), e.part(held), e.part(everything)
    effects = e.plant.active.effects if effects is None else effects
    base, fitted = whole.base(), fit.base()
    best, before = base, _cost(rest, base.row)
    held_cost, steps = before, []
    while len(best.names) < gates.most:
        free = [x for x in effects if x.name not in best.names]
        step = round_of(fit, rest, whole, fitted, held_cost, free, gates)
        steps.append(step)
        if progress:
            progress(step)
        if not step.accepted:
            break
        best = step.ranked[0]
        fitted = step.fitted[best.names]
        held_cost = _cost(rest, fitted.row)
    return Found(base, best, fitted, tuple(steps), before, held_cost, rest.layout.size)


def round_of(fit: Search, rest: Search, whole: Search, base: Candidate, held: float, effects, gates: Gates) -> Step:
    """One round: candidates one effect larger than `base`, and where it pays, with an earlier choice swapped."""
    short = fit.refine(fit.screen(base, effects)[: gates.shortlist])
    if base.names:
        short = sorted([*short, *swaps(fit, short, effects, gates)], key=lambda c: c.cost)[: gates.shortlist]
    ranked = whole.refine([moved(whole, c) for c in short[: gates.finalists]], 3)
    fitted = {c.names: c for c in short}
    best = fitted[ranked[0].names]
    gain = held - _cost(rest, best.row)
    return Step(tuple(ranked), fitted, gain, gain > gates.gain)


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


def pairs(fit: Search, base: Candidate, singles: list[Candidate], gates: Gates) -> list[Candidate]:
    """All pairs of the finalists, polished together."""
    out = []
    for a, b in combinations(singles[: gates.finalists], 2):
        row = a.row.copy()
        row[list(b.places)] = b.row[list(b.places)]
        z = fit.z(row[None])[0]
        out.append(Candidate((*a.names, *b.names[len(base.names) :]), (*a.places, *b.places), row, float(z @ z), z))
    return fit.refine(out, 3)


def without(search: Search, c: Candidate, name: str) -> Candidate:
    """The candidate with one effect at its null."""
    effect = next(x for x in search.plant.active.effects if x.name == name)
    gone = {search.plant.index(name, p.name) for p in effect.parameters}
    row = c.row.copy()
    row[list(gone)] = search.plant.null[list(gone)]
    z = search.z(row[None])[0]
    names, places = tuple(n for n in c.names if n != name), tuple(p for p in c.places if p not in gone)
    return Candidate(names, places, row, float(z @ z), z)


def moved(search: Search, c: Candidate) -> Candidate:
    """The same effects and parameters on another part of the records."""
    z = search.z(c.row[None])[0]
    return replace(c, cost=float(z @ z), z=z)


def _cost(search: Search, row) -> float:
    z = search.z(np.asarray(row)[None])[0]
    return float(z @ z)
