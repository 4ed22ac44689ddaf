"""From the rounds to one of the five answers, and to a report with every figure behind it.

NOT_REPEATABLE  the baseline's error is no larger than 1.5 times what replicates differ by
UNEXPLAINED     nothing is accepted; or, on records kept aside, less than `CLOSURE` of the excess is gone, or more than `LEFT`
                times the floor is left
CLASS           a rival is as good, folds disagree, or a value is not believable
NAMED           else
"""

from types import SimpleNamespace
from typing import Any

import numpy as np

from fishmj.gap.decide.decide import sanity
from fishmj.gap.search import likelihood
from fishmj.gap.verdict import Named, Value, Verdict
from fishmj.log.replicates import RATIO
from fishmj.studies.measured_robots.study import Outcome, Round, Study, investigate

CLOSURE, P_BEST = 0.6, 0.9
CLOSE = 0.1  # of the gain: rivals that a reader should hear of
LEFT = 25.0  # mean square over the floor's: five times its root


def answer(study: Study, found: Outcome) -> Verdict:
    """The verdict. Gaps are errors on records kept aside, in units of the floor."""
    before, after = found.kept_aside[0], found.kept_aside[-1]
    accepted = [r for r in found.rounds if r.accepted]
    effects = tuple(named(study, r, share(found, i)) for i, r in enumerate(accepted or found.rounds[:1]))
    rivals = tuple({"name": n, "p_best": p} for r in accepted for n, p in rivals_of(r))
    closed = likelihood.closure(before, after, study.floor)
    warnings = [w for r in accepted for w in doubts(study, r, effects)]
    said, reason = decided(study, found, rivals, warnings)
    return Verdict(
        said,
        effects=() if said == "NOT_REPEATABLE" else effects,
        rivals=() if said == "NOT_REPEATABLE" else rivals,
        gap_before=before / study.floor,
        gap_after=after / study.floor,
        gap_after_unseen=after / study.floor,
        explained=closed,
        reason=reason,
        warnings=tuple(dict.fromkeys(warnings)),
        gates={"closure": closed, "p_useful": [r.useful for r in found.rounds]},
    )


def decided(study: Study, found: Outcome, rivals, warnings) -> tuple[str, str]:
    """The answer and its reason."""
    before, after = found.kept_aside[0], found.kept_aside[-1]
    closed = likelihood.closure(before, after, study.floor)
    if before <= RATIO * study.floor:
        return "NOT_REPEATABLE", f"the error is that of {study.floor_of}"
    if not any(r.accepted for r in found.rounds):
        return "UNEXPLAINED", "no candidate lowers the error on groups that were left out; the best is tentative"
    if closed < CLOSURE:
        why = f"{closed:.0%} of what lies above {study.floor_of} is gone on records kept aside; the names are tentative"
        return "UNEXPLAINED", why
    if after > LEFT * study.floor:
        why = f"{study.said(after)} are left where {study.floor_of} is {study.said(study.floor)}; the names are tentative"
        return "UNEXPLAINED", why
    if rivals or any(w.startswith("folds") for w in warnings):
        return "CLASS", "these records cannot tell the effects apart that are listed"
    if warnings:
        return "CLASS", "one effect fits best, but what it came out at is not believable: a stand-in"
    return "NAMED", "the same effect wins in every fold, and on conditions kept aside"


def share(found: Outcome, i: int) -> float:
    """Share of the baseline's error on `learn` that round i took away."""
    if i + 1 >= len(found.learned):
        return 0.0
    return (found.learned[i] - found.learned[i + 1]) / found.learned[0]


def named(study: Study, r: Round, closed: float) -> Named:
    """The effect of a round: value on all records, range over the folds."""
    name = r.fitted.names[-1]
    effect = next(e for e in study.plant.active.effects if e.name == name)
    values = {}
    for p in effect.parameters:
        place = study.plant.index(name, p.name)
        each = [float(v[name][place]) for v in r.values]
        values[p.name] = Value(float(r.fitted.row[place]), p.unit, min(each), max(each))
    return Named(name, values, r.p_best[name], closed)


