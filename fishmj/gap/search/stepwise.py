"""Forward stepwise selection of effects, with swaps and backward pruning, on cross-validated likelihood.

screen      the whole catalogue on the few records with the largest excess
share       one kind of effect at many joints of a robot is one candidate (shared_effects.py)
refine      the best on all records, also with an earlier choice swapped for another
compare     the finalists by the likelihood linearised at each; for a robot in MJCF, whose laws are often nested, by the
            evidence, which penalises each parameter (`EffectFitter.evidence`)
accept      by the gain of the first on records predicted without their fold; a first effect also by the smaller of its gains
            on all records at once and on each fold given the others, which determine the shared constants
converge    values and covariance in turns
prune       effects that the others no longer need
restart     on a robot of many joints, from the best kind, if the first round took an effect of the whole robot

Every record is predicted from the others: k-fold cross-validation, a fit without each fold.

S_f   = S + J^T C J + b b^T,  C = (J^T S^-1 J + prior)^-1 of the others      includes their parameter uncertainty
b     = (r(theta) - r(theta_f) - J (theta - theta_f)) / max(1, cost(theta) - cost(theta_f) of the others)^1/2    nonlinear part
loss  = sum_f |z_f|^2 + log det S_f                                  twice the negative log likelihood of all records, held out
conditional_loss = sum_f loss(all) - loss(others), both at theta_f   each fold, constants as estimated from the others
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fishmj.effects.ambiguity import together
from fishmj.effects.effect import site_of
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.progress import Bar, Bars, silent_bar
from fishmj.gap.records import mass_properties
from fishmj.gap.records.records import Record
from fishmj.gap.search.drawn_effects import drawn_candidates, in_own_scatter
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, drop_effect, limiting, on_records, refine
from fishmj.gap.search.likelihood import Likelihood, costs, draws, over_floor, relinearise
from fishmj.gap.search.shared_effects import apart, kinds, least_needed, shared_candidates
from fishmj.gap.thresholds import Gates, thresholds
from fishmj.gap.verdict import round_text
from fishmj.gap.wording import title


# --------------------------------------------------------------------------------------------------------------- cross-validation
class CrossValidatedFit(NamedTuple):
    """A set of effects. near: the likelihood linearised at it. best: on all records. fits: without each fold."""

    near: Likelihood
    best: Candidate
    fits: tuple[Candidate, ...]

    def held_out(self, folds: np.ndarray) -> list[tuple[EffectFitter, Candidate]]:
        """Each fold (F, L) with the fit without it."""
        given = zip(folds, self.fits, self.uncertainty_factors(folds), strict=True)
        fitters = [(self.near.subset(f, more[:, f[self.near.layout.record]]), c) for f, c, more in given]
        return [(fitter, fitter.at(c.row, c.names, c.places)) for fitter, c in fitters]

    def uncertainty_factors(self, folds: np.ndarray) -> list[np.ndarray]:
        """For each fold (F, L), factors of S (K + 1, m): uncertainty of the parameters from the other folds."""
        jacobian = self.near.jacobian(self.best) if self.best.places else np.zeros((0, self.near.layout.size))
        given = zip(folds, self.fits, strict=True)
        return [parameter_uncertainty_factors(self.near, fold, fit, self.best, jacobian) for fold, fit in given]

    def loss(self, folds: np.ndarray) -> float:
        """Loss over all records, each predicted without its fold."""
        return self.loss_and_gap(folds)[0]

    def loss_and_gap(self, folds: np.ndarray) -> tuple[float, float]:
        """(loss, |z|^2 / m) over all records, each predicted without its fold."""
        parts = self.held_out(folds)
        gap = sum(c.cost for _, c in parts) / self.near.layout.size
        return sum(c.cost + fitter.whiten.logdet for fitter, c in parts), gap

    def conditional_loss(self, folds: np.ndarray) -> float:
        """Loss of the folds, each given the other records' estimate of the shared constants of the fish."""
        near = self.near
        out = 0.0
        for fold, fit, more in zip(folds, self.fits, self.uncertainty_factors(folds), strict=True):
            others = near.subset(~fold, more[:, ~fold[near.layout.record]])
            out += near.subset(more=more).loss(fit.row) - others.loss(fit.row)
        return out

    def over_floor(self, folds: np.ndarray) -> float:
        """Mean square of the residual over the floor, each fold (F, L) by the fit without it."""
        layout = self.near.layout
        predicted = self.near.model.predict(self.near.records, np.stack([fit.row for fit in self.fits]))
        whole = layout.residuals(predicted)
        mine = np.where(folds[:, layout.record], whole, 0.0).sum(0)
        return over_floor(mine, self.near.scale, layout)[0]


