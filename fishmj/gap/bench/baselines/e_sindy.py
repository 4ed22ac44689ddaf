"""Discrepancy model by ensemble SINDy (Fasel et al. 2022; Kaheman et al. 2019), with pysindy's own optimiser.

    a = 2 e / H^2      missing acceleration of a model restarted from measured states: e = error after H = 0.3 s
    a = Theta xi       Theta: terms of speeds, angles and rates; xi sparse, over bootstrap samples of restarts

Columns are scaled to unit mean square, targets by the error from the uncertain start, so the threshold is in standard
deviations. Of the terms that most samples include, the one with the largest coefficient is named, by its effect.
"""

import warnings

import numpy as np

from fishmj.gap.bench.baselines.baseline_answer import NOTHING, BaselineAnswer, unsized
from fishmj.gap.localise.error_growth import HORIZONS, errors, latencies, segments
from fishmj.gap.records.records import Record

HORIZON = 1  # of HORIZONS
THRESHOLD = 1.0  # standard deviations
INCLUDED = 0.6
MODELS = 40
LEAST = 20  # restarts
STANDS_FOR = {  # (force, term) -> effect
    ("surge", "u"): "linear_surge_drag",
    ("surge", "u|u|"): "quadratic_drag",
    ("surge", "s s"): "tail_normal_force",
    ("sway", "w|w|"): "crossflow_drag",
    ("sway", "u w"): "body_lift",
    ("yaw", "r|r|"): "yaw_drag",
    ("yaw", "u w"): "munk_moment",
    ("joint", "angle"): "skin_stiffness",
    ("joint", "rate"): "viscous_friction",
    ("joint", "sign rate"): "coulomb_friction",
    ("joint", "rate|rate|"): "joint_hydro_damping",
    ("joint", "error"): "servo_gain",
}


def answer(plant, records: list[Record]) -> BaselineAnswer:
    """Answer with the strongest remaining term. Raises MissingExtra without pysindy."""
    late = latencies(plant, plant.null)
    parts = [s for _, s in segments(records, late)]
    if len(parts) < LEAST:
        return BaselineAnswer({}, False, f"{len(parts)} restarts are too few")
    _, error, start = errors(plant, records, plant.null)
    found = [
        (force, term, size)
        for force, theta, lacking, spread in equations(plant, parts, error[:, HORIZON], start[:, HORIZON])
        for term, size in terms(theta, lacking / spread)
    ]
    if not found:
        return NOTHING
    force, term, size = max(found, key=lambda f: f[2])
    name = STANDS_FOR.get((force, term), "")
    text = f"{force} acceleration ~ {term}, {size:.1f} standard deviations"
    return unsized(plant, name, text)


def equations(plant, parts, error: np.ndarray, start: np.ndarray):
    """(force, {term: column}, missing acceleration, its standard deviation) of surge, sway, yaw and all joints together."""
    n, scale = plant.joints, 2 / HORIZONS[HORIZON] ** 2
    u, w, r = np.array([p.record.push for p in parts]).T
    swing = np.array([p.swing for p in parts])
    s = swing.sum(1)
    yaw = np.array([p.record.start[2] for p in parts])
    ex, ey = error[:, n], error[:, n + 1]
    ahead, left = np.cos(yaw) * ex + np.sin(yaw) * ey, np.cos(yaw) * ey - np.sin(yaw) * ex
    body = {"1": np.ones_like(u), "u": u, "w": w, "r": r, "s": s, "u|u|": u * abs(u), "w|w|": w * abs(w), "r|r|": r * abs(r)}
    body |= {"u w": u * w, "u r": u * r, "w r": w * r, "s s": s * s, "s|s|": s * abs(s), "u s": u * s, "r s": r * s, "w s": w * s}
    for force, lacking, column in (("surge", ahead, n), ("sway", left, n), ("yaw", error[:, n + 2], n + 2)):
        good = np.isfinite(lacking) & np.isfinite(start[:, column])
        yield force, {k: v[good] for k, v in body.items()}, scale * lacking[good], scale * start[good, column]
    angle = np.array([p.record.joints for p in parts])
    asked = np.array([p.record.commands[0] for p in parts]) - angle
    joint = {"1": np.ones_like(angle), "angle": angle, "rate": swing, "sign rate": np.sign(swing), "error": asked}
    joint |= {"rate|rate|": swing * abs(swing), "angle^3": angle**3}
    good = np.isfinite(error[:, :n]) & np.isfinite(start[:, :n])
    yield "joint", {k: v[good] for k, v in joint.items()}, scale * error[:, :n][good], scale * start[:, :n][good]


def terms(theta: dict[str, np.ndarray], target: np.ndarray) -> list[tuple[str, float]]:
    """(term, median |coefficient|) of the terms that most bootstrap samples include."""
    import pysindy

    columns = np.stack(list(theta.values()), 1)
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, 0)), 1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns whenever the threshold takes every term away
        sparse = pysindy.EnsembleOptimizer(pysindy.STLSQ(threshold=THRESHOLD, alpha=1e-3), bagging=True, n_models=MODELS)
        sparse.fit(columns, target[:, None])
    coefficients = np.abs(np.array(sparse.coef_list)).reshape(MODELS, -1)
    included = np.mean(coefficients > 0, 0) >= INCLUDED
    return [(k, float(c)) for k, c, keep in zip(theta, np.median(coefficients, 0), included, strict=True) if keep]