def rivals_of(r: Round) -> list[tuple[str, float]]:
    """Candidates that the bootstrap does not rule out, when the best is not sure."""
    if r.p_best[r.fitted.names[-1]] >= P_BEST:
        return []
    others = [(n, p) for n, p in r.p_best.items() if n != r.fitted.names[-1] and p > 1 - P_BEST]
    return sorted(others, key=lambda item: -item[1])


def own_cost(r: Round) -> float:
    """Cost of the best on groups left out, of the model before."""
    return float(r.cost[r.names.index(r.fitted.names[-1])].sum() / r.before.sum())


def doubts(study: Study, r: Round, effects: tuple[Named, ...]) -> list[str]:
    """What a reader should know before believing a round."""
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


def report(study: Study, found: Outcome, verdict: Verdict) -> dict[str, Any]:
    """Every figure, for JSON."""
    return {
        "name": study.name,
        "origin": "measured",
        "protocol": list(study.protocol),
        "notes": list(study.notes),
        "unit": study.unit or "mean square in the protocol's scale",
        "floor": study.figure(study.floor),
        "floor_of": study.floor_of,
        "records": {"learned": len(study.learn), "kept_aside": len(study.aside)},
        "error_learned": [study.figure(e) for e in found.learned],
        "error_kept_aside": [study.figure(e) for e in found.kept_aside],
        "each_kept_aside": {r.name: [study.figure(study.error([r], row)) for row in found.rows] for r in study.aside},
        "ratio": study.figure(found.kept_aside[-1]) / study.figure(found.kept_aside[0]),
        "rounds": [described(r) for r in found.rounds],
        "verdict": verdict.plain(),
    }


def described(r: Round) -> dict[str, Any]:
    """One round: cost of every candidate on groups left out, relative to the model before it."""
    start = r.before.sum()
    order = np.argsort(r.cost.sum(1))
    table = [{"name": r.names[i], "cost": float(r.cost[i].sum() / start), "p_best": r.p_best[r.names[i]]} for i in order]
    return {"found": r.fitted.names[-1], "accepted": r.accepted, "p_useful": r.useful, "folds": list(r.best), "candidates": table}


def text(study: Study, found: Outcome, verdict: Verdict) -> str:
    """The report in words."""
    lines = [f"{study.name}", *(f"  {line}" for line in (*study.protocol, *study.notes))]
    for i, (learned, kept) in enumerate(zip(found.learned, found.kept_aside, strict=True)):
        what = "baseline" if i == 0 else f"+ {found.rounds[i - 1].fitted.names[-1]}"
        ratio = study.figure(kept) / study.figure(found.kept_aside[0])
        lines.append(
            f"  {what}: error {study.said(learned)} learned, {study.said(kept)} kept aside ({ratio:.2f} of the baseline)"
        )
    lines.append(f"  floor: {study.said(study.floor)}, {study.floor_of}")
    for r in found.rounds:
        name = r.fitted.names[-1]
        state = "accepted" if r.accepted else "rejected"
        lines.append(f"  {name} {state}: best in {r.best.count(name)} of {len(r.best)} folds, P(useful) = {r.useful:.2f}")
        others = [c for c in described(r)["candidates"] if c["name"] != name][:5]
        behind = ", ".join(f"{c['name']} {c['cost']:.2f}" for c in others)
        lines.append(f"    cost on groups left out, of the model before: {own_cost(r):.2f}; others: {behind}")
        close = [c["name"] for c in others if c["cost"] - own_cost(r) < CLOSE * (1.0 - own_cost(r))]
        lines += (
            [f"    within {CLOSE:.0%} of its gain, though behind in the draws: {', '.join(close)}"]
            if r.accepted and close
            else []
        )
    return "\n".join([*lines, verdict.text()])


def solved(study: Study, say=lambda text: None, most: int = 2) -> tuple[str, dict[str, Any]]:
    """Search, decide, report: the words and the figures."""
    found = investigate(study, most=most, say=say)
    verdict = answer(study, found)
    return text(study, found, verdict), report(study, found, verdict)