def converge(e: Likelihood, folds: np.ndarray, best: Candidate, fits: tuple[Candidate, ...]) -> CrossValidatedFit:
    """A candidate and its fits without each fold, in the likelihood linearised at it."""
    near, best = relinearise(e, best)
    return cross_validated(near, best, folds, fits)


def cross_validated(near: Likelihood, best: Candidate, folds: np.ndarray, begins=None) -> CrossValidatedFit:
    """A candidate with its fits without each fold. begins: their start points; default, the candidate."""
    begins = [best] * len(folds) if begins is None else begins
    return CrossValidatedFit(near, best, tuple(refine(near.subset(~f), c) for f, c in zip(folds, begins, strict=True)))


def parameter_uncertainty_factors(
    e: Likelihood, fold: np.ndarray, fit: Candidate, best: Candidate, jacobian: np.ndarray
) -> np.ndarray:
    """Factors (K + 1, m) about the fit without one fold (L,). jacobian: (K, m) of the parameters, per typical size.

    The last factor is the curvature: the nonlinear part of the difference to the fit of all records, over the number of standard
    deviations between both fits. It matters for a limit that only one record reaches: the others have no slope for it.
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
    """(F, L) bool: three folds of the records, or two of two records, the smallest first.

    Replicates of one excitation go into different folds, if possible.
    """
    rng = np.random.default_rng(seed)
    part = np.full(len(records), -1)
    names = np.array([r.excitation or r.name for r in records])
    count = min(thresholds().cross_validation.folds, len(records))
    for i in rng.permutation(len(records)):
        part[i] = min(range(count), key=lambda f: (np.sum((part == f) & (names == names[i])), np.sum(part == f)))
    folds = part == np.arange(count)[:, None]
    return folds[np.argsort(folds.sum(1), kind="stable")]


# ---------------------------------------------------------------------------------------------------------------------- selection
@dataclass(frozen=True)
class SelectionStep:
    """One round.

    ranked: candidates on all records, the tried one first, then by cost. fitted: the tried one with its fits; None if no
    candidate was worth comparing. gain: its reduction of the cross-validated loss or, if only that was enough, of the loss on all
    records at once or given the others. gap, over_floor: if accepted, (before, after) of records predicted without their fold;
    before is that of the present model, if smaller.
    """

    ranked: tuple[Candidate, ...]
    fitted: CrossValidatedFit | None
    gain: float
    accepted: bool
    gap: tuple[float, float] | None = None
    over_floor: tuple[float, float] | None = None
    asked: float = 0.0  # required gain, of the kind by which it was accepted or rejected

    def text(self) -> str:
        """The round in words."""
        return f"{title('+'.join(kinds(self.ranked[0].names)))}: {round_text(self.accepted, self.gain, self.over_floor)}"


@dataclass(frozen=True)
class Selection:
    """Result of the rounds. base: present model on all records. fitted: found effects. folds: (F, L) bool."""

    base: Candidate
    fitted: CrossValidatedFit
    folds: np.ndarray
    steps: tuple[SelectionStep, ...]
    start_logdet: float  # log det S of the present model, on all records

    @property
    def near(self) -> Likelihood:
        """Likelihood linearised at the found effects."""
        return self.fitted.near

    @property
    def best(self) -> Candidate:
        """Found candidate on all records."""
        return self.fitted.best

    def gain_share(self, name: str, otherwise: float) -> float:
        """Share of the total gain that came in the round that added an effect; `otherwise` if a swap added it."""
        gains = [(s.ranked[0].newest, s.gain) for s in self.steps if s.accepted]
        mine = [gain for newest, gain in gains if name in newest]
        return sum(mine) / sum(gain for _, gain in gains) if mine else otherwise


def forward_select(
    e: Likelihood, gates: Gates, folds: np.ndarray, say: Callable[[str], None], bars: Bars = silent_bar
) -> Selection:
    """Adds effects while they raise the cross-validated likelihood. say: prints each step.

    An effect missing at all joints makes each of them late, as a common delay does. So if the first round takes an effect of the
    whole robot, a second search starts from the best kind at many joints; the more likely result counts.
    """
    logged = set(e.layout.channel.tolist())
    pool = [x for x in e.model.active.effects if is_absent(e.model, x) and shows(x, logged)]
    whole = e.subset()
    base = whole.base()
    nothing = CrossValidatedFit(e, base, (base,) * len(folds))
    rounds = lambda label: bars(gates.max_effects + 1, label, "rounds", at_most=True)
    with rounds("search") as bar:
        selected, steps = add_effects(e, nothing, [], gates, folds, pool, say, bar)
    if steps and (kind := best_kind(nothing, steps[0], gates, folds)) and kind.fitted:
        say(f"a second search starts from {kind.text()}")
        with rounds("second search") as bar:
            other, others = add_effects(e, take(e, kind.fitted, gates, folds), [kind], gates, folds, pool, say, bar)
        more = max(len(other.best.names) - len(selected.best.names), 1)
        if selected.loss(folds) - other.loss(folds) > more * gates.gain:
            selected, steps = other, others
    selected = exchange_limiting_forms(e, folds, selected, pool, gates, say)
    return Selection(base, selected, folds, tuple(steps), whole.whiten.logdet)


def add_effects(
    e: Likelihood,
    selected: CrossValidatedFit,
    steps: list[SelectionStep],
    gates: Gates,
    folds: np.ndarray,
    pool: list,
    say: Callable[[str], None],
    bar: Bar,
) -> tuple[CrossValidatedFit, list[SelectionStep]]:
    """Runs rounds from `selected`, found in `steps`; returns (found effects, all steps)."""
    visited = set[frozenset]()
    # One kind at many joints counts once. A repeated set ends the search: swaps and pruning could otherwise cycle.
    counted = lambda: len(selected.best.names) - sum(s.ranked[0].added - 1 for s in steps if s.accepted)
    while counted() < gates.max_effects and frozenset(selected.best.names) not in visited:
        visited.add(frozenset(selected.best.names))
        remaining = [x for x in pool if x.name not in selected.best.names]
        gain_so_far = sum(s.gain for s in steps)
        report = lambda share: bar.update(len(steps) + share)
        step = propose(selected, folds, remaining, gates, gain_so_far, report)
        steps.append(step)
        say(step.text())
        if not step.accepted or step.fitted is None:
            break
        selected = take(e, step.fitted, gates, folds)
        if counted() > 2 and selected.near.form >= thresholds().model_error.form_grid[-1]:
            break  # with a form error of a half after three effects, the cause is not in the catalogue
    return selected, steps


def take(e: Likelihood, fitted: CrossValidatedFit, gates: Gates, folds: np.ndarray) -> CrossValidatedFit:
    """The effects of an accepted step, fully fitted and pruned."""
    return prune(e, folds, converge(e, folds, fitted.best, fitted.fits), gates)


def best_kind(known: CrossValidatedFit, first: SelectionStep, gates: Gates, folds: np.ndarray) -> SelectionStep | None:
    """Round with the best kind at many joints if `first` took an effect of the whole robot; else None."""
    kind = next((c for c in first.ranked if c.added > 1), None)
    if kind is None or not first.accepted or any(map(site_of, first.ranked[0].newest)):
        return None
    near, best = relinearise(known.near.origin, kind, 1)
    fitted = cross_validated(near, best, folds)
    (before, gap_before), (after, gap) = known.loss_and_gap(folds), fitted.loss_and_gap(folds)
    asked = required_gain(gates, known, 0.0, True, best.added)
    if before - after <= asked:
        return None
    moved = known.near.over_floor(known.near.model.null)[0], fitted.over_floor(folds)
    ranked = (replace(best, cost=kind.cost), *(c for c in first.ranked if c is not kind))
    return SelectionStep(ranked, fitted, before - after, True, (gap_before, gap), moved, asked)


def propose(
    known: CrossValidatedFit,
    folds: np.ndarray,
    effects,
    gates: Gates,
    gain_so_far: float,
    report: Callable[[float], None] = lambda share: None,
) -> SelectionStep:
    """Best set with one more effect than `known`, or with an earlier choice swapped, and the decision on it.

    report: is called with the finished share of the round.
    """
    limits = thresholds().stepwise
    whole = known.near.subset()
    base = on_records(whole, known.best)
    required = required_gain(gates, known, gain_so_far, uncontested=True)
    short, alone = shortlist(known.near, base, effects, gates)
    report(0.4)

    # An effect without enough gain on the fitted records has even less on held-out ones: skip the costly part.
    best_in_sample = base.cost - short[0].cost
    beyond = GainOverModelError(known, gates) if known.near.calibrated and known.best.names else None
    if max((base.cost - c.cost) / c.added for c in short) < limits.screen_fraction * required and not (
        beyond and beyond.likely(short[: gates.finalists])
    ):
        return SelectionStep(tuple(short[: gates.finalists]), None, 0.0, False)

    # |z|^2 compares only candidates with one covariance. Each finalist gets its own, so the likelihood decides among them.
    finalists = []
    for i, c in enumerate(short[: gates.finalists]):
        if base.cost - c.cost > limits.finalist_fraction * best_in_sample:
            finalists.append(relinearise(known.near.origin, c, 1))
        report(0.4 + 0.3 * (i + 1) / gates.finalists)
    judged = lambda fit, c: fit.evidence(c) if isinstance(fit.model, RigidRobot) else c.cost + fit.whiten.logdet
    loss = [judged(near.subset(), best) for near, best in finalists]
    order = np.argsort(loss)

    # Further finalists are cross-validated too: an imitation may be likelier on all records but fail on held-out ones.
    before, gap_before = known.loss_and_gap(folds)
    tried: list[tuple[int, CrossValidatedFit, float, float]] = []
    for i in order[: limits.attempts]:
        near, best = finalists[i]
        fitted = cross_validated(near, best, folds)
        after, gap = fitted.loss_and_gap(folds)
        tried.append((i, fitted, before - after, gap))
        report(0.7 + 0.3 * len(tried) / limits.attempts)
        if tried[-1][2] > required_gain(gates, known, gain_so_far, True, best.added):
            break
    else:
        tried = tried[:1]
    first, fitted, gain, gap = tried[-1]

    lead = lead_of(first, finalists, loss)
    asked = required_gain(gates, known, gain_so_far, lead > limits.uncontested_lead * gain, fitted.best.added)
    accepted = gain > asked
    if not accepted and not known.best.names:
        # One fold does not determine the constants of this fish, so a small gap common to all records may vanish in each fold.
        # The gain is measured on all records and on each fold given the others; the smaller one counts.
        near, best = finalists[first]
        every = whole.loss(known.best.row) - near.loss(best.row)
        joint = min(every, known.conditional_loss(folds) - fitted.conditional_loss(folds))
        if joint > gates.min_joint_gain:
            accepted, gain, asked = True, joint, gates.min_joint_gain
    if not accepted and beyond:
        accepted = beyond.gain(fitted, folds) > beyond.required
    ranked = [replace(finalists[i][1], cost=loss[i]) for i in (first, *(j for j in order if j != first))]
    ranked += [replace(c, cost=judged(whole, c)) for c in alone if c.newest[0] not in fitted.best.names]
    if not accepted:
        return SelectionStep(tuple(ranked), fitted, gain, False, asked=asked)
    near, moved = known.near, fitted.over_floor(folds)
    as_it_is = min(near.over_floor(near.model.null)[0], known.over_floor(folds))
    return SelectionStep(tuple(ranked), fitted, gain, True, (gap_before, gap), (as_it_is, moved), asked)


def required_gain(gates: Gates, known: CrossValidatedFit, gain_so_far: float, uncontested: bool, added: int = 1) -> float:
    """Required gain of a round. uncontested: True if no other candidate is near the best. added: number of added effects."""
    if not known.best.names:
        return added * gates.gain
    # A wrong formula leaves a residual in proportion to its gain, which looks like a further effect: hence a share of the
    # gain so far.
    share = gates.uncontested_discount if uncontested else 1.0
    by_samples = gates.gain + share * gates.min_gain_per_sample * known.near.layout.size
    return max(added * by_samples, gates.min_gain_fraction * gain_so_far)


class GainOverModelError:
    """Gain of a further effect beyond that which errors of the known formulas can imitate.

    A wrong formula leaves a residual in proportion to its gain, hence the share of the gain so far in `required_gain`.
    But that would require of an effect on the joints a share of a current's gain on the path. The likelihood of a calibrated
    model knows where each formula acts, and is used instead.
    """

    def __init__(self, known: CrossValidatedFit, gates: Gates):
        near, imitated = known.near.tolerating(known.best.row, gates)
        whole = near.subset()
        self.known = CrossValidatedFit(near, refine(whole, on_records(whole, known.best)), known.fits)
        self.required = gates.gain + gates.min_gain_per_sample * near.layout.size + imitated

    def likely(self, short: list[Candidate]) -> bool:
        """Returns True if one of these gains enough on the fitted records."""
        whole = self.known.near.subset()
        best = min(c.cost for c in whole.refine([on_records(whole, c) for c in short], 2))
        return self.known.best.cost - best > self.required

    def gain(self, fitted: CrossValidatedFit, folds: np.ndarray) -> float:
        """Reduction of the cross-validated loss by a larger set."""
        near = self.known.near
        best = refine(near.subset(), on_records(near.subset(), fitted.best))
        without = cross_validated(near, self.known.best, folds, self.known.fits)
        return without.loss(folds) - cross_validated(near, best, folds, fitted.fits).loss(folds)


def lead_of(first: int, finalists, loss: list[float]) -> float:
    """Lead in likelihood of a finalist over the next one that is not the same effect by construction."""
    newest = [best.names[-1] for _, best in finalists]
    others = (loss[j] for j in range(len(loss)) if j != first and not together(newest[first], newest[j]))
    return min(others, default=np.inf) - loss[first]


# ------------------------------------------------------------------------------------------------------------------ candidates
def shortlist(e: Likelihood, base: Candidate, effects, gates: Gates) -> tuple[list[Candidate], list[Candidate]]:
    """(best candidates, fitted on all records; best single effects at each joint if a kind at many is a candidate)."""
    whole = e.subset()
    most = informative_records(base, e.layout, getattr(e.model, "screened_records", None))
    few = e.subset(most)
    one = e.subset(informative_records(base, e.layout, 1))
    # For a robot in MJCF the grid costs hundreds of rollouts, and finds nothing at a mean square near 1.
    loud = base.cost > thresholds().stepwise.drawn_from * e.layout.size
    quick = [x for x in effects if all(p.shape for p in x.parameters if p.fine)]
    fine = one.grid_search(on_records(one, base), effects if loud or not hasattr(e.model, "scatter") else quick)
    screened = few.screen(on_records(few, base), effects, fine)
    shared, alone = shared_candidates(whole, base, on_records(few, base), screened, gates)
    likely = sorted((on_records(whole, c) for c in screened[: 2 * gates.shortlist]), key=lambda c: c.cost)[: gates.shortlist]
    led = bool(shared) and shared[0].cost < likely[0].cost  # a kind at many joints leads, so single effects need no refined value
    short = likely[: gates.shortlist // 2] if led else whole.refine(whole.refine(likely, 2)[: gates.shortlist // 2], 3)
    if loud:
        drawn = [x for x in draws(e.model) if x in effects]
        best = (min(drawn_candidates(e, most, on_records(few, base), x), key=lambda c: c.cost) for x in drawn)
        newest = {c.names[-1]: c for c in (in_own_scatter(e, c) for c in best)}
        short = sorted([*(c for c in short if c.names[-1] not in newest), *newest.values()], key=lambda c: c.cost)
    if base.names and not led:
        short = sorted([*short, *swaps(whole, few, short, effects, gates, fine)], key=lambda c: c.cost)[: gates.shortlist]
    return sorted([*short, *shared], key=lambda c: c.cost), alone


def informative_records(c: Candidate, layout, most: int | None = None) -> np.ndarray:
    """(L,) bool: the records with the largest excess."""
    excess = costs(c.z, layout) - np.bincount(layout.record, minlength=len(layout.records))
    keep = np.zeros(len(layout.records), bool)
    keep[np.argsort(-excess)[: thresholds().stepwise.informative_records if most is None else most]] = True
    return keep


def swaps(whole: EffectFitter, few: EffectFitter, short: list[Candidate], effects, gates: Gates, fine: dict) -> list[Candidate]:
    """The best new sets with an earlier effect replaced by another: the earlier choice may have stood in for a pair."""
    out = []
    last = short[0]
    for old in (name for name in last.names[:-1] if not apart(whole.model, name, last.names[-1])):
        free = [x for x in effects if x.name not in last.names and not apart(whole.model, old, x.name)]
        tried = few.screen(on_records(few, drop_effect(whole, last, old)), free, fine)[: gates.finalists]
        out += whole.refine([on_records(whole, c) for c in tried], 3)
    return [c for c in out if set(c.names) not in [set(s.names) for s in short]]


def is_absent(model, effect) -> bool:
    """Returns True if the searched model does not have the effect yet."""
    places = [model.index(effect.name, p.name) for p in effect.parameters]
    return tuple(model.null[places]) == effect.null


def shows(effect, logged: set[str]) -> bool:
    """Returns True if an effect acts on one of the logged channels; fitted without them it would only imitate another effect."""
    weighed = effect.stage == "inertia" and mass_properties.CHANNEL in logged
    return weighed or not effect.shows or bool(logged & set(effect.shows))


# --------------------------------------------------------------------------------------------------------------------- pruning
def prune(e: Likelihood, folds: np.ndarray, fitted: CrossValidatedFit, gates: Gates) -> CrossValidatedFit:
    """The set without effects that the others no longer need, such as one that imitated a later one."""
    while len(fitted.best.names) > 1:
        least = least_needed(fitted.near.subset(), fitted.best, gates.gain)
        if not least:
            break
        shorter = [without_effect(e, folds, fitted, name) for name in least]
        increase = [loss_increase(fitted, less, folds) for less in shorter]
        first = min(range(len(increase)), key=increase.__getitem__)
        if increase[first] > gates.gain:
            break
        fitted = shorter[first]
    return fitted


def without_effect(e: Likelihood, folds: np.ndarray, fitted: CrossValidatedFit, name: str) -> CrossValidatedFit:
    """The set without one effect, refitted."""
    near = fitted.near
    fits = tuple(drop_effect(near.subset(~f), c, name) for f, c in zip(folds, fitted.fits, strict=True))
    return converge(e, folds, drop_effect(near.subset(), fitted.best, name), fits)


def exchange_limiting_forms(
    e: Likelihood, folds: np.ndarray, fitted: CrossValidatedFit, pool, gates: Gates, say: Callable[[str], None]
) -> CrossValidatedFit:
    """The set with each effect on a bound replaced by another effect, if the loss rises by less than the required gain.

    On a bound an effect is a limiting form of another law. pool: effects that may be added.
    """
    tried: list[str] = []
    while left := [name for name in limiting(e.model, fitted.best) if name not in tried]:
        tried += left[:1]
        others = [x for x in pool if x.name not in (*fitted.best.names, *tried)]
        if not others:
            break
        found = propose(without_effect(e, folds, fitted, left[0]), folds, others, gates, 0.0).fitted
        if found is None:
            continue
        other = converge(e, folds, found.best, found.fits)
        lost = loss_increase(fitted, other, folds)
        if lost < gates.gain:
            fitted = other
            now = title("+".join(kinds(other.best.names)))
            say(f"{title(left[0])} has a value on its bound: {now} instead, at {lost:.3g} in twice the log likelihood")
    return fitted


def loss_increase(fitted: CrossValidatedFit, less: CrossValidatedFit, folds: np.ndarray) -> float:
    """Increase of the loss with the shorter set: the larger of that on all records at once and the cross-validated one."""
    without, with_it = (f.near.loss(f.best.row) for f in (less, fitted))
    return max(less.loss(folds) - fitted.loss(folds), without - with_it)
