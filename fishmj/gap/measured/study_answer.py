"""From the rounds to an answer, and to a report with every figure behind it.

TOO_FEW_GROUPS  fewer than `LEAST_GROUPS` groups: no test over them is conclusive, and the findings are tentative
NOT_REPEATABLE  the baseline's error is no larger than 1.5 times the scatter of replicates
AGREES          the same for the sensors' noise
UNEXPLAINED     nothing is accepted; or, on records that no parameter saw, less than `CLOSURE` of the excess is gone, or more than
                `LEFT` times the floor is left
CLASS           a rival is as good, folds disagree, or a value is not believable
NAMED           else

A rival is ruled out only by both the bootstrap and the exact test over groups: the words follow the weaker of the two.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from fishmj.gap.decide.decide import sanity
from fishmj.gap.measured import significance
from fishmj.gap.measured.significance import LEAST_GROUPS, jackknife, smallest_p
from fishmj.gap.measured.study import SelectionRound, Study, StudyOutcome, investigate
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.search import likelihood
from fishmj.gap.verdict import NamedEffect, Value, Verdict
from fishmj.gap.wording import level, percent, sizes
from fishmj.log.replicates import RATIO

CLOSURE, P_BEST = 0.6, 0.9
CLOSE = 0.1  # of the gain: rivals that a reader should hear of
LEFT = 25.0  # mean square over the floor's: five times its root
TOO_FEW, EMPTY = "TOO_FEW_GROUPS", ("NOT_REPEATABLE", "AGREES")


def answer(study: Study, found: StudyOutcome) -> Verdict:
    """The verdict. Gaps are errors in units of the floor, on records kept aside, or on groups left out if there are none."""
    before, after = ends(study, found)
    accepted = [r for r in found.rounds if r.accepted]
    effects = tuple(named_effect(study, r, share(found, i)) for i, r in enumerate(accepted or found.rounds[:1]))
    rivals = tuple({"name": n, "p_best": p, "instead_of": r.fitted.names[-1]} for r in accepted for n, p in rivals_of(r))
    closed = likelihood.closure(before, after, study.floor)
    warnings = [w for r in accepted for w in doubts(study, r, effects)]
    said, reason = answer_and_reason(study, found, rivals, warnings)
    tests = {"p_useful": [r.useful for r in found.rounds], "p_exact": [r.p_exact for r in found.rounds]}
    return Verdict(
        said,
        effects=() if said in EMPTY else effects,
        rivals=() if said in EMPTY else rivals,
        gap_before=before / study.floor,
        gap_after=after / study.floor,
        gap_after_unseen=after / study.floor,
        explained=closed,
        reason=reason,
        warnings=tuple(dict.fromkeys(warnings)),
        gates={"closure": closed, **tests, "groups": len(study.groups), "smallest_p": smallest_p(len(study.groups))},
    )


def ends(study: Study, found: StudyOutcome) -> tuple[float, float]:
    """Mean square before and after: on records kept aside, or over the groups left out, each counting once."""
    if study.aside:
        return found.kept_aside[0], found.kept_aside[-1]
    before, after = found.unseen.mean(0)
    return float(before), float(after)


def where(study: Study) -> str:
    """Words for the records of `ends`."""
    return "on records kept aside" if study.aside else "on groups left out"


def answer_and_reason(study: Study, found: StudyOutcome, rivals, warnings) -> tuple[str, str]:
    """The answer and its reason."""
    before, after = ends(study, found)
    closed, n = likelihood.closure(before, after, study.floor), len(study.groups)
    if n < LEAST_GROUPS:
        why = f"{n} groups, at least {LEAST_GROUPS} are needed: the smallest possible p of {n} is {smallest_p(n):.2g}"
        return TOO_FEW, f"too few groups to decide: {why}; the listed terms are tentative"
    if before <= RATIO * study.floor:
        return ("NOT_REPEATABLE" if study.replicates else "AGREES"), f"the error is that of {study.floor_of}"
    if not any(r.accepted for r in found.rounds):
        return "UNEXPLAINED", "no candidate lowers the error on held-out groups; the best is tentative"
    if closed < CLOSURE:
        why = f"{closed:.0%} of the error above {study.floor_of} is explained {where(study)}; the names are tentative"
        return "UNEXPLAINED", why
    if after > LEFT * study.floor:
        why = f"{study.said(after)} remain, but {study.floor_of} is {study.said(study.floor)}; the names are tentative"
        return "UNEXPLAINED", why
    if rivals or any(w.startswith("folds") for w in warnings):
        return "CLASS", "these records cannot tell the listed effects apart"
    if warnings:
        return "CLASS", "one effect fits best, but its value is implausible: it may imitate something else"
    return "NAMED", f"the same effect wins in every fold, and over {n} held-out groups"


def share(found: StudyOutcome, i: int) -> float:
    """Share of the baseline's error on `learn` that round i took away."""
    if i + 1 >= len(found.learned):
        return 0.0
    return (found.learned[i] - found.learned[i + 1]) / found.learned[0]


