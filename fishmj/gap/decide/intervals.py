"""Size of an effect, and its uncertainty from the records.

    theta_i   = -(J^T S_-i^-1 J)^-1 J^T S_-i^-1 r_i     the effect's estimate from null run i, without any effect
    value     = fitted - mean_i theta_i                  subtracts the bias of the model, such as its own delay
    variance  = var_i theta_i + max(curvature, jackknife)^2 + (formula_error (fitted - null))^2

theta_i is taken with run i left out of S (null/whitening.py), all of them from one Gram matrix. curvature: (J^T S^-1 J)^-1 on
the data, which knows the autocorrelation. jackknife: one Gauss-Newton step with each record left out (Efron & Stein 1981).
The scatter of a random effect also informs its size: 1 / variance += |C^-1/2 dC/dsize C^-1/2|^2 / 2, and its theta_i count by
the mean's share of the information.
formula_error: error of the effect's formula; for a calibrated model it was measured by stage on other waters
(studies/structural_error/formula_error.py). A weighing has no such error: if weighings alone
determine a value to within s, f^2 becomes 1 / (1/f^2 + 1/s^2), and the jackknife over records leaves them out.
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
        share = 1.0 / (1.0 + told * sampling[k] ** 2)  # the mean's share of the information
        sampling[k], spurious[:, k] = sampling[k] * np.sqrt(share), spurious[:, k] * share
    stage = {e.model.index(x.name, p.name): x.stage for x in e.model.active.effects for p in x.parameters}
    errors = np.array([e.formula_error(stage[place]) if by_stage else limits.formula_error for place in places])
    form = errors * np.abs(c.row[places] - e.model.null[places])
    form = form / np.sqrt(1.0 + form**2 * np.sum((jacobian[:, weighed] / e.d[weighed]) ** 2, 1))
    # The mean estimate from null runs is the model's own bias, and is subtracted. Healthy swims include it already.
    usual = spurious.mean(0) if e.drawn else 0.0
    values = np.clip(c.row[places] - usual, low[places], high[places])
    return values, np.sqrt(np.mean((spurious - usual) ** 2, 0) + sampling**2 + form**2)


def drawn_places(model, names) -> list[int]:
    """Places of the parameters of some random effects in a parameter row."""
    return [model.index(x.name, p.name) for x in draws(model, names) for p in x.parameters]


def scatter_information(e: Likelihood, row: np.ndarray, place: int) -> float:
    """Fisher information on a size from a random effect's scatter: |C^-1/2 dC/dsize C^-1/2|^2 / 2, summed over records."""
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
    """(n, K) estimates of parameters with Jacobian (K, m) from each null run, or each direction left open by healthy swims."""
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
    """(K,) standard deviations by the jackknife. record: (m,) record of each value, -1 for none."""
    n = int(record.max()) + 1
    steps = np.empty((n, len(white)))
    for k in range(n):
        rest = record != k
        steps[k] = -np.linalg.solve(_regularised(white[:, rest] @ white[:, rest].T), white[:, rest] @ z[rest])
    return jackknife_sd(steps)


def _regularised(normal: np.ndarray) -> np.ndarray:
    """The matrix with a tiny share of its diagonal added, so that parameters without effect get wide intervals, not an error."""
    return normal + np.diag(1e-9 * np.diag(normal) + 1e-300) + 1e-12 * np.trace(normal) * np.eye(len(normal))


def gains(search: EffectFitter, row: np.ndarray, places: np.ndarray, away: np.ndarray) -> np.ndarray:
    """(K,) gains |dz|^2 of changing each parameter alone by `away` from a row (P,); z: whitened residual."""
    rows = np.tile(row, (len(places), 1))
    rows[np.arange(len(places)), places] += away
    return np.sum((search.z(rows) - search.z(row[None])) ** 2, 1)


def missed_sizes(search: EffectFitter, row: np.ndarray, gain: float) -> dict[str, dict]:
    """Largest undetected size of each one-parameter effect, alone: {effect: {value, null, unit, of_typical}}.

    It is the value at which the gain (`gains`) reaches `gain`. The gain grows about as the square of the size; a few iterations
    correct that. For a signed parameter the less visible sign counts. value: None if the effect is undetectable in its range.
    of_typical: size over the largest typical one. Random effects, those that need an exact value, and those that do not converge
    are left out.
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
