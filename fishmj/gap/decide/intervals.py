"""Size of an effect, and its uncertainty from the records.

    theta_i   = -(J^T S_-i^-1 J)^-1 J^T S_-i^-1 r_i     the effect's estimate from null run i, in which nothing is hidden
    value     = fitted - mean_i theta_i                  a delay of the model itself does not make the robot late
    variance  = var_i theta_i + max(curvature, jackknife)^2 + (formula_error (fitted - null))^2

theta_i is taken with run i left out of S (null/whitening.py), all of them from one Gram matrix. curvature: (J^T S^-1 J)^-1 on
the data, which knows the autocorrelation. jackknife: one Gauss-Newton step with each record left out (Efron & Stein 1981).
Of an effect that draws, what it draws tells its size, too:
1 / variance += |C^-1/2 dC/dsize C^-1/2|^2 / 2, and its theta_i count by the share of the mean in what is known.
formula_error: no formula is the robot's; for a calibrated model it was measured by stage on other waters
(studies/structural_error/formula_error.py). A scale's reading has no such error: if weighings alone determine a value to within
s, its square f^2 becomes 1 / (1/f^2 + 1/s^2), and the jackknife over records leaves them out.
"""

import numpy as np

from fishmj.base.least_squares import jackknife_sd
from fishmj.gap.null.whitening import record_whitening
from fishmj.gap.records import mass_properties
from fishmj.gap.search.fit import Candidate, EffectFitter, bounds, difference_rows, needs_fine_value
from fishmj.gap.search.likelihood import Likelihood, draws
from fishmj.gap.thresholds import thresholds


