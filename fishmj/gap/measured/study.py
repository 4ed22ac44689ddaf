"""Identifies the missing term by cross-validation over groups of records, such as conditions, gains or runs.

    per fold    baseline fitted -> screen -> refit with the constants -> cost on the groups left out
    accepted    P(the held-out cost falls by more than `USEFUL`) over Bayesian bootstrap draws of the groups; best in most folds;
                an exact test over the groups for each fold's choice by its own records, if there are enough groups
    named       the folds agree on the best effect; P(best) over the same draws; rivals by the exact test too; closure on records
                kept aside for the last figure, or on the held-out groups if there are none

Every candidate refits the constants of the baseline: a change that a constant can explain is no effect.

If no simulator exists for the robot, the scatter between records of one condition replaces the empirical null (`Scatter`):

    r_gi = b_g + e_gi                    residual of the baseline, group g (a condition, a gain), i within it
    S    = D + sum_g t^2 1_g 1_g^T       D = var e, t^2 = var b, both for each sensor's column: one-way analysis of variance
    z    = S^-1/2 r

A constant error of the model in one condition counts once, not once per row: S gives each group about its independent weight. It
gives no adequacy, since the scatter includes the missing effect; that needs replicates.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fishmj.gap import progress
from fishmj.gap.measured.significance import LEAST_GROUPS, LEVEL, exact_p
from fishmj.gap.null.whitening import Whitening, whitening
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.search import likelihood
from fishmj.gap.search.fit import Candidate, EffectFitter
from fishmj.gap.thresholds import thresholds

FIT, POLISH = 16, 6  # iterations
PRIOR = 0.5  # of a constant, for the tangents of the screen

USEFUL, SURE = 0.02, 0.95  # least relative fall of the held-out cost, and its probability


@dataclass(frozen=True)
class Study:
    """One measured set, ready for the search.

    learn, aside: records; `aside` is used for the last figure only. fold: (L,) fold of each record in `learn`.
    error(records, row): mean square over all measurements; printed as its root times `factor` in `unit`, or unchanged
    if `unit` is "". floor: the mean square below which nothing can be detected, and `floor_of` its origin; replicates: True if
    it is the scatter of repeats, else a sensor's noise. origin: measured or synthetic. rounds: most effects to add. floor_at:
    floor and its origin for a parameter row, if the floor depends on it.
    """

    name: str
    plant: Any
    learn: Sequence
    aside: Sequence
    fold: np.ndarray
    error: Callable[[Sequence, np.ndarray], float]
    floor: float
    floor_of: str
    protocol: tuple[str, ...]
    unit: str = ""
    factor: float = 1.0
    notes: tuple[str, ...] = ()
    ahead: int = 8  # candidates that a fold refits
    replicates: bool = True
    origin: str = "measured"
    rounds: int = 2
    floor_at: Callable[[np.ndarray], tuple[float, str]] | None = None

    def settled(self, row: np.ndarray) -> "Study":
        """Study with the floor of a parameter row, since the effect of noise at a start depends on the model."""
        if self.floor_at is None:
            return self
        floor, of = self.floor_at(row)
        return replace(self, floor=floor, floor_of=of)

    @property
    def groups(self) -> list[str]:
        """Names of the groups of the search."""
        return sorted({r.group for r in self.learn})

    def figure(self, square: float) -> float:
        """A mean square in the protocol's form."""
        return self.factor * float(np.sqrt(square)) if self.unit else float(square)

    def said(self, square: float) -> str:
        """Text of a mean square in the protocol's form, with its unit."""
        return f"{self.figure(square):.4g} {self.unit}".strip()


@dataclass(frozen=True)
class SelectionRound:
    """Round of the search. names: candidates; cost (C, G): on groups left out; best: per fold, by its records; fitted: on all.

    groups: (G,) sorted. errors: (G, 2) of the study on each group left out, for the model before and the fold's choice by its
    own records, which exclude the group. p_exact: one-sided exact test on the cost of those choices. p_rival: the same test of
    the best against each other candidate.
    """

    names: tuple[str, ...]
    cost: np.ndarray
    before: np.ndarray  # (G,)
    best: tuple[str, ...]
    values: tuple[dict, ...]  # per fold, candidate name -> row
    fitted: Candidate
    useful: float
    p_best: dict[str, float]
    accepted: bool
    groups: tuple[str, ...]
    errors: np.ndarray
    p_exact: float
    p_rival: dict[str, float]


