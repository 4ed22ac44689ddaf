"""Which experiment would decide between the explanations that are left, in words; and those explanations, as hypotheses.

A hypothesis is one explanation with its fitted row and how far each parameter may be off. `to_plain` and `from_plain` carry it
through a report, so that a longer look later needs no data.
"""

from dataclasses import replace

import numpy as np

from fishmj.gap.decide.decide import swap_effect
from fishmj.gap.decide.intervals import estimate
from fishmj.gap.experiment.discrimination import (
    ExperimentScore,
    Hypothesis,
    experiment_scores,
    hinted_experiments,
    normalise_weights,
)
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records import mass_properties
from fishmj.gap.search.fit import Candidate
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.stepwise import Selection
from fishmj.gap.thresholds import thresholds
from fishmj.gap.verdict import Verdict
from fishmj.gap.watch import Bars, silent
from fishmj.gap.wording import title

ENOUGH = 5.0  # sigma from which an experiment is said to decide
LEFT = 3  # explanations compared, the best among them
WEIGH = "Weigh the robot, balance it on an edge and time it on two threads (measurements.toml beside the trials)"
OPEN = ("CLASS", "UNEXPLAINED")


def advised(e: Likelihood, found: Selection, verdict: Verdict, null: SimulatedNull, bars: Bars = silent) -> Verdict:
    """A CLASS verdict with the next experiment of a quick look, and its rivals' values, so that a longer look needs no data."""
    sides = normalise_weights(hypotheses_of(e, found, verdict))
    if verdict.answer not in OPEN or len(sides) < 2:
        return verdict
    quick = experiment_scores(e.model, sides, e.records[0], hinted_experiments(sides), null, bars=bars)
    known = {s.names: to_plain(e.model, s) for s in sides[1:]}
    listed = {names[-1]: values for names, values in known.items()}
    rivals = [r | {"values": listed[r["name"]]} if r["name"] in listed else r for r in verdict.rivals]
    return replace(verdict, rivals=tuple(rivals), next_experiment=advice(e.model, quick, sides))


def advice(model, found: list[ExperimentScore], sides: list[Hypothesis]) -> str:
    """The best experiment in words; where none of the library decides, a weighing that does, or else what to do."""
    from fishmj.effects.ambiguity import together

    best = next((p for p in found if p.sigma >= ENOUGH), None)
    if best:
        return best.text()
    rows = [np.concatenate([s.row[None], s.moves]) for s in sides]
    sigma, other = max((mass_properties.separation(model, rows[0], r), s.label) for r, s in zip(rows[1:], sides[1:], strict=True))
    if sigma >= ENOUGH:
        return f"{WEIGH}: expected separation {sigma:.0f} sigma; would decide between {title(sides[0].label)} and {title(other)}."
    most = max(found, key=lambda p: p.sigma)
    a, b = most.pair
    text = f"No experiment tried separates {title(a)} from {title(b)} by more than {most.sigma:.1f} sigma (`{most.excitation}`)"
    same = next((c for x in sides[0].names for y in sides[1].names if (c := together(x, y))), None)
    return f"{text}: {same.splits}." if same else f"{text}; repeat it, or measure what tells them apart directly."


def hypotheses_of(e: Likelihood, found: Selection, verdict: Verdict) -> list[Hypothesis]:
    """What is left: the best, then each listed rival in its place; where none is listed, the next of the last round."""
    if not found.steps:
        return []
    near = found.near
    whole = near.subset(near.everything)
    accepted = [s for s in found.steps if s.accepted]
    sets: list[Candidate] = [found.best] if accepted else [found.steps[0].ranked[0]]
    for rival in verdict.rivals[: LEFT - 1]:
        rounds = [s for s in accepted if s.ranked[0].names[-1] == rival["instead_of"]] or accepted
        like = next((c for s in rounds for c in s.ranked if c.names[-1] == rival["name"]), None)
        other = swap_effect(whole, found.best, rival["instead_of"], like) if like else None
        sets += [other] if other else []
    if len(sets) < 2:
        sets += [c for c in (accepted or found.steps)[-1].ranked if set(c.names) != set(sets[0].names)][: LEFT - 1]
    fitted = {c.names: c for c in whole.refine(sets, 3)}
    weights = [min([1.0, *(n.p_best for n in verdict.effects)])] + [float(r["p_best"]) for r in verdict.rivals] + [0.0] * LEFT
    return [hypothesis(near, fitted[c.names], w) for c, w in zip(sets, weights, strict=False)]


def hypothesis(e: Likelihood, c: Candidate, weight: float) -> Hypothesis:
    """A candidate with how far its parameters may be off."""
    moves = np.repeat(c.row[None], len(c.places), 0)
    for k, (place, spread) in enumerate(zip(c.places, estimate(e, c)[1], strict=True)):
        moves[k, place] += spread
    return Hypothesis(c.names, c.row, moves, weight)


def to_plain(model, s: Hypothesis) -> dict:
    """{effect: {parameter: [value, low, high]}} of a side, 90 %."""
    out: dict = {}
    quantile = thresholds().intervals.quantile
    entries = [(x, p) for x in model.active.effects if x.name in s.names for p in x.parameters]
    for k, (x, p) in enumerate(sorted(entries, key=lambda xp: s.names.index(xp[0].name))):
        place = model.index(x.name, p.name)
        value = s.row[place]
        half = quantile * abs(s.moves[k, place] - value)
        out.setdefault(x.name, {})[p.name] = [float(value), float(value - half), float(value + half)]
    return out


def from_plain(model, values: dict, weight: float) -> Hypothesis:
    """The side that `to_plain` wrote."""
    row = model.null.copy()
    moves = []
    quantile = thresholds().intervals.quantile
    for name, entries in values.items():
        for parameter, (value, low, high) in entries.items():
            row[model.index(name, parameter)] = value
            moves.append((model.index(name, parameter), (high - low) / 2 / quantile))
    rows = np.repeat(row[None], len(moves), 0)
    for k, (place, spread) in enumerate(moves):
        rows[k, place] += spread
    return Hypothesis(tuple(values), row, rows, weight)