def estimate(e: Likelihood, c: Candidate, by_stage: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """(values (K,), standard deviations (K,)) of a candidate's parameters.

    by_stage: with the formula error of each effect's stage (`Likelihood.formula_error`) in place of the general one.
    """
    limits = thresholds().intervals
    search = e.subset()
    low, high, _ = bounds(e.model)
    places = list(c.places)
    rows, moved = difference_rows(e.model, c)
    residual = e.layout.residuals(e.model.predict(e.records, np.concatenate([c.row[None], rows])))
    jacobian = (residual[1:] - residual[0]) / moved[:, None]
    white = search.whiten(jacobian)
    spurious = null_estimates(e, jacobian)
    weighed = e.layout.channel == mass_properties.CHANNEL
    # The larger of two, since neither is right alone: the curvature assumes S is exact, the jackknife needs many records.
    by_curvature = np.sqrt(np.diag(np.linalg.inv(_regularised(white @ white.T))))
    by_jackknife = sd_over_records(white, search.whiten(residual[0]), np.where(weighed, -1, e.layout.record))
    if len(e.records) < limits.jackknife_records:
        by_jackknife = np.minimum(by_jackknife, limits.jackknife_cap * by_curvature)
    sampling = np.maximum(by_curvature, by_jackknife)
    for place in drawn_places(e.model, c.names):
        k, told = places.index(place), scatter_information(e, c.row, place)
        share = 1.0 / (1.0 + told * sampling[k] ** 2)  # of the mean in what is known
        sampling[k], spurious[:, k] = sampling[k] * np.sqrt(share), spurious[:, k] * share
    stage = {e.model.index(x.name, p.name): x.stage for x in e.model.active.effects for p in x.parameters}
    errors = np.array([e.formula_error(stage[place]) if by_stage else limits.formula_error for place in places])
    form = errors * np.abs(c.row[places] - e.model.null[places])
    form = form / np.sqrt(1.0 + form**2 * np.sum((jacobian[:, weighed] / e.d[weighed]) ** 2, 1))
    # The mean estimate from null runs is subtracted: a delay of the model itself does not make the robot late.
    # With known healthy swims, the records include this already.
    usual = spurious.mean(0) if e.drawn else 0.0
    values = np.clip(c.row[places] - usual, low[places], high[places])
    return values, np.sqrt(np.mean((spurious - usual) ** 2, 0) + sampling**2 + form**2)


def drawn_places(model, names) -> list[int]:
    """Places in a parameter row of those of some effects that draw."""
    return [model.index(x.name, p.name) for x in draws(model, names) for p in x.parameters]


def scatter_information(e: Likelihood, row: np.ndarray, place: int) -> float:
    """Information on a size from what an effect draws: half the sum of squares of C^-1/2 dC/dsize C^-1/2, C of each record."""
    rows = np.tile(row, (2, 1))
    rows[:, place] *= np.array([0.9, 1.1])
    ends = [e.model.scatter(e.records, e.layout, one) for one in rows]
    total = 0.0
    for i, (less, more) in enumerate(zip(*ends, strict=True)):
        mine = e.layout.record == i
        alone = record_whitening(e.d[mine], [e.by_record[i]], np.zeros(int(mine.sum())))
        less, more = alone(less), alone(more)
        total += 0.5 * float(np.sum((more.T @ more - less.T @ less) ** 2))
    return total / float(np.diff(rows[:, place])[0]) ** 2


def null_estimates(e: Likelihood, jacobian: np.ndarray) -> np.ndarray:
    """(n, K) estimates from each null run, or direction left open by healthy swims, of parameters with this Jacobian (K, m)."""
    n = e.draws
    alone = record_whitening(e.d, e.by_record, e.layout.record)
    factors, scaled = alone(e.factors), alone(jacobian)
    gram = factors @ factors.T
    cross = scaled @ factors.T
    square = scaled @ scaled.T
    out = np.empty((n, len(scaled)))
    for i in range(n):
        others = np.arange(len(factors)) != i
        inner = np.linalg.inv(np.eye(len(factors) - 1) + gram[np.ix_(others, others)])
        normal = square - cross[:, others] @ inner @ cross[:, others].T
        projected = np.sqrt(n) * (cross[:, i] - cross[:, others] @ inner @ gram[others, i])
        out[i] = -np.linalg.solve(_regularised(normal), projected)
    return out


def sd_over_records(white: np.ndarray, z: np.ndarray, record: np.ndarray) -> np.ndarray:
    """(K,) standard deviations by the jackknife; record (m,) is the record of each value, -1 none."""
    n = int(record.max()) + 1
    steps = np.empty((n, len(white)))
    for k in range(n):
        rest = record != k
        steps[k] = -np.linalg.solve(_regularised(white[:, rest] @ white[:, rest].T), white[:, rest] @ z[rest])
    return jackknife_sd(steps)


def _regularised(normal: np.ndarray) -> np.ndarray:
    """The matrix with a tiny part of its diagonal added: parameters without effect get wide intervals, not an error."""
    return normal + np.diag(1e-9 * np.diag(normal) + 1e-300) + 1e-12 * np.trace(normal) * np.eye(len(normal))


def gains(search: EffectFitter, row: np.ndarray, places: np.ndarray, away: np.ndarray) -> np.ndarray:
    """(K,) gains of single parameters if they, each alone, are off a row (P,) by `away`: the change of the whitened residual."""
    rows = np.tile(row, (len(places), 1))
    rows[np.arange(len(places)), places] += away
    return np.sum((search.z(rows) - search.z(row[None])) ** 2, 1)


def missed_sizes(search: EffectFitter, row: np.ndarray, gain: float) -> dict[str, dict]:
    """Largest value at which each effect of one number, alone, gains less than asked: {effect: {value, null, unit, of_typical}}.

    A gain (`gains`) grows as the square of the size, which is corrected at a few values. Of a signed number the side that shows
    less counts. value: None if none in range shows. of_typical: the size over the largest typical one. Effects that draw or need
    an exact value are left out, and those that do not settle.
    """
    model, low_high, limits = search.model, bounds(search.model)[:2], thresholds().intervals
    drawn = {x.name for x in draws(model)}
    tried = []  # (effect, its number, place in the row, deviation from none)
    for x in model.active.effects:
        p, sides = x.parameters[0], (1.0, -1.0)
        place = model.index(x.name, p.name)
        if len(x.parameters) == 1 and row[place] == p.null and x.name not in drawn and not needs_fine_value(x):
            tried += [(x.name, p, place, side * (p.typical[1] - p.null)) for side in sides[: 1 + p.signed]]
    if not tried:
        return {}
    places, away = np.array([place for _, _, place, _ in tried]), np.array([size for *_, size in tried])
    most = np.where(away > 0, low_high[1][places], low_high[0][places]) - row[places]
    away = np.where(np.abs(away) < np.abs(most), away, most)
    for k in range(limits.missed_tries):
        change = gains(search, row, places, away)
        if k < limits.missed_tries - 1:
            ratio = np.clip(np.sqrt(gain / np.maximum(change, 1e-9)), 0.01, 100.0)
            away = np.where(np.abs(away * ratio) < np.abs(most), away * ratio, most)
    found: dict[str, dict] = {}
    for (name, p, place, typical), size, whole, gained in zip(tried, away, most, change, strict=True):
        never = size == whole and gained < gain
        if never or gain / limits.missed_near < gained < gain * limits.missed_near:
            told = {"value": None if never else float(row[place] + size), "null": p.null, "unit": p.unit}
            told |= {"of_typical": None if never else float(size / typical)}
            seen = found.get(name, told)
            larger = seen["value"] is not None and (never or abs(size) > abs(seen["value"] - p.null))
            found[name] = told if larger else seen
    return found
