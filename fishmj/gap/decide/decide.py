"""Decides one of the five answers from the search's result, by ten gates.

    G1 adequacy     |z|^2 / m is larger than in any null run                    else AGREES
    G2 gain         drop of the held-out loss is larger than in any null run    else UNEXPLAINED
    G3 closure      most of the excess is explained, or little remains          else UNEXPLAINED, the best shown as tentative
    G4 residual     the rest is within the model error of the found effects,    else UNEXPLAINED, the best shown as tentative
                    or a small share of their gain (thresholds.py)
    G5 form         the formula's error is within that of right formulas        else UNEXPLAINED, the best shown as tentative
    G6 size         the size varies between records within its limit            else UNEXPLAINED, the best shown as tentative
    G7 transfer     at most a fifth of the held-out records gets worse          else UNEXPLAINED
    G8 uniqueness   no rival nearly as good, P(best) high                       else CLASS
    G9 sanity       no parameter on a bound, no implausible size, no truncated  else CLASS with a warning
                    series in a joint's angle
    G10 force       no free force explains more, held out (terms/stronger.py)   else UNEXPLAINED

G1 and G2 apply to a search that accepted no effect (search/stepwise.py), or a single one that chance explains. The others test
the accepted effects.

The form error is measured (search/model_error.py): the relative error of the effects' change that makes the records most likely.
A correct effect has an error of a few per cent; an imitation reaches the largest error that is tried. G5 and G6 leave out the
paths of as many records as G7 allows to get worse. G5 does not apply to an effect that needs an exact value
(`needs_exact_value`).

Rivals: each found effect is compared with those that came close in its round, the other found effects in place.

    gain     reduction of |z|^2 over all records by the effect, given the others
    behind   (|z|^2 of the set with the rival in its place - |z|^2 of the set) / gain
    p_best   share of Bayesian bootstrap draws over records in which it beats all of them

Secondary effects: the error of one effect's formula may look like another effect. Among several, an effect is not named if it

    has less than `min_gain_fraction` of the gain
    has less than `doubtful_gain` of it, and a rival or an implausible value
    has less than `confusable_gain`, and the catalogue lists it as confused with an effect of larger gain
    has less than that and is below `weak_size`, unless it alone gains the most that is required of any
    is below `implausible_size` and has less than `implausible_gain`
    is below `weak_size` and has less than that, and a larger effect is confused with it or acts on the same gears: the small dry
    friction of every gear train shows together with play, where nothing else holds the link
    gains no more than one of its stage does in a healthy robot of another water, unless all do (null/structural_error.py)

Such an effect does not prevent the large ones from being named. The thresholds are [secondary] in data/calib/gap.toml.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

import numpy as np

from fishmj.effects.ambiguity import SERIES, containing, series_at, together
from fishmj.effects.effect import Parameter, site_of
from fishmj.gap.decide.intervals import drawn_places, estimate
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.search import likelihood
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, drop_effect, limiting, on_records, refine
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.model_error import error_without_outliers, misformed
from fishmj.gap.search.shared_effects import apart, shares
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import Gates, residual_allowed, thresholds
from fishmj.gap.verdict import IMPLAUSIBLE, LIKELIHOOD, NamedEffect, Value, Verdict
from fishmj.gap.wording import number, percent, quantity, title


@dataclass(frozen=True)
class Rival:
    """An effect with nearly the same gain."""

    name: str
    p_best: float
    behind: float


@dataclass(frozen=True)
class Support:
    """Evidence for one effect."""

    gain: float
    p_best: float
    rivals: tuple[Rival, ...]


def decide(e: Likelihood, found: Selection, gates: Gates) -> Verdict:
    """The verdict with its gates."""
    before, by_channel = e.gap(found.base.row)
    checks: dict = {"adequacy": before, "gap_by_channel": by_channel}
    steps = tuple(step_table(s) for s in found.steps)
    plain: dict = dict(gap_before=before, gap_after=before, gap_allowed=gates.adequacy, gates=checks, steps=steps)
    first = found.steps[0] if found.steps else None
    if first is None or (not first.accepted and checks["adequacy"] <= gates.adequacy):
        return Verdict("AGREES", reason="the residual is within the scatter of healthy robots", **plain)
    if not first.accepted:
        tentative = named_effects(found, first.ranked[0], {}) if first.gain > 0 else ()
        gains = f"the best candidate gains {number(first.gain)} in twice the log likelihood of records not seen"
        why = f"there is a gap, but {gains}, less than {number(first.asked or gates.gain)}"
        return Verdict("UNEXPLAINED", effects=tentative, reason=why, **plain)
    stand = support_of_each(found, gates)
    effects = named_effects(found, found.best, stand)

    def dismissed(why: str) -> Verdict:
        """UNEXPLAINED verdict that keeps the found effects as tentative."""
        if checks["adequacy"] <= gates.adequacy:
            return Verdict("AGREES", reason=why, tentative=effects, **plain)
        return Verdict("UNEXPLAINED", effects=effects, reason=f"there is a gap, but {why}", **plain)

    # A fit to null runs, too, gives an effect some size. A single effect no larger is rejected unless its gain rules out chance.
    if within_null_scatter(e, effects) and max(first.gain, stand[effects[0].name].gain) < gates.certain_gain:
        return dismissed(f"{title(effects[0].name)} is no larger than chance may make it")
    doubts = {n.name: sanity(e, found.best, n, stand[n.name].gain < gates.certain_gain) for n in effects}
    dropped = negligible(found, effects, stand, doubts, gates)
    checks |= held_out_checks(e, found)
    # Healthy robots of another water leave a gap, too, and some effect of the catalogue always explains a part of it. This does
    # not apply to a robot with known healthy swims: their residual is subtracted already.
    usual = as_in_healthy_robots(e, stand)
    if usual | dropped < set(stand):
        dropped |= usual
    elif usual and e.drawn and checks["closure"] < gates.closure:
        most = max(usual, key=lambda name: stand[name].gain)
        why = f"{title(most)} gains {number(stand[most].gain)}, no more than it may on a healthy robot in another water"
        return dismissed(why)
    wrong, outliers = error_without_outliers(found.near, found.best.row, checks["gain"], gates)
    checks |= {"form": wrong.form, "strain": wrong.excess_log_likelihood, "size": wrong.gain_error_rms, "spared": outliers}
    # Doubts test how well the records agree about a size. The error of its formula in another water is common to all of them.
    valued = named_effects(found, found.best, stand, by_stage=True) if e.calibrated else effects
    kept = tuple(n for n in valued if n.name not in dropped)
    checks["pinned"] = needs_exact_value(e, found.best.names)
    rivals = tuple(asdict(r) | {"instead_of": n.name} for n in kept for r in stand[n.name].rivals)
    warnings = (*(w for n in kept for w in doubts[n.name]), *truncated_series(n.name for n in kept))
    whole: dict = dict(effects=kept, rivals=rivals, warnings=warnings, explained=checks["closure"])
    whole |= plain | dict(gap_after=found.near.gap(found.best.row)[0], tentative=tuple(n for n in effects if n.name in dropped))
    whole |= {"over_floor": {"searched": tuple(e.over_floor(c.row)[0] for c in (found.base, found.best))}}
    shrinks = Verdict("", **whole).shrinks
    answer, reason = _answer(checks, gates, kept, stand, rivals, warnings, shrinks)
    return Verdict(answer, reason=reason, **whole)


def truncated_series(names: Iterable[str]) -> tuple[str, ...]:
    """Doubts about torque offsets found beside the stiffness of their joint."""
    alike = "any torque over the joint's angle begins as a series: of a cable, a soft stop, a spring"
    pairs = ([title(f"{term}@{joint}") for term in SERIES] for joint in series_at(names))
    return tuple(f"{offset}: with {stiffness} it is how {alike}" for offset, stiffness in pairs)


def needs_exact_value(e: Likelihood, names) -> bool:
    """Returns True if each found effect must be within a fraction of a per cent of its value to explain anything.

    Such an effect imitates no other. Its form error does not count: a quantised command jumps between the right values, but at a
    different moment in each robot.
    """
    known = {x.name: x for x in e.model.active.effects}
    return bool(names) and all(any(p.fine for p in known[n].parameters) for n in names)


def _answer(
    checks: dict, gates: Gates, kept, stand: dict[str, Support], rivals, warnings, shrinks: bool = True
) -> tuple[str, str]:
    """(answer, reason) if effects were found. shrinks: True if they reduce the residual."""
    unseen = "does not lower the residual of records that it was not fitted to"
    claim = f"explains {percent(checks['closure'])} of {LIKELIHOOD}" if shrinks else unseen
    if checks["closure"] < gates.closure and checks["rest"] > (1.0 + gates.adequacy) / 2:
        return "UNEXPLAINED", f"the best effect of the catalogue {claim}; it is tentative"
    if checks["rest"] > residual_allowed(checks, gates):
        left = f"the rest is {number(checks['rest'])} times what the error of a formula allows"
        return "UNEXPLAINED", f"the best {claim}, {'but' if shrinks else 'and'} {left}; it is tentative"
    if misformed(checks):
        return "UNEXPLAINED", f"the best effect's formula would need an error of {percent(checks['form'])}; it is tentative"
    if checks["size"] > gates.size:
        resized = f"the size of the best effect would have to vary by {percent(checks['size'])} between records"
        return "UNEXPLAINED", f"{resized}; it is tentative"
    if checks["transfer"] < gates.transfer:
        return (
            "UNEXPLAINED",
            f"{percent(1 - checks['transfer'])} of held-out records get less likely; the best effect is tentative",
        )
    if rivals or any(stand[n.name].p_best < gates.p_best for n in kept):
        return "CLASS", "these records cannot tell apart what is listed"
    if warnings:
        return "CLASS", IMPLAUSIBLE
    if shrinks:
        return "NAMED", "explains records that it has not seen, and nothing else does"
    return "NAMED", "makes records that it has not seen likelier, not their residual smaller, and nothing else does"


def held_out_checks(e: Likelihood, found: Selection) -> dict[str, float]:
    """Gates on records predicted without their fold: gain, closure, residual (as `rest`, too), transfer."""
    after, residual = found.fitted.loss_and_gap(found.folds)
    before = sum(e.subset(f).loss(found.base.row) for f in found.folds)
    ideal = after + (1.0 - residual) * e.layout.size  # log det S, and |z|^2 of m
    closed = likelihood.closure(before - ideal, after - ideal, 0)
    gates = {"gain": before - after, "closure": closed, "rest": residual, "transfer": transfer(e, found)}
    return gates | {"residual": residual}  # verdict.json calls it `rest`


def transfer(e: Likelihood, found: Selection) -> float:
    """Share of the records that do not get less likely by more than chance and a small part of the common gain.

    Each is predicted by a fit without its fold, with the constants as estimated from the others, because a joint gain belongs to
    no single record.
    """
    limits = thresholds().decide
    rises, allowed = [], []
    record = e.layout.record
    near = found.near
    fitted = found.fitted
    base = e.loss(found.base.row)
    for fold, fit, more in zip(found.folds, fitted.fits, fitted.uncertainty_factors(found.folds), strict=True):
        whole = near.subset(more=more).loss(fit.row)
        for i in np.flatnonzero(fold):
            others = np.arange(len(e.records)) != i
            after = whole - near.subset(others, more[:, record != i]).loss(fit.row)
            rises.append(after - (base - e.subset(others).loss(found.base.row)))
            allowed.append(limits.transfer_sd * np.sqrt(2.0 * np.sum(record == i)))  # |z|^2 of n samples: variance 2 n
    rise = np.array(rises)
    return float(np.mean(rise < np.maximum(allowed, -limits.transfer_fraction * np.sum(rise))))


def named_effects(found: Selection, c: Candidate, stand: dict[str, Support], by_stage: bool = False) -> tuple[NamedEffect, ...]:
    """The effects of a candidate with values and intervals, and the closure of all together.

    by_stage: as for `intervals.estimate`.
    """
    e = found.near
    half = thresholds().intervals.quantile
    # Values are refitted with the constants as uncertain as the formulas. With that uncertainty in the selection, too, an effect
    # that a constant can imitate would never be found.
    uncertain = e.with_parameter_uncertainty(c.row)
    fitted = refine(uncertain.subset(), c)
    if sizes := drawn_places(e.model, c.names):  # slopes see the mean of random effects only; the search used all of them
        row = fitted.row.copy()
        row[sizes] = c.row[sizes]
        fitted = replace(fitted, row=row)
    value, spread = estimate(uncertain, fitted, by_stage)
    near = e.subset()
    base = found.base.cost + found.start_logdet
    ideal = near.whiten.logdet + e.layout.size
    closed = likelihood.closure(base - ideal, near.loss(c.row) - ideal, 0)
    out = []
    for name in c.names:
        effect = e.model.active.effect(name)
        values = {}
        for p in effect.parameters:
            k = c.places.index(e.model.index(name, p.name))
            edges = (float(np.clip(value[k] + side * half * spread[k], p.low, p.high)) for side in (-1, 1))
            values[p.name] = Value(float(value[k]), p.unit, *edges)
        share = stand[name].p_best if name in stand else 1.0
        out.append(NamedEffect(name, values, share, closed))
    return tuple(out)


def sanity(e: Likelihood, c: Candidate, n: NamedEffect, little: bool = True) -> tuple[str, ...]:
    """Warnings about the values of one effect. little: True if its gain is so small that any effect could have it."""
    limits = thresholds()
    size = bounds(e.model)[2]
    effect = e.model.active.effect(n.name)
    out = []
    for p in effect.parameters:
        place = e.model.index(n.name, p.name)
        if any(b != p.null and abs(c.row[place] - b) < limits.decide.bound_tolerance * size[place] for b in (p.low, p.high)):
            out.append(f"{title(n.name)}: {title(p.name)} = {quantity(c.row[place], p.unit)} lies on its bound")
    first, *others = size_parameters(effect)
    main = n.parameters[first.name]
    if smaller_than(e, n, limits.secondary.implausible_size):
        out.append(f"{title(n.name)} is far smaller than in any known robot: it may stand in for something else")
    if not others and poorly_determined(first, main):
        out.append(f"{title(n.name)}: the records disagree about its size by more than {percent(limits.secondary.size_scatter)}")
    if weight := negative_mass(e.model, n):
        out.append(f"{title(n.name)}: with it the added mass would be negative, {quantity(weight, main.unit)}")
    if little and others and insignificant((first, *others), n.parameters):
        out.append(f"{title(n.name)}: none of its values can be distinguished from zero")
    return tuple(out)


ADDED_MASS = {"surge_added_mass": 0, "sway_added_mass": 1, "yaw_added_mass": 2}


def negative_mass(model, n: NamedEffect) -> float:
    """Negative added mass of the robot with the effect, at the better end of its interval; 0 if it is not negative."""
    if n.name not in ADDED_MASS or not hasattr(model, "added_mass"):
        return 0.0
    (value,) = n.parameters.values()
    return min(float(model.added_mass()[ADDED_MASS[n.name]]) + value.high, 0.0)


def step_table(step) -> dict:
    """One round for the report: candidates with their costs."""
    best = step.ranked[0].cost
    table = [{"names": list(c.names), "behind": c.cost - best} for c in step.ranked]
    return {"gain": step.gain, "accepted": step.accepted, "gap_unseen": step.gap, "over_floor": step.over_floor, "ranked": table}


# ------------------------------------------------------------------------------------------------------------------------- rivals
def support_of_each(found: Selection, gates: Gates) -> dict[str, Support]:
    """Support of every found effect."""
    best = on_records(found.near.subset(), found.best)
    rivals = [c for step in found.steps if step.accepted for c in step.ranked]
    return {name: support_of(found.near, best, name, rivals, gates, near_in_likelihood(found, name)) for name in best.names}


def near_in_likelihood(found: Selection, name: str) -> set[str]:
    """Effects of a robot in MJCF whose likelihood was within chance of that of `name`, in the round that added it.

    |z|^2 in the covariance of the found effect is no fair test of another that changes the constants' tangents differently. Of
    two random effects, one must lead by the gain of an acceptance: lost and late packets look alike, and draws are few.
    """
    model, limits = found.near.model, thresholds().torques
    if not isinstance(model, RigidRobot):
        return set()
    rounds = [step.ranked for step in found.steps if step.accepted and name in step.ranked[0].newest]
    asked = {x.name: limits.gain for x in likelihood.draws(model)} if likelihood.draws(model, (name,)) else {}
    close = lambda n, c, best: c.cost - best.cost < asked.get(n, limits.lead) and not apart(model, n, name)
    return {n for ranked in rounds for c in ranked[1:] for n in c.newest if close(n, c, ranked[0])}


def support_of(
    e: Likelihood, best: Candidate, name: str, ranked, gates: Gates, near: set[str] | frozenset[str] = frozenset()
) -> Support:
    """Support of one effect against the finalists of all rounds. near: names of effects that are rivals in any case.

    A set with a parameter on a bound is no rival: it is a limiting form that mimics the best. With a random effect, each set has
    an S with its own scatter, and log det S counts.
    """
    whole, without = e.subset(), drop_effect(e.subset(), best, name)
    rivals_of = [(n, c) for c in ranked for n in c.newest if name not in c.names and not apart(whole.model, name, n)]
    tried = (swap_effect(whole, best, name, n, c) for n, c in rivals_of)
    others = list({frozenset(c.names): c for c in (*tried, *known_twins(whole, best, name)) if c is not None}.values())
    if likelihood.draws(whole.model, {n for c in (best, *others) for n in c.names}):
        fitters = [e.with_scatter(c.row).subset() for c in (best, *others)]
        polished = [f.refine([on_records(f, c)], 2)[0] for f, c in zip(fitters, (best, *others), strict=True)]
        each = [likelihood.losses(f, c.z) for f, c in zip(fitters, polished, strict=True)]
        none, ours_before = (e.with_scatter(c.row).loss(c.row) for c in (without, best))
        order = sorted(range(len(polished)), key=lambda i: float(each[i].sum()))
    else:
        polished = whole.refine([best, *others], 2)
        each = [likelihood.costs(c.z, whole.layout) for c in polished]
        none, ours_before, order = without.cost, best.cost, list(range(len(polished)))
    ours = next(i for i in order if polished[i].names == best.names)
    free = [i for i in order if polished[i].names != best.names and not limiting(whole.model, polished[i])]
    share = likelihood.p_best(np.stack([each[i] for i in (ours, *free)]))
    loss = [c.cost - float(np.sum(c.z**2)) + float(mine.sum()) for c, mine in zip(polished, each, strict=True)]
    gain = max(none - ours_before, 1e-9)
    rivals = []
    for i, p in zip(free, share[1:], strict=True):
        c, behind = polished[i], (loss[i] - loss[ours]) / gain
        close = behind < min(gates.margin, gates.rival_margin_abs / gain) or c.names[-1] in near
        if close or p > 1 - gates.p_best:
            rivals.append(Rival(c.names[-1], float(p), float(behind)))
    return Support(gain, float(share[0]), tuple(rivals))


def known_twins(whole: EffectFitter, best: Candidate, name: str) -> list[Candidate]:
    """Candidates: `best` with the effect replaced by each effect that is known to look the same."""
    twins = {twin for kind in containing(name) for twin in kind.effects} - {*best.names, name}
    effects = [x for x in whole.model.active.effects if x.name in twins]
    return whole.screen(drop_effect(whole, best, name), effects) if effects else []


def swap_effect(whole: EffectFitter, best: Candidate, name: str, newest: str, other: Candidate) -> Candidate | None:
    """`best` with the effect `name` at its null and one of `other` at its values; None if it is present already."""
    if newest in best.names:
        return None
    effects = {x.name: x for x in whole.model.active.effects}
    places = lambda n: [whole.model.index(n, p.name) for p in effects[n].parameters]
    row = best.row.copy()
    row[places(name)] = whole.model.null[places(name)]
    row[places(newest)] = other.row[places(newest)]
    names = (*(n for n in best.names if n != name), newest)
    return whole.at(row, names, tuple(p for n in names for p in places(n)))


def as_in_healthy_robots(e: Likelihood, stand: dict[str, Support]) -> set[str]:
    """Names of effects that gain no more than one of their stage may in a healthy robot of another water."""
    stages = {x.name: x.stage for x in e.model.active.effects}
    return {name for name, s in stand.items() if s.gain <= e.healthy_gain(stages[name])}


# -------------------------------------------------------------------------------------------------------------- secondary effects
def negligible(
    found: Selection, effects: tuple[NamedEffect, ...], stand: dict[str, Support], doubts: dict, gates: Gates
) -> set[str]:
    """Names of the negligible effects. doubts: {effect: warnings about its values}."""
    limits = thresholds().secondary
    e = found.near.origin
    gains = gains_beyond(found, gates) if e.calibrated else {n: s.gain for n, s in stand.items()}
    # With many joints, a gain is compared with those at the same joint plus the joint's share of gains of the whole robot.
    wide = lambda n, o: 1.0 / e.model.joints if shares(e.model) and site_of(n) and not site_of(o) else 1.0
    wholes = {n: sum(wide(n, o) * gain for o, gain in gains.items() if not apart(e.model, n, o)) for n in gains}
    share = {n: gain / wholes[n] for n, gain in gains.items()}
    # The gain when an effect was added counts, too: its final gain may be small if a later effect can imitate it.
    least = share if e.calibrated or shares(e.model) else {n: min(b, found.gain_share(n, b)) for n, b in share.items()}
    doubtful = {n for n, s in stand.items() if doubts[n] or may_be_another(n, s, gates)}
    implausible = {n.name for n in effects if smaller_than(e, n, limits.implausible_size)}
    weak = {n.name for n in effects if smaller_than(e, n, limits.weak_size)}
    little = {n for n in least if least[n] < limits.confusable_gain}
    confusable = {n for n in little for other in least if least[other] > least[n] and confused(e, n, other)}
    slight = {n for n in little if stand[n].gain < max(gates.certain_gain, gates.min_gain_fraction * wholes[n])}
    out = {n for n in least if least[n] < gates.min_gain_fraction}
    out |= {n for n in doubtful if share[n] < limits.doubtful_gain}
    out |= {n for n in implausible if share[n] < limits.implausible_gain}
    out |= confusable | (weak & slight)
    return out | {n for n in masked_by(e, set(least) - out, weak) if least[n] < limits.implausible_gain}


def gains_beyond(found: Selection, gates: Gates) -> dict[str, float]:
    """Gain of each effect beyond the possible gain of errors in the others' formulas."""
    out = {}
    for name in found.best.names:
        others = drop_effect(found.near.subset(), found.best, name)
        whole = found.near.tolerating(others.row, gates)[0].subset()
        best = on_records(whole, found.best)
        out[name] = max(drop_effect(whole, best, name).cost - best.cost, 1e-9)
    return out


