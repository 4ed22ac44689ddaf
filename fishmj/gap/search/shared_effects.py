"""Candidates with one kind of effect at many joints of a robot in MJCF.

A robot of twelve joints has three or four kinds of drive, so an effect at one joint is usually at most of them. Rounds with
single effects would need two or three for each joint, each disturbed by the large gaps of the other joints.

    kinds    an effect of the catalogue is a candidate if it gains enough at `shared_sites` joints or more
    values   one for each joint, fitted together
    gain     the gain required of so many effects; `prune` then removes those that the others do not need

Effects at different joints of such a robot do not imitate each other (`apart`).
"""

from collections import Counter

import numpy as np

from fishmj.effects.effect import AT, kind_of, site_of
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, on_records
from fishmj.gap.thresholds import Gates, thresholds


def kinds(names: tuple[str, ...]) -> list[str]:
    """The names, with one kind at many sites as one name: `coulomb_friction@12 joints`."""
    count = Counter(map(kind_of, names))
    many = {kind: f"{kind}{AT}{n} joints" for kind, n in count.items() if n >= thresholds().stepwise.shared_sites}
    return list(dict.fromkeys(many.get(kind_of(name), name) for name in names))


def at_many_joints(names: list[str]) -> bool:
    """Returns True if effects are at so many joints that those at one say little about another."""
    return len({site_of(name) for name in names} - {""}) >= thresholds().stepwise.shared_sites


def shares(model) -> bool:
    """Returns True for a robot with so many joints that kinds of effects are candidates."""
    return isinstance(model, RigidRobot) and model.joints >= thresholds().stepwise.shared_sites


def apart(model, one: str, other: str) -> bool:
    """Returns True if two effects are at different sites of a robot with many joints."""
    return shares(model) and bool(site_of(one)) and bool(site_of(other)) and site_of(one) != site_of(other)


def of_each_kind(screened: list[Candidate], base: Candidate, gates: Gates) -> list[list[Candidate]]:
    """Candidates of one more effect, grouped by kind: kinds that gain enough at enough sites, the largest gain first."""
    gaining: dict[str, list[Candidate]] = {}
    for c in screened:
        if site_of(c.names[-1]) and base.cost - c.cost > gates.gain:
            gaining.setdefault(kind_of(c.names[-1]), []).append(c)
    many = [found for found in gaining.values() if len(found) >= thresholds().stepwise.shared_sites]
    return sorted(many, key=lambda found: sum(c.cost - base.cost for c in found))


def joined(search: EffectFitter, base: Candidate, found: list[Candidate]) -> Candidate:
    """`base` with the newest effect of each candidate of `found`, at its values."""
    row, count = base.row.copy(), len(base.places)
    for c in found:
        row[list(c.places[count:])] = c.row[list(c.places[count:])]
    names = tuple(c.names[-1] for c in found)
    places = tuple(p for c in found for p in c.places[count:])
    return search.at(row, (*base.names, *names), (*base.places, *places), len(names))


def shared_candidates(
    whole: EffectFitter, base: Candidate, few: Candidate, screened: list[Candidate], gates: Gates
) -> tuple[list[Candidate], list[Candidate]]:
    """(best kinds, each fitted at all its sites; best single effects at each of those sites), on all records.

    few: `base` on the records of `screened`, the candidates with one more effect, best first.
    """
    many = of_each_kind(screened, few, gates)[: gates.finalists] if shares(whole.model) else []
    if not many:
        return [], []
    fitted = whole.refine(whole.refine([joined(whole, base, found) for found in many], 2)[: thresholds().stepwise.attempts], 2)
    sites = {site_of(name) for c in fitted for name in c.newest}
    alone = [[c for c in screened if site_of(c.names[-1]) == site][: thresholds().stepwise.attempts] for site in sorted(sites)]
    return fitted, [on_records(whole, c) for some in alone for c in some]


def least_needed(search: EffectFitter, c: Candidate, gain: float) -> list[str]:
    """Names of the few effects of a large set whose removal costs least to first order, less than `gain`; all of a small set.

    Removing the parameters B and refitting the others raises |z|^2 by theta_B^T (N^-1_BB)^-1 theta_B, N = J J^T.
    """
    limits = thresholds().stepwise
    if not shares(search.model) or len(c.names) <= limits.shared_sites:
        return list(c.names)
    (jac,), places = search.slopes_of([c]), list(c.places)
    size = bounds(search.model)[2][places]
    inverse = np.linalg.inv(jac @ jac.T + np.eye(len(places)) / thresholds().fit.prior_sd ** 2)
    away = (c.row - search.model.null)[places] / size
    cost = {}
    for x in (x for x in search.model.active.effects if x.name in c.names):
        own = [places.index(search.model.index(x.name, p.name)) for p in x.parameters]
        cost[x.name] = float(away[own] @ np.linalg.solve(inverse[np.ix_(own, own)], away[own]))
    doubtful = [name for name in c.names if cost[name] < limits.slopes_spare * gain]
    return sorted(doubtful, key=cost.__getitem__)[: limits.attempts]