@dataclass(frozen=True)
class StudyOutcome:
    """Result of the rounds, with the error on the records kept aside before and after each."""

    base: Candidate
    rounds: tuple[SelectionRound, ...]
    learned: tuple[float, ...]  # error on `learn`: baseline, after each accepted round
    kept_aside: tuple[float, ...]

    @property
    def rows(self) -> list[np.ndarray]:
        """Parameter rows of the baseline and of each accepted round."""
        return [self.base.row, *(r.fitted.row for r in self.rounds if r.accepted)]

    @property
    def unseen(self) -> np.ndarray:
        """Error (G, 2) on each group left out, of the baseline and of the accepted model as chosen by the folds."""
        accepted = [r for r in self.rounds if r.accepted]
        first, last = self.rounds[0].errors, (accepted or self.rounds)[-1].errors
        return np.stack([first[:, 0], last[:, 1] if accepted else first[:, 0]], 1)


class Fold:
    """Search on some records, whitened by the residual scatter of the baseline fitted to them."""

    def __init__(self, study: Study, records: Sequence, start: Candidate | None = None):
        self.study, self.records = study, list(records)
        self.layout = ResidualLayout(self.records)
        self.groups = [r.group for r in self.records]
        plain = whitening(np.zeros((0, self.layout.size)), self.layout.noise())
        first = EffectFitter(study.plant, self.records, self.layout, plain)
        bare = Candidate((), tuple(range(len(study.plant.constants))), study.plant.null, 0.0, np.zeros(0))
        self.base = first.refine([scored(first, start or bare)], FIT)[0]
        self.trust(self.base.row, FIT)

    def ranked(self, effects, count: int) -> list[Candidate]:
        """Best `count` candidates with one effect more than the baseline, fitted with all constants."""
        tangents = self._tangents()
        whiten = self.scatter.whiten(self.layout, self.groups, tangents)
        rough = EffectFitter(self.study.plant, self.records, self.layout, whiten)
        found = self.refit(rough.screen(scored(rough, self.base), effects)[:count])
        self.trust(found[0].row)
        return self.refit(found)

    def trust(self, row: np.ndarray, iterations: int = POLISH) -> None:
        """Uses the residual scatter of this row; the baseline's scatter contains the missing effect and would hide it."""
        residual = self.layout.residuals(self.study.plant.predict(self.records, row))[0]
        self.scatter = Scatter(self.layout, self.groups, residual)
        self.search = EffectFitter(self.study.plant, self.records, self.layout, self.scatter.whiten(self.layout, self.groups))
        self.base = self.search.refine([scored(self.search, self.base)], iterations)[0]

    def refit(self, candidates: list[Candidate]) -> list[Candidate]:
        """Fits the same effects to these records."""
        return self.search.refine([scored(self.search, c) for c in candidates], POLISH) if candidates else []

    def costs(self, left_out: Sequence, rows: np.ndarray) -> dict[str, np.ndarray]:
        """|z|^2 of the records left out: {group: (R,)}."""
        layout, groups = ResidualLayout(list(left_out)), [r.group for r in left_out]
        z = EffectFitter(self.study.plant, list(left_out), layout, self.scatter.whiten(layout, groups)).z(rows)
        each = likelihood.costs(z, layout)
        return {g: each[:, [i for i, h in enumerate(groups) if h == g]].sum(1) for g in sorted(set(groups))}

    def _tangents(self) -> np.ndarray:
        """Change (C, m) of the residual by PRIOR in each fitted parameter."""
        rows = np.tile(self.base.row, (1 + len(self.base.places), 1))
        for i, place in enumerate(self.base.places):
            rows[1 + i, place] += 0.05 * max(abs(rows[0, place]), 0.1)
        residuals = self.layout.residuals(self.study.plant.predict(self.records, rows))
        return (residuals[1:] - residuals[0]) * (PRIOR / 0.05)