def may_be_another(name: str, stand: Support, gates: Gates) -> bool:
    """Returns True if another effect may be the cause; effects that are the same by construction do not count."""
    twins = [r for r in stand.rivals if together(name, r.name)]
    return len(twins) < len(stand.rivals) or (not twins and stand.p_best < gates.p_best)


def confused(e: Likelihood, one: str, other: str) -> bool:
    """Returns True if the catalogue lists one of two effects as confused with the other."""
    known = {x.name: {c.other for c in x.confusions} for x in e.model.active.effects}
    return other in known[one] or one in known[other]


def masked_by(e: Likelihood, names, weak: set[str]) -> set[str]:
    """Effects of `weak` that a larger one of `names` masks, because it is confused with them or acts on the same gears.

    weak: effects much smaller than usual.
    """
    geared = {x.name for x in e.model.active.effects if x.gear is not None}
    return {n for n in weak for other in set(names) - weak if confused(e, n, other) or {n, other} <= geared}


def size_parameters(effect) -> list:
    """Parameters that set the size of an effect, like the first, not its shape."""
    return [p for p in effect.parameters if p.unit == effect.parameters[0].unit and not p.shape]


def smaller_than(e: Likelihood, n: NamedEffect, share: float) -> bool:
    """Returns True if every main value is less than `share` of the least typical one."""
    main = size_parameters(e.model.active.effect(n.name))
    return all(abs(n.parameters[p.name].value - p.null) < share * min(abs(t - p.null) for t in p.typical) for p in main)


def poorly_determined(p: Parameter, v: Value) -> bool:
    """Returns True if the sd of an effect's only size, over records and null runs, exceeds `size_scatter` of it."""
    limits = thresholds()
    return (v.high - v.low) / 2 / limits.intervals.quantile > limits.secondary.size_scatter * abs(v.value - p.null)


def insignificant(main, values: dict[str, Value]) -> bool:
    """Returns True if the intervals of all sizes of an effect contain their null value."""
    return all(values[p.name].low <= p.null <= values[p.name].high for p in main)


def within_null_scatter(e: Likelihood, effects) -> bool:
    """Returns True for a single found effect whose size null runs may give by chance, or that is far below any known size."""
    if len(effects) != 1:
        return False
    if smaller_than(e, effects[0], thresholds().secondary.implausible_size):
        return True
    main = size_parameters(e.model.active.effect(effects[0].name))
    values = effects[0].parameters
    return insignificant(main, values) if len(main) > 1 else poorly_determined(main[0], values[main[0].name])
