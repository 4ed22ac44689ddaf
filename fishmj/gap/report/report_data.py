"""Figures of the page, computed from an inquiry: pictures and JSON use the same numbers."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fishmj.base import console
from fishmj.gap.decide.intervals import gains
from fishmj.gap.localise import Comparison, Localisation, compared, localise
from fishmj.gap.localise.error_growth import GrowthCurve, curves
from fishmj.gap.localise.swimming_speed import steady_speeds
from fishmj.gap.records import mass_properties
from fishmj.gap.search import likelihood
from fishmj.gap.search.fit import Candidate, limiting
from fishmj.gap.thresholds import Gates
from fishmj.gap.wording import quantity, title
from fishmj.gap.workflow import Inquiry
from fishmj.mjcf.identity import robot_names


@dataclass(frozen=True)
class ReportRow:
    """One finalist of a round.

    values: parameter -> (value, unit). p_best: None on a bound (a limiting form, no rival). behind: twice the log likelihood by
    which it trails the tried candidate, each linearised at itself, as a share of the tried one's gain; negative if ahead; None if
    that gains nothing. tried: True for the tried candidate.
    """

    name: str
    values: dict
    behind: float | None
    p_best: float | None
    rival: bool
    tried: bool = False


@dataclass(frozen=True)
class RoundFinalists:
    """The finalists of one round, the largest P(best) first. alike: (n, n) cosine between their whitened changes."""

    table: tuple[ReportRow, ...]
    alike: np.ndarray


@dataclass(frozen=True)
class UndetectableEffect:
    """An effect that these records could not show. ratio: |dz|^2 at its typical size over the threshold of a name."""

    name: str
    typical: str
    ratio: float


@dataclass(frozen=True)
class ReportData:
    """All data of the report."""

    inquiry: Inquiry
    gates: Gates
    comparison: Comparison
    place: Localisation
    growth: tuple[GrowthCurve, ...]
    channels: dict[str, tuple[float, float]]  # of the gap, before and after
    rounds: tuple[RoundFinalists, ...]
    blind: tuple[UndetectableEffect, ...]
    weighed: str
    speeds: dict[str, tuple[float, float]]  # m/s of steady swims: measured, by the present model


def gather(inquiry: Inquiry, place: Any = None) -> ReportData:
    """Computes all data of the report. place: of a robot in MJCF, a `RobotLocalisation`; it has no growth and no weighings."""
    growth: tuple[GrowthCurve, ...] = ()
    speeds: dict[str, tuple[float, float]] = {}
    gates, weighed, e, found = inquiry.gates, "", inquiry.evidence, inquiry.found
    c = compared(e, found.near if inquiry.verdict.taken else e, found.base.row, after(inquiry))
    if place is None:
        growth, weighed = curves(e.model, c.records, *c.rows), mass_properties.agreement(e.model, e.records)
        place, speeds = localise(c, gates.adequacy), steady_speeds(c.records, c.predictions)
    return ReportData(
        inquiry, gates, c, place, growth, channels(inquiry), rounds(inquiry), blind(inquiry, gates), weighed, speeds
    )


def after(inquiry: Inquiry) -> np.ndarray:
    """Parameter row with the found effects; of the present model if there are none, or if they did not help unseen records."""
    return (inquiry.found.best if inquiry.verdict.taken else inquiry.found.base).row


def channels(inquiry: Inquiry) -> dict[str, tuple[float, float]]:
    """(before, after) of the gap by channel, on all records searched, as for `Verdict.gap`."""
    e, found = inquiry.evidence, inquiry.found
    near = found.near if inquiry.verdict.taken else e
    one, two = e.gap(found.base.row)[1], near.gap(after(inquiry))[1]
    return {name: (one[name], two[name]) for name in one}


def rounds(inquiry: Inquiry) -> tuple[RoundFinalists, ...]:
    """The finalists of every accepted round, or of the first if there was none."""
    e, found, v = inquiry.evidence, inquiry.found, inquiry.verdict
    sure = {n.name: n.p_best for n in (*v.effects, *v.tentative)}
    out, start = [], found.base
    for number, step in enumerate(found.steps):
        if not step.accepted and number:
            break
        best = step.ranked[0]
        gained = (e.linearised_at(start.row) if number else e).loss(start.row) - best.cost
        z, *sides = e.linearised_at(best.row).subset().z(np.stack([start.row, *(c.row for c in step.ranked)]))
        free = [i for i, c in enumerate(step.ranked) if c is best or not limiting(e.model, c)]
        share = likelihood.p_best(np.stack([likelihood.costs(sides[i], e.layout) for i in free]))
        drawn = dict(zip(free, map(float, share), strict=True))
        new = best.names[-1]
        against = {str(r["name"]): float(r["p_best"]) for r in v.rivals if r.get("instead_of", new) == new}
        given = against | ({new: sure[new]} if step.accepted and new in sure else {})
        rows = []
        for i, c in enumerate(step.ranked):
            name = "+".join(c.newest if c.names[: -c.added] == start.names else c.names)
            p = given.get(name, drawn.get(i))  # the verdict refitted its rivals: one may have left its bound
            behind = float((c.cost - best.cost) / gained) if gained > 0 else None
            rows.append(ReportRow(name, values(e.model, c, name), behind, p, name in against, c is best))
        order = listed(rows)
        signatures = (np.stack(sides) - z)[order]
        unit = signatures / np.maximum(np.linalg.norm(signatures, axis=1, keepdims=True), 1e-12)
        out.append(RoundFinalists(tuple(rows[i] for i in order), unit @ unit.T))
        start = best
    return tuple(out)


def listed(rows: list[ReportRow]) -> list[int]:
    """The order of a table: the largest P(best) first, at a tie the tried candidate; candidates on a bound last."""
    return sorted(range(len(rows)), key=lambda i: (-1.0 if (p := rows[i].p_best) is None else p, rows[i].tried), reverse=True)


def values(model, c: Candidate, name: str) -> dict:
    """Parameters of the effects in `name`; with the effect's name if two share one."""
    mine = [(e, p) for e in model.active.effects if e.name in name.split("+") for p in e.parameters]
    names = [p.name for _, p in mine]
    key = lambda e, p: p.name if names.count(p.name) == 1 else f"{e.name}.{p.name}"
    return {key(e, p): (float(c.row[model.index(e.name, p.name)]), p.unit) for e, p in mine}