def scored(search: EffectFitter, c: Candidate) -> Candidate:
    """Candidate with its cost under this search."""
    z = search.z(c.row[None])[0]
    return Candidate(c.names, c.places, c.row, float(z @ z), z)


def investigate(
    study: Study, *, most: int = 2, has=(), say=lambda text: None, bars: progress.Bars = progress.silent_bar
) -> StudyOutcome:
    """Adds effects while the error on held-out groups falls. has: names of effects already in the model."""
    steps = 2 + len(set(study.fold))  # fits of a round; the baseline counts as one
    with bars(most * steps, study.name, "fits") as bar:
        base = current = extended(study, has)
        rounds: list[SelectionRound] = []
        learned, aside_errors = [study.error(study.learn, base.row)], [study.error(study.aside, base.row)] if study.aside else []
        aside = f", {study.said(aside_errors[0])} on the {len(study.aside)} kept aside" if aside_errors else ""
        say(f"baseline: error {study.said(learned[0])} on {len(study.learn)} records{aside}")
        while len(rounds) < most:
            done = len(rounds) * steps
            step = one_round(study, current, lambda k, done=done: bar.update(done + 1 + k))
            rounds.append(step)
            found = step.fitted.names[-1]
            verdict = "accepted" if step.accepted else "not accepted"
            say(
                f"{found}: best in {step.best.count(found)} of {len(step.best)} folds,"
                f" P(useful) = {step.useful:.2f}, P(best) = {step.p_best[found]:.2f},"
                f" exact p = {step.p_exact:.2g} over {len(step.groups)} groups, {verdict}"
            )
            if not step.accepted:
                break
            current = step.fitted
            learned.append(study.error(study.learn, current.row))
            aside_errors += [study.error(study.aside, current.row)] if study.aside else []
        bar.update(most * steps)
    return StudyOutcome(base, tuple(rounds), tuple(learned), tuple(aside_errors))


def extended(study: Study, has=()) -> Candidate:
    """Baseline with the effects `has`, all fitted to `learn`."""
    whole = Fold(study, study.learn)
    found = whole.base
    for name in has:
        found = whole.ranked([study.plant.active.effect(name)], 1)[0]
    return found


def one_round(study: Study, current: Candidate, done=lambda k: None) -> SelectionRound:
    """Runs all folds for candidates with one effect more than `current`. done: receives the number of finished fits."""
    effects = [e for e in study.plant.active.effects if e.name not in current.names]
    folds, own = [], []
    for k in sorted(set(study.fold)):
        fold = Fold(study, [r for r, f in zip(study.learn, study.fold, strict=True) if f != k], current)
        folds.append((fold, [r for r, f in zip(study.learn, study.fold, strict=True) if f == k]))
        own.append(fold.ranked(effects, study.ahead))
        done(len(folds))
    tried = {c.names[-1]: c for ranked in reversed(own) for c in reversed(ranked)}
    names = tuple(tried)
    before: dict[str, float] = {}
    after: dict[str, np.ndarray] = {}
    chosen_cost: dict[str, float] = {}
    errors: dict[str, tuple[float, float]] = {}
    values = []
    for (fold, left_out), ranked in zip(folds, own, strict=True):
        known = {c.names[-1]: c for c in ranked}
        known |= {c.names[-1]: c for c in fold.refit([restarted(tried[n], fold.base) for n in names if n not in known])}
        rows = np.array([fold.base.row, *(known[n].row for n in names)])
        pick = 1 + names.index(ranked[0].names[-1])
        for group, cost in fold.costs(left_out, rows).items():
            before[group], after[group], chosen_cost[group] = float(cost[0]), cost[1:], float(cost[pick])
            of_group = [r for r in left_out if r.group == group]
            errors[group] = (study.error(of_group, rows[0]), study.error(of_group, rows[pick]))
        values.append({n: known[n].row for n in names})
    groups = sorted(before)
    start, cost = np.array([before[g] for g in groups]), np.stack([after[g] for g in groups], 1)
    winner = names[int(np.argmin(cost.sum(1)))]
    weights = np.random.default_rng(0).dirichlet(np.ones(len(groups)), thresholds().likelihood.bootstrap_draws)
    gains = weights @ (start - cost[names.index(winner)]) > USEFUL * (weights @ start)
    share = dict(zip(names, map(float, likelihood.p_best(cost)), strict=True))
    everything = Fold(study, study.learn, current)
    everything.trust(everything.refit([tried[winner]])[0].row)
    fitted = everything.refit([tried[winner]])[0]
    best = tuple(ranked[0].names[-1] for ranked in own)
    sure_enough = float(np.mean(gains))
    p = exact_p((1.0 - USEFUL) * start, np.array([chosen_cost[g] for g in groups]))
    accepted = sure_enough >= SURE and 2 * best.count(winner) > len(best) and (p <= LEVEL or len(groups) < LEAST_GROUPS)
    winner_cost = cost[names.index(winner)]
    return SelectionRound(
        names,
        cost,
        start,
        best,
        tuple(values),
        fitted,
        sure_enough,
        share,
        accepted,
        tuple(groups),
        np.array([errors[g] for g in groups]),
        p,
        {n: exact_p(c, winner_cost) for n, c in zip(names, cost, strict=True) if n != winner},
    )


