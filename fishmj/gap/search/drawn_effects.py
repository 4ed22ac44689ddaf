"""Candidates whose newest effect is random (RobotForm.scatter), each with its own scatter in the covariance.

The mean of such an effect looks like a constant latency; only its scatter from packet to packet differs.
"""

from dataclasses import replace

import numpy as np

from fishmj.gap.search.fit import Candidate, bounds
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.thresholds import thresholds


def drawn_candidates(e: Likelihood, keep: np.ndarray, base: Candidate, effect) -> list[Candidate]:
    """`base` plus a random effect at several sizes, on records keep (L,), each with its own scatter in S.

    cost: includes the increase of log det S over that of `e`, so that it can be compared with other candidates' costs.
    """
    (p,) = effect.parameters
    place, plain, out = e.model.index(effect.name, p.name), e.subset(keep).whiten.logdet, []
    for value in np.geomspace(0.5 * p.typical[0], min(p.high, 2.0 * p.typical[1]), thresholds().stepwise.drawn_sizes):
        row = base.row.copy()
        row[place] = value
        own = e.with_scatter(row, keep).subset(keep)
        c = own.at(row, (*base.names, effect.name), (*base.places, place))
        out.append(replace(c, cost=c.cost + own.whiten.logdet - plain))
    return out


def in_own_scatter(e: Likelihood, c: Candidate) -> Candidate:
    """A candidate whose newest effect is random, at its most likely size on all records; cost as in `drawn_candidates`.

    Line search: steps from its size while the cost falls, then the vertex of the parabola through the last three sizes.
    """
    plain, place, known = e.subset().whiten.logdet, c.places[-1], {}
    low, high, _ = bounds(e.model)

    def cost(step: float) -> float:
        if step not in known:
            row = c.row.copy()
            row[place] = np.clip(c.row[place] * thresholds().stepwise.drawn_step ** step, low[place], high[place])
            own = e.with_scatter(row).subset()
            new = own.at(row, c.names, c.places)
            known[step] = replace(new, cost=new.cost + own.whiten.logdet - plain)
        return known[step].cost

    at = 0
    for _ in range(thresholds().stepwise.drawn_sizes):
        best = min((at - 1, at, at + 1), key=cost)
        if best == at:
            break
        at = best
    before, here, after = (cost(at + side) for side in (-1, 0, 1))
    bend = before - 2.0 * here + after
    if bend > 0.0:
        cost(at + 0.5 * (before - after) / bend)
    return min(known.values(), key=lambda found: found.cost)
