"""From what was found to one of the five answers: six gates, each a reason that a reader can check.

G1 adequacy     held-out |z|^2 / m is beyond every null run               else AGREES
G2 gain         held-out drop of |z|^2 that no null run gives away         else UNEXPLAINED
G3 closure      most of what is unexpected is gone                         else UNEXPLAINED, the best shown as tentative
G4 uniqueness   no rival nearly as good, P(best) high                      else CLASS
G5 sanity       no parameter on a bound, folds agree                       else CLASS with a warning
G6 transfer     four fifths of the held-out records get better             else UNEXPLAINED
"""

import numpy as np

from fishmj.gap import evidence
from fishmj.gap.candidates import Candidate, bounds
from fishmj.gap.search import Evidence, Found, Gates
from fishmj.gap.verdict import Named, Value, Verdict

ON_BOUND = 1e-3  # of the typical size
SPREAD = 0.3  # of the value, between folds
HALF = 1.645  # standard deviations of a 90 % interval


def decide(e: Evidence, found: Found, gates: Gates, held: np.ndarray) -> Verdict:
    """The answer with its gates."""
    before, parts = e.gap(found.base.row)
    checks: dict = {"adequacy": found.held_before / found.held_size, "gap_by_channel": parts}
    steps = tuple(described(s) for s in found.steps)
    plain: dict = dict(gap_before=before, gap_after=before, gates=checks, steps=steps)
    first = found.steps[0] if found.steps else None
    if first is None or (not first.accepted and checks["adequacy"] <= gates.adequacy):
        return Verdict("AGREES", reason="nothing is beyond what an independent simulation of this very fish scatters", **plain)
    if not first.accepted:
        tentative = named(e, found.base, first.ranked[:1], held, {})
        why = f"there is a gap, but the best candidate gains {first.gain:.0f} on held-out records, less than {gates.gain:.0f}"
        return Verdict("UNEXPLAINED", effects=tentative, reason=why, **plain)
    best = found.best
    after, _ = e.gap(best.row)
    checks["gain"] = found.held_before - found.held_after
    checks["closure"] = evidence.closure(found.held_before, found.held_after, found.held_size)
    last = [s for s in found.steps if s.accepted][-1]
    share, rivals = contest(e, last.ranked, gates)
    checks["transfer"] = transfer(e, found, held)
    effects = named(e, found.base, [best], held, share)
    warnings = sanity(e, best, effects)
    whole: dict = dict(
        effects=effects, rivals=rivals, gap_before=before, gap_after=after, explained=checks["closure"], steps=steps
    )
    whole |= dict(warnings=warnings, gates=checks)
    if checks["closure"] < gates.closure:
        why = f"the catalogue explains {checks['closure']:.0%} of what is unexpected; the best candidate is tentative"
        return Verdict("UNEXPLAINED", reason=why, **whole)
    if checks["transfer"] < 0.8:
        why = f"only {checks['transfer']:.0%} of the held-out records get better; the best candidate is tentative"
        return Verdict("UNEXPLAINED", reason=why, **whole)
    if rivals or share.get(best.names[-1], 1.0) < gates.p_best:
        return Verdict("CLASS", reason="these records cannot tell the effects apart that are listed", **whole)
    if warnings:
        return Verdict("CLASS", reason="one effect fits best, but what it came out at is not believable: a stand-in", **whole)
    return Verdict("NAMED", reason="one effect explains it, on records that it was not fitted to", **whole)


def contest(e: Evidence, ranked: tuple[Candidate, ...], gates: Gates) -> tuple[dict, tuple[dict, ...]]:
    """P(best) of each finalist's last effect, and the rivals: within the margin of the best's gain, or likely in the bootstrap.

    A candidate that came to rest on a bound is no rival: it is a limiting form that mimics the best.
    """
    low, high, size = bounds(e.plant)
    free = [c for c in ranked[1:] if not _on_bound(e, c, low, high, size)]
    contestants = [ranked[0], *free]
    share = evidence.p_best(np.stack([evidence.costs(c.z, e.layout) for c in contestants]))
    names = [c.names[-1] if c.names[:-1] == ranked[0].names[:-1] else "+".join(c.names) for c in contestants]
    gained = e.part(np.ones(len(e.records), bool)).base().cost - ranked[0].cost
    rivals = [
        {"name": n, "p_best": float(p), "behind": float((c.cost - ranked[0].cost) / gained)}
        for n, p, c in zip(names[1:], share[1:], free, strict=True)
        if c.cost - ranked[0].cost < gates.margin * gained or p > 1 - gates.p_best
    ]
    return dict(zip(names, map(float, share), strict=True)), tuple(rivals)


