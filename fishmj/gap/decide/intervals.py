"""How large an effect is, and how well the records know it.

    theta_i   = -(J^T S_-i^-1 J)^-1 J^T S_-i^-1 r_i     what null run i would make of the effect although nothing is hidden in it
    value     = fitted - mean_i theta_i                  a model that is late by itself does not make the robot late
    variance  = var_i theta_i + max(curvature, jackknife)^2 + (FORM (fitted - null))^2

theta_i is taken with run i left out of S (null.py), all of them from one Gram matrix. curvature: (J^T S^-1 J)^-1 on the data,
which knows the autocorrelation. jackknife: one Gauss-Newton step with each record left out (Efron & Stein 1981). FORM: no
formula is the robot's, but a scale's reading is none: where weighings tell a value to within s by themselves, (FORM ..)^2 becomes
1 / (1/(FORM ..)^2 + 1/s^2), and no record that is left out takes them along.
"""

import numpy as np

from fishmj.gap.records import mass_properties
from fishmj.gap.search.effect_fitter import Candidate, bounds
from fishmj.gap.search.likelihood import Likelihood

STEP = 0.02  # of the typical size
FORM = 0.08
MANY, FEW = 6, 3.0  # with fewer records a jackknife is noise: it may widen the curvature by this factor at most
HALF = 1.645  # standard deviations of a 90 % interval


def estimate(e: Likelihood, c: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """(values (K,), standard deviations (K,)) of a candidate's parameters."""
    search = e.part(np.ones(len(e.records), bool))
    low, high, size = bounds(e.plant)
    places = list(c.places)
    rows = np.tile(c.row, (1 + len(places), 1))
    for k, place in enumerate(places):
        step = STEP * size[place]
        rows[1 + k, place] += step if rows[1 + k, place] + step <= high[place] else -step
    moved = np.array([rows[1 + k, place] - c.row[place] for k, place in enumerate(places)])
    residual = e.layout.residuals(e.plant.predict(e.records, rows))
    slopes = (residual[1:] - residual[0]) / moved[:, None]
    white = search.whiten(slopes)
    spurious = of_null(e, slopes)
    sure = curvature(white)
    weighed = e.layout.channel == mass_properties.CHANNEL
    folds = jackknife(white, search.whiten(residual[0]), np.where(weighed, -1, e.layout.record))
    sure = np.maximum(sure, folds if len(e.records) >= MANY else np.minimum(folds, FEW * sure))
    form = FORM * np.abs(c.row[places] - e.plant.null[places])
    form = form / np.sqrt(1.0 + form**2 * np.sum((slopes[:, weighed] / e.d[weighed]) ** 2, 1))
    values = np.clip(c.row[places] - spurious.mean(0), low[places], high[places])
    return values, np.sqrt(spurious.var(0) + sure**2 + form**2)


def of_null(e: Likelihood, slopes: np.ndarray) -> np.ndarray:
    """(n, K) what each null run would make of the parameters whose slopes (K, m) are given."""
    n = e.runs
    factors, b = e.factors / e.d, slopes / e.d
    gram, cross, square = factors @ factors.T, b @ factors.T, b @ b.T
    out = np.empty((n, len(b)))
    for i in range(n):
        others = np.arange(len(factors)) != i
        inner = np.linalg.inv(np.eye(len(factors) - 1) + gram[np.ix_(others, others)])
        normal = square - cross[:, others] @ inner @ cross[:, others].T
        seen = np.sqrt(n) * (cross[:, i] - cross[:, others] @ inner @ gram[others, i])
        out[i] = -np.linalg.solve(_firm(normal), seen)
    return out


def curvature(white: np.ndarray) -> np.ndarray:
    """(K,) from whitened slopes (K, m)."""
    return np.sqrt(np.diag(np.linalg.inv(_firm(white @ white.T))))


def jackknife(white: np.ndarray, z: np.ndarray, record: np.ndarray) -> np.ndarray:
    """(K,) over records; record (m,) says which each value belongs to, -1 none."""
    n = int(record.max()) + 1
    steps = np.empty((n, len(white)))
    for k in range(n):
        rest = record != k
        steps[k] = -np.linalg.solve(_firm(white[:, rest] @ white[:, rest].T), white[:, rest] @ z[rest])
    return np.sqrt((n - 1) / n * np.sum((steps - steps.mean(0)) ** 2, 0))


def _firm(normal: np.ndarray) -> np.ndarray:
    """The matrix with a hair of its diagonal added: parameters that do nothing come out wide, not as an error."""
    return normal + np.diag(1e-9 * np.diag(normal) + 1e-300) + 1e-12 * np.trace(normal) * np.eye(len(normal))