def named_effect(study: Study, r: SelectionRound, closed: float) -> NamedEffect:
    """The effect of a round: value on all records, 90 % interval by the jackknife over the folds."""
    name = r.fitted.names[-1]
    effect = study.plant.active.effect(name)
    values = {}
    for p in effect.parameters:
        place = study.plant.index(name, p.name)
        value = float(r.fitted.row[place])
        low, high = jackknife(np.array([float(v[name][place]) for v in r.values]), value)
        values[p.name] = Value(value, p.unit, max(low, p.low), min(high, p.high))
    return NamedEffect(name, values, r.p_best[name], closed)


def rivals_of(r: SelectionRound) -> list[tuple[str, float]]:
    """Candidates that the bootstrap or the exact test over groups does not rule out."""
    unsure = r.p_best[r.fitted.names[-1]] < P_BEST
    few = len(r.groups) < LEAST_GROUPS  # the test could rule out nothing
    exact = {} if few else r.p_rival
    others = [(n, p) for n, p in r.p_best.items() if n != r.fitted.names[-1]]
    return sorted(
        [(n, p) for n, p in others if (unsure and p > 1 - P_BEST) or exact.get(n, 0.0) > 1 - P_BEST], key=lambda item: -item[1]
    )


def own_cost(r: SelectionRound) -> float:
    """Cost of the model before on groups left out, for the best candidate's comparison."""
    return float(r.cost[r.names.index(r.fitted.names[-1])].sum() / r.before.sum())


def doubts(study: Study, r: SelectionRound, effects: tuple[NamedEffect, ...]) -> list[str]:
    """Warnings about a round."""
    name = r.fitted.names[-1]
    asked: Any = SimpleNamespace(model=study.plant)
    out = list(sanity(asked, r.fitted, next(e for e in effects if e.name == name)))
    agree = r.best.count(name)
    if agree < len(r.best):
        others = ", ".join(sorted(set(r.best) - {name}))
        out.append(f"folds disagree: {name} is best by its own records in {agree} of {len(r.best)}, else {others}")
    edges = [c.name for i, c in enumerate(study.plant.constants) if not 0.11 < r.fitted.row[i] < 9.9]
    if edges:
        out.append(f"{name}: with it the baseline's {', '.join(edges)} lies on its bound")
    return out


def report(study: Study, found: StudyOutcome, verdict: Verdict) -> dict[str, Any]:
    """All figures, for JSON."""
    before, after = ends(study, found)
    return {
        "name": study.name,
        "origin": study.origin,
        "protocol": list(study.protocol),
        "notes": list(study.notes),
        "unit": study.unit or "mean square in the protocol's scale",
        "floor": study.figure(study.floor),
        "floor_of": study.floor_of,
        "records": {"learned": len(study.learn), "kept_aside": len(study.aside)},
        "error_learned": [study.figure(e) for e in found.learned],
        "error_kept_aside": [study.figure(e) for e in found.kept_aside],
        "each_kept_aside": {r.name: [study.figure(study.error([r], row)) for row in found.rows] for r in study.aside},
        "ratio": study.figure(after) / study.figure(before),
        "groups": list(study.groups),
        "left_out": left_out(study, found),
        "rounds": [round_row(r) for r in found.rounds],
        "verdict": verdict.plain(),
    }


def left_out(study: Study, found: StudyOutcome) -> dict[str, Any]:
    """The error of groups that were left out, before and after, with the ratio's 90 % interval over the groups."""
    before, after = found.unseen.T
    value, low, high = significance.ratio(before, after, bool(study.unit))
    each = {g: [study.figure(b), study.figure(a)] for g, b, a in zip(found.rounds[0].groups, before, after, strict=True)}
    better = int(np.sum(after < before))
    out: dict[str, Any] = {"each": each, "ratio": value, "low": low, "high": high, "better": better, "groups": len(before)}
    return out | {"smallest_p": smallest_p(len(before)), "folds": len(set(study.fold))}


