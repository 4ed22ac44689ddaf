"""Add effects one by one while the Bayesian information criterion falls by more than 10.

BIC = sum_c n_c ln(RSS_c / m_c) + k ln(sum_c n_c)     channels c, m_c values worth n_c = sum n / tau independent ones
tau from the autocorrelation of the residual that the model leaves (Schwarz 1978; beyond 10: very strong, Kass & Raftery 1995)
"""

import numpy as np

from fishmj.gap.bench.baselines.baseline_answer import NOTHING, BaselineAnswer, channels, effective, searching, values
from fishmj.gap.records.records import Record

STRONG = 10.0
MOST = 3  # effects
TRIED = 6  # of the screen, fitted


def answer(plant, records: list[Record]) -> BaselineAnswer:
    """Answer by forward selection with BIC."""
    search = searching(plant, records)
    best = search.base()
    known = effective(best.z, search.layout)
    where = channels(search.layout)

    def bic(z: np.ndarray, parameters: int) -> float:
        fit = sum(known[c] * np.log(np.mean(z[i] ** 2) + 1e-12) for c, i in where.items())
        return fit + parameters * np.log(sum(known.values()))

    now = bic(best.z, 0)
    while len(best.names) < MOST:
        free = [e for e in plant.active.effects if e.name not in best.names]
        short = search.refine(search.screen(best, free)[:TRIED], 4)
        leader = min(short, key=lambda c: bic(c.z, len(c.places)))
        then = bic(leader.z, len(leader.places))
        if now - then <= STRONG:
            break
        best, now = leader, then
    if not best.names:
        return NOTHING
    return BaselineAnswer(values(plant, best.row, best.names), True, f"{len(best.names)} steps, each by more than {STRONG:.0f}")