def _on_bound(e: Evidence, c: Candidate, low, high, size) -> bool:
    """Whether a parameter lies on a bound that is not its null."""
    null = e.plant.null
    near = lambda place, edge: edge != null[place] and abs(c.row[place] - edge) < ON_BOUND * size[place]  # noqa: E731
    return any(near(place, low[place]) or near(place, high[place]) for place in c.places)


def transfer(e: Evidence, found: Found, held: np.ndarray) -> float:
    """Share of the held-out records whose |z|^2 falls."""
    rest = e.part(held)
    z = rest.z(np.stack([found.base.row, found.best_fit.row]))
    before, after = evidence.costs(z, rest.layout)
    return float(np.mean(after < before))


def named(e: Evidence, base: Candidate, candidates, held: np.ndarray, share: dict) -> tuple[Named, ...]:
    """The effects of the first candidate with values, intervals and what each closes."""
    if not candidates:
        return ()
    c = candidates[0]
    spread = intervals(e, c)
    out = []
    for name in c.names:
        effect = next(x for x in e.plant.active.effects if x.name == name)
        values = {}
        for p in effect.parameters:
            place = e.plant.index(name, p.name)
            value, half = float(c.row[place]), HALF * spread[c.places.index(place)]
            values[p.name] = Value(
                value, p.unit, float(np.clip(value - half, p.low, p.high)), float(np.clip(value + half, p.low, p.high))
            )
        out.append(Named(name, values, share.get(name, 1.0), evidence.closure(base.cost, c.cost, e.layout.size)))
    return tuple(out)


def intervals(e: Evidence, c: Candidate) -> np.ndarray:
    """Standard deviation of each parameter: the larger of curvature and jackknife over records.

    curvature: (J^T J)^-1 of the whitened residual, which knows the autocorrelation. jackknife: one Gauss-Newton step with each
    record left out, J_l^T z_l taken from the sums; (L - 1)/L times the sum of squares (Efron & Stein 1981).
    """
    search = e.part(np.ones(len(e.records), bool))
    low, high, size = bounds(e.plant)
    rows, moved = [c.row], []
    for place in c.places:
        row = c.row.copy()
        step = 0.02 * size[place]
        row[place] += step if row[place] + step <= high[place] else -step
        moved.append(row[place] - c.row[place])
        rows.append(row)
    z = search.z(np.array(rows))
    jac = (z[1:] - z[0]) / np.array(moved)[:, None]
    normal = jac @ jac.T + 1e-12 * np.eye(len(jac))
    curvature = np.sqrt(np.diag(np.linalg.inv(normal)))
    n = len(e.records)
    steps = np.empty((n, len(jac)))
    for record in range(n):
        others = jac[:, e.layout.record != record]
        steps[record] = -np.linalg.solve(others @ others.T + 1e-9 * normal, others @ z[0][e.layout.record != record])
    jackknife = np.sqrt((n - 1) / n * np.sum((steps - steps.mean(0)) ** 2, 0))
    return np.maximum(curvature, jackknife)


def sanity(e: Evidence, c: Candidate, effects: tuple[Named, ...]) -> tuple[str, ...]:
    """What is not believable about the values."""
    low, high, size = bounds(e.plant)
    out = []
    for n in effects:
        effect = next(x for x in e.plant.active.effects if x.name == n.name)
        for p in effect.parameters:
            place = e.plant.index(n.name, p.name)
            value = n.parameters[p.name].value
            edges = [b for b in (low[place], high[place]) if b != p.null]
            if any(abs(value - b) < ON_BOUND * size[place] for b in edges):
                out.append(f"{n.name}.{p.name} = {value:.4g} {p.unit} lies on its bound")
        main = n.parameters[effect.parameters[0].name]
        if len(effect.parameters) == 1 and (main.high - main.low) / 2 / HALF > SPREAD * abs(
            main.value - effect.parameters[0].null
        ):
            out.append(f"{n.name}: the records disagree about its size by more than {SPREAD:.0%}")
    return tuple(out)


def described(step) -> dict:
    """One round for the report: candidates with their costs."""
    best = step.ranked[0].cost
    table = [{"names": list(c.names), "behind": c.cost - best} for c in step.ranked]
    return {"gain": step.gain, "accepted": step.accepted, "ranked": table}
