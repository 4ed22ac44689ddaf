"""A robot on scales, a knife edge and two threads: its mass properties, without any water.

    weighed = (mass kg, balance point from the nose m, yaw inertia about it kg m2)      straight, dry

The page `measurements.toml` of a data set (log/measurements.py) is one more sensor, of the first searched record. If it
has no scales, the mass of the description counts as weighed unless stated otherwise: a wrong body mass imitates nearly any error
of the water, and weighing takes a minute. Its null runs have the instruments' errors only, since a healthy fish has its model's
mass. The effect of mass on a weighing is exact, so it has no form error (likelihood.py).
"""

from math import sqrt
from pathlib import Path

import numpy as np

from fishmj.gap.records.records import Record, Sensor
from fishmj.log import measurements
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of
from fishmj.water.dynamics.hooks import Effects

CHANNEL = "weighing"
SCALES, EDGE, PENDULUM = 1e-3, 1e-3, 5e-3  # least errors: of a mass, relative; of a balance point, m; of an inertia, relative
QUANTITIES = (("mass", "kg"), ("balance point", "m from the nose"), ("yaw inertia", "kg m2"))
BEYOND = 3.0  # sigma, least difference that is reported
DRAWN = 0x5CA1E  # of the null runs' readings


def sensor(page: dict, model, known: bool = True) -> Sensor | None:
    """(1, 3) values of a page, NaN for a missing table; None for an empty page.

    sigma: of the instruments, or the scatter of repeats. known: True if the description's mass was weighed; it is used if the
    page has no scales. Raises ConfigError: a number is missing or not positive.
    """
    if not known and not page.keys() & {"scales", "balance", "pendulum"}:
        return None
    mass, error = float(predicted(model, model.null)[0, 0]), SCALES
    values, sigma = np.full(3, np.nan), np.full(3, np.nan)
    if "scales" in page:
        each, scatter = measurements.masses(page, measurements.weighed_parts(page, (link.name for link in model.robot.links)))
        values[0] = mass = float(each.sum())
        sigma[0] = max(scatter, SCALES * mass)
        error = float(sigma[0]) / mass
    elif known:
        values[0], sigma[0] = mass, SCALES * mass
    if "balance" in page:
        values[1], sigma[1] = measurements.balance(page, EDGE)
    if "pendulum" in page:
        values[2], scatter = measurements.inertia(page, mass)
        sigma[2] = values[2] * sqrt(max(scatter, PENDULUM) ** 2 + error**2)
    return Sensor(np.zeros(1), values[None], sigma)


def check_page(page: dict, robot: Robot, path: "str | Path" = measurements.FILE) -> None:
    """Raises ConfigError: a weighing of the page is in another unit, or invalid."""
    mass, length = float(geometry_of(robot).mass.sum()), sum(link.length for link in robot.links)
    measurements.check_units(page, (link.name for link in robot.links), mass, length, path)


def separation(model, one: np.ndarray, other: np.ndarray) -> float:
    """Separation of two explanations by usual instruments, in standard deviations.

    one, other: (1 + K, P) the fitted row, and one for each parameter, a standard deviation away.
    """
    sides = [predicted(model, rows) for rows in (one, other)]
    open_ = np.concatenate([s[1:] - s[0] for s in sides])
    apart = sides[0][0] - sides[1][0]
    mass, _, inertia = predicted(model, model.null)[0]
    usual = np.diag([SCALES * mass, EDGE, PENDULUM * inertia]) ** 2
    return float(np.sqrt(apart @ np.linalg.solve(usual + open_.T @ open_, apart)))


def agreement(model, records: list[Record]) -> str:
    """Sentence on the agreement of the records' weighings with the present model; "" without any."""
    weighed = next((r.weighed for r in records if r.weighed is not None), None)
    if weighed is None:
        return ""
    if (mass := weighed.values[0, 0]) == predicted(model, model.null)[0, 0] and np.isnan(weighed.values[0, 1:]).all():
        return described(mass)
    rows = zip(QUANTITIES, weighed.values[0], predicted(model, model.null)[0], weighed.sigma, strict=True)
    off = [
        f"{name} is {value:.4g} {unit}, the model's {nominal:.4g} ({abs(value - nominal) / sigma:.0f} sigma)"
        for (name, unit), value, nominal, sigma in rows
        if abs(value - nominal) > BEYOND * sigma
    ]
    known = ", ".join(name for (name, _), value in zip(QUANTITIES, weighed.values[0], strict=True) if np.isfinite(value))
    return f"Weighed: its {'; its '.join(off)}." if off else f"The weighings agree with the model ({known})."


def described(mass: float) -> str:
    """Note that no scales were used."""
    return f"The model's mass, {mass:.4g} kg, counts as weighed; add --mass-unknown if it was never weighed."


def with_page(records: list[Record], weighed: Sensor | None) -> list[Record]:
    """The records, the first of which has the page."""
    return records if weighed is None else [records[0]._replace(weighed=weighed), *records[1:]]


def null(weighed: Sensor, runs: int, seed: int) -> dict[str, np.ndarray]:
    """Sensor and column -> (n, 1) residuals of fish with the model's mass."""
    read = weighed.sigma * np.random.default_rng([DRAWN, seed]).standard_normal((runs, 3))
    return {f"weighed{column}": values[:, None] for column, values in enumerate(read.T)}


def predicted(model, rows) -> np.ndarray:
    """(R, 3) values of the straight fish with the effects of each parameter row (R, P), added to the description's own."""
    columns = list(np.atleast_2d(np.asarray(rows, float)).T)
    hooks = Effects(np, model.active, columns[len(model.constants) :], model.active.memory)
    chain, swimmer = hooks.fish(model.chain, model.nominal)
    mass = [m * f for m, f in zip(chain.mass, swimmer.mass, strict=True)]
    origin = np.concatenate([[0.0], np.cumsum(chain.d)])
    x = [o + c for o, c in zip(origin, chain.com, strict=True)]
    total = sum(mass)
    middle = sum(m * place for m, place in zip(mass, x, strict=True)) / total
    own = sum(i * f for i, f in zip(chain.inertia, swimmer.mass, strict=True))
    inertia = own + sum(m * (place - middle) ** 2 for m, place in zip(mass, x, strict=True))
    nose = chain.d[0] + model.robot.links[0].length
    return np.stack(np.broadcast_arrays(total, nose - middle, inertia, columns[0])[:3], -1)