def restarted(c: Candidate, base: Candidate) -> Candidate:
    """Candidate of another fold with this fold's constants."""
    row = c.row.copy()
    row[list(base.places)] = base.row[list(base.places)]
    return Candidate(c.names, c.places, row, c.cost, c.z)


# -------------------------------------------------------------------------------------------------- scatter in place of null runs
LEAST = 1e-3  # of a column's rms: D never goes below


class Scatter:
    """Standard deviations within and between groups, from the residuals (m,) of a baseline. groups: (L,) of each record."""

    def __init__(self, layout: ResidualLayout, groups, residual: np.ndarray):
        self.within, self.between = {}, {}
        for key in {(b.sensor, b.column) for b in layout.blocks}:
            parts: dict[str, list] = {}
            for b in layout.blocks:
                if (b.sensor, b.column) == key:
                    parts.setdefault(groups[b.record], []).append(residual[b.where])
            values = [np.concatenate(p) for p in parts.values()]
            n = np.array([len(v) for v in values])
            whole = np.concatenate(values)
            if len(values) < 2 or not (n > 1).any():
                self.within[key], self.between[key] = float(np.sqrt(np.mean(whole**2))), 0.0
                continue
            within = sum(float(np.sum((v - v.mean()) ** 2)) for v in values) / max(int(np.sum(n - 1)), 1)
            means = np.array([v.mean() for v in values])
            least = (LEAST**2) * float(np.mean(whole**2))
            self.within[key] = float(np.sqrt(max(within, least)))
            self.between[key] = float(np.sqrt(max(float(np.mean(means**2)) - within * float(np.mean(1.0 / n)), 0.0)))

    def factors(self, layout: ResidualLayout, groups) -> tuple[np.ndarray, np.ndarray]:
        """(k, m) t 1_g of every group and column, and D^1/2 (m,)."""
        rows: dict[tuple, np.ndarray] = {}
        d = np.empty(layout.size)
        for b in layout.blocks:
            key = (b.sensor, b.column)
            d[b.where] = self.within[key]
            row = rows.setdefault((key, groups[b.record]), np.zeros(layout.size))
            row[b.where] = self.between[key]
        return np.array(list(rows.values())), d

    def whiten(self, layout: ResidualLayout, groups, tangents: np.ndarray | None = None) -> Whitening:
        """S^-1/2; `tangents` (c, m) are directions that a fit could change anyway and that have little weight."""
        factors, d = self.factors(layout, groups)
        return whitening(factors if tangents is None else np.concatenate([factors, tangents]), d)
