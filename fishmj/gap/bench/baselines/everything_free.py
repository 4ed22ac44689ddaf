"""Free every parameter of every effect at once, and name the one that moved most.

Least squares of all residuals over noise by `mujoco.minimize.least_squares`, the optimiser of mujoco.sysid, through the same
plant as the search: mujoco.sysid's own parameters live in an MJCF model, which holds no late camera, no current, no dead band.
The change of an effect is |theta - null| over its typical size; below MOVED nothing is named.
"""

import os

import numpy as np

from fishmj.gap.bench.baselines.baseline_answer import NOTHING, BaselineAnswer, searching, values
from fishmj.gap.records.records import Record
from fishmj.gap.search.fit import bounds
from fishmj.gap.thresholds import thresholds

ITERATIONS = 12
START = 0.05  # of the typical size: at the null of a dead band there is no slope
MOVED = 0.3  # of the typical size


def answer(plant, records: list[Record]) -> BaselineAnswer:
    """Answer of the fit with everything free."""
    from mujoco import minimize

    search = searching(plant, records)
    low, high, size = bounds(plant)
    share = thresholds().fit.difference_step
    free = np.arange(len(plant.constants), len(plant.null))
    low, high, size = low[free], high[free], size[free]

    def rows(x) -> np.ndarray:
        full = np.tile(plant.null, (x.shape[1], 1))
        full[:, free] = np.clip(x.T, low, high)
        return full

    def residual(x) -> np.ndarray:
        z = search.z(rows(x.reshape(len(free), -1)))
        return np.clip(z.T, -1e4, 1e4)  # (m, R)

    def jacobian(x, r) -> np.ndarray:
        x = x.reshape(-1, 1)
        step = np.where(x[:, 0] + share * size <= high, share, -share) * size
        return (residual(x + np.diag(step)) - r.reshape(-1, 1)) / step

    begin = np.clip(plant.null[free] + START * size, low, high)
    with open(os.devnull, "w", encoding="utf-8") as quiet:
        how = {"max_iter": ITERATIONS, "verbose": 0, "output": quiet, "x_scale": size}
        found, _ = minimize.least_squares(begin, residual, (low, high), jacobian, **how)
    moved = np.abs(np.ravel(found) - plant.null[free]) / size
    apart = [p.shape or p.unit != e.parameters[0].unit for e in plant.active.effects for p in e.parameters]
    moved[apart] = 0.0  # a clock's drift in millionths and what only shapes an effect have no size to compare
    most = int(np.argmax(moved))
    if moved[most] < MOVED:
        return NOTHING
    name = plant.active.names[most][0]
    row = rows(np.reshape(found, (-1, 1)))[0]
    return BaselineAnswer(values(plant, row, [name]), True, f"moved by {moved[most]:.2f} of its typical size")