def round_row(r: SelectionRound) -> dict[str, Any]:
    """One round: cost of every candidate on groups left out, relative to the model before it; p: that the best is better."""
    start = r.before.sum()
    order = np.argsort(r.cost.sum(1))
    table = [
        {
            "name": r.names[i],
            "cost": float(r.cost[i].sum() / start),
            "p_best": r.p_best[r.names[i]],
            "p": r.p_rival.get(r.names[i]),
        }
        for i in order
    ]
    out = {"found": r.fitted.names[-1], "accepted": r.accepted, "p_useful": r.useful, "p_exact": r.p_exact}
    return out | {"folds": list(r.best), "candidates": table}


def text(study: Study, found: StudyOutcome, verdict: Verdict) -> str:
    """The report in words."""
    lines = [f"{study.name} ({study.origin})", *(f"  {line}" for line in (*study.protocol, *study.notes[:5]))]
    lines += [f"  ... and {len(study.notes) - 5} more notes"] * (len(study.notes) > 5)
    for i, learned in enumerate(found.learned):
        what = "baseline" if i == 0 else f"+ {found.rounds[i - 1].fitted.names[-1]}"
        kept = ""
        if study.aside:
            ratio = study.figure(found.kept_aside[i]) / study.figure(found.kept_aside[0])
            kept = f", {study.said(found.kept_aside[i])} kept aside ({ratio:.2f} of the baseline)"
        lines.append(f"  {what}: error {study.said(learned)} learned{kept}")
    lines.append(f"  floor: {study.said(study.floor)}, {study.floor_of}")
    lines.append(f"  {unseen_text(study, found)}")
    for r in found.rounds:
        name = r.fitted.names[-1]
        state = "accepted" if r.accepted else "rejected"
        lines.append(
            f"  {name} {state}: best in {r.best.count(name)} of {len(r.best)} folds, P(useful) = {r.useful:.2f},"
            f" exact p = {r.p_exact:.2g} ({len(r.groups)} groups: {smallest_p(len(r.groups)):.2g} at least)"
        )
        others = [c for c in round_row(r)["candidates"] if c["name"] != name][:5]
        behind = ", ".join(f"{c['name']} {c['cost']:.2f} (p {c['p']:.2g})" for c in others)
        lines.append(f"    cost on groups left out, of the model before: {own_cost(r):.2f}; others: {behind}")
        close = [c["name"] for c in others if c["cost"] - own_cost(r) < CLOSE * (1.0 - own_cost(r))]
        if r.accepted and close:
            lines.append(f"    within {CLOSE:.0%} of its gain, though behind in the draws: {', '.join(close)}")
    return "\n".join([*lines, verdict_text(study, verdict)])


def unseen_text(study: Study, found: StudyOutcome) -> str:
    """Sentence on the groups left out: their error, and the limits of so few conditions."""
    u = left_out(study, found)
    if not any(r.accepted for r in found.rounds):
        return f"each of {u['groups']} groups predicted without it: nothing was taken into the model"
    return (
        f"each of {u['groups']} groups predicted by a fold without it: {u['ratio']:.2f} of the baseline's error"
        f" ({u['low']:.2f} to {u['high']:.2f}, 90 % over groups), better in {u['better']} of {u['groups']};"
        f" conditions outside these {u['groups']} were not tested"
    )


def verdict_text(study: Study, v: Verdict) -> str:
    """The verdict in words."""
    lines = [f"{v.answer}: {v.reason}"]
    doubt = "tentative: " if v.answer in ("UNEXPLAINED", TOO_FEW) else ""
    for e in v.effects:
        lines.append(f"  {doubt}{sizes(e.name, e.parameters)}")
        ranking = replace(v, effects=(e,)).ranking(e)
        if v.answer != TOO_FEW:
            lines.append(f"    P(best), largest first: {ranking}")
    now = f" -> {level(v.gap_after)}" if v.gap_after != v.gap_before else ""
    if now and v.gap_after < v.gap_before:
        lines.append(f"  explains {percent(v.explained)} of what lies above the floor, {where(study)}")
    lines.append(f"  gap {level(v.gap_before)}{now} {where(study)} (mean square in units of the floor, 1 = agreement)")
    return "\n".join([*lines, *(f"  warning: {w}" for w in v.warnings)])


def solved(
    study: Study, say=lambda text: None, most: int | None = None, bars: Bars = silent_bar
) -> tuple[str, dict[str, Any], Study, StudyOutcome, Verdict]:
    """Searches, decides and reports: the words, the figures, and their inputs."""
    found = investigate(study, most=most or study.rounds, say=say, bars=bars)
    study = study.settled(found.rows[-1])
    verdict = answer(study, found)
    return text(study, found, verdict), report(study, found, verdict), study, found, verdict