def blind(inquiry: Inquiry, gates: Gates) -> tuple[UndetectableEffect, ...]:
    """Effects whose typical size changes these records less than a name needs; the nearest to detection first."""
    e = inquiry.evidence
    row, tried = inquiry.found.base.row, []  # (effect, place of one of its numbers, its typical value)
    for x in (x for x in e.model.active.effects if x.name not in inquiry.found.best.names):
        for p in (p for p in x.parameters if not p.shape):
            sizes = (p.typical[1], 2 * p.null - p.typical[1])[: 1 + p.signed]
            tried += [(x, e.model.index(x.name, p.name), np.clip(size, p.low, p.high)) for size in sizes]
    if not tried:
        return ()
    places, typical = np.array([place for _, place, _ in tried]), np.array([size for *_, size in tried])
    most: dict[str, float] = {}
    for (x, *_), gain in zip(tried, gains(e.subset(), row, places, typical - row[places]), strict=True):
        most[x.name] = max(most.get(x.name, 0.0), float(gain) / gates.gain)
    first = {x.name: x.parameters[0] for x, *_ in tried}
    said = {name: f"{title(p.name)} {quantity(p.typical[1], p.unit)}" for name, p in first.items()}
    out = [UndetectableEffect(name, said[name], ratio) for name, ratio in most.items() if ratio < 1.0]
    return tuple(sorted(out, key=lambda b: -b.ratio))


def gap_of(m: ReportData) -> tuple[float, float]:
    """(before, after) on the page, as `Verdict.gap`; equal if no effect was accepted."""
    before, now = m.inquiry.verdict.gap
    return before, before if now is None else now


def plain(m: ReportData) -> dict:
    """The page's figures for JSON."""
    place = asdict(m.place) | {"text": m.place.text, "lags": {k: v and v.as_dict() for k, v in m.place.lags._asdict().items()}}
    place["frame"] = m.place.frame and m.place.frame._asdict()
    place["side"] = m.place.side and m.place.side._asdict()
    place["rates"] = m.place.rates and m.place.rates._asdict()
    place["locked"] = {k: v._asdict() for k, v in m.place.locked.items()}
    used = zip(m.inquiry.records, record_parts(m.inquiry), strict=True)
    page = {
        "verdict": m.inquiry.verdict.plain(),
        "robot": robot_names(m.inquiry.evidence.model.robot),
        "notes": list(m.inquiry.notes),
        "records": [{"name": r.name, "excitation": r.excitation, "part": part} for r, part in used],
        "gap": {"before": (pair := gap_of(m))[0], "after": pair[1], "allowed": m.gates.adequacy, "by_channel": m.channels},
        "localisation": place,
        "weighed": m.weighed,
        "speeds": m.speeds,
        "growth": [asdict(c) | {"kind": c.kind} for c in m.growth],
        "rounds": [asdict(r) for r in m.rounds],
        "not_visible": [asdict(b) for b in m.blind],
    }
    return console.plain(page)


def record_parts(inquiry: Inquiry) -> list[str]:
    """Use of each record: fitted, held out or never used."""
    held = iter(inquiry.held)
    return ["never used" if unseen else "held out" if next(held) else "fitted" for unseen in inquiry.unseen]
