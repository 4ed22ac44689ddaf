"""MuJoCo's fluid coefficients fitted as the strips' are: by forces, then by free swims, on the same records and windows.

    forces   min sum ((F - A c) / noise)^2 / n_c + sum ((c - c0) / c0)^2,   0 <= c <= `MOST` c0
    search   `DRAWN` waters around both starts, on `FEW` swims: the minimum of MuJoCo's model may be far from the fit of forces
    swims    damped Gauss-Newton with the same prior and bounds from the `BEST` of them, on all swims of `FitPipeline`
c0 are MuJoCo's defaults. A fit by swims that makes the validation swims worse than the fit by forces is not used, as in the
recipe.

Without inertia the factor on the added mass stays 1: MuJoCo computes the mass, a user cannot set it.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fishmj.base.least_squares import Problem
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit import fit_pipeline, gauss_newton, linear_regression, rollout
from fishmj.hydro_fit.fit.gauss_newton import flaps
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, mean3, rows_of
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.prior import Prior
from studies.water_ablation import force
from studies.water_ablation.ellipsoid_swim import Bound, EllipsoidSwim

MOST = 8.0  # bound on a coefficient, in MuJoCo's defaults: a drag of twice the strips' highest
DRAWN, FEW, BEST, SPREAD = 126, 12, 3, 0.8  # SPREAD: standard deviation of ln factor of the draws
ROUNDS, STEP, LEAST = 8, 0.02, 0.005  # of Gauss-Newton; step in c0, for the differences; fall worth another round


@dataclass(frozen=True, eq=False)
class Fitted:
    """One fitted water of MuJoCo's kind. flat: (12,), see `force.names_of`. validation: squared tolerances, by stage."""

    ellipsoids: force.Ellipsoids
    flat: np.ndarray
    inertia: bool
    validation: dict
    seconds: float = 0.0
    notes: str = ""

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients by name."""
        return dict(zip(force.names_of(), self.flat.tolist(), strict=True))

    def swim(self, robot: Robot) -> EllipsoidSwim:
        """Free swims in this water; `run` still needs the coefficients."""
        return EllipsoidSwim(planar_chain.chain_of(robot), planar_chain.nominal(robot), self.ellipsoids, self.inertia)


class EllipsoidMatch(gauss_newton.Match):
    """`newton.Match` with the thrust of the ellipsoids on held fish."""

    swim: EllipsoidSwim

    def thrust_errors(self, water: np.ndarray) -> np.ndarray:
        """Errors of the mean thrust of the ellipsoids on held fish."""
        if self.held is None:
            return np.zeros(0)
        got = gauss_newton.thrusts(self.held, forces(self.swim.e, self.held, water, self.swim.inertia, self.tick))
        return np.clip((got - self.thrust) / (gauss_newton.THRUST * self.drag), -gauss_newton.CLIP, gauss_newton.CLIP)


class Fit(fit_pipeline.FitPipeline):
    """The records, windows and scores of `FitPipeline`, in MuJoCo's fluid."""

    def __init__(self, robot: Robot, train, val, *, dataset: dict, settings=None, inertia: bool, report=fit_pipeline.quiet):
        super().__init__(robot, train, val, dataset=dataset, settings=settings, report=report)
        self.e, self.inertia = force.ellipsoids_of(robot), inertia
        self.swim = EllipsoidSwim(self.chain, planar_chain.nominal(robot), self.e, inertia)
        self.unit = force.default(self.e)
        self.low, self.high = 0.0 * self.unit, MOST * self.unit
        fixed = [] if inertia else [i for i, name in enumerate(force.names_of()) if name.endswith("added")]
        self.free = np.array([i for i in range(len(self.unit)) if i not in fixed])

    def solve(self) -> Fitted:
        """Runs forces, search and swims; returns the coefficients."""
        began = time.process_time()
        by_forces = self.by_forces(rows_of(self.chain, self.train))
        match = self._match(self.train, None)
        starts = self._search(match, by_forces)
        self.report("search", 0.3, {})
        found = []
        for k, start in enumerate(starts):
            found.append(self._descend(match, start))
            self.report("swims", 0.3 + 0.7 * (k + 1) / len(starts), {"cost": found[-1][1]})
        by_swims = min(found, key=lambda one: one[1])[0]
        score = {"default": self.score(self.unit, None), "forces": self.score(by_forces, None)}
        score["swims"] = self.score(by_swims, None)
        worse = score["swims"] > score["forces"]
        notes = f"swims: not taken, validation {score['forces']:.4g} -> {score['swims']:.4g}" if worse else ""
        flat = by_forces if worse else by_swims
        return Fitted(self.e, flat, self.inertia, score, time.process_time() - began, notes)

    def by_forces(self, rows: RegressionRows) -> np.ndarray:
        """Coefficients (12,) by least squares on link wrenches, weights as in `linear`."""
        n = self.chain.n
        every = [columns(self.e, i, rows, self.inertia, self.tick) for i in range(n)]
        names = force.names_of()
        known = np.stack([part["viscous"] + (0.0 if self.inertia else part["added"]) for part in every], 1)
        target = rows.force - known
        blocks = []
        for i, part in enumerate(every):
            group = force.GROUPS[i == n - 1]
            at = [int(j) for j in self.free if names[j].startswith(group)]
            blocks.append((at, np.stack([part[names[j].removeprefix(f"{group}_")] for j in at], -1)))
        flat, noise = self.unit.copy(), np.maximum(target.std(-1), linear_regression.FLOOR)
        for _ in range(linear_regression.ROUNDS + 1):
            normal, right = np.zeros((len(flat), len(flat))), np.zeros(len(flat))
            for i, (at, a) in enumerate(blocks):
                for c in range(3):
                    weight = 1.0 / (noise[c, i] ** 2 * linear_regression.HANG)
                    normal[np.ix_(at, at)] += weight * a[c].T @ a[c]
                    right[at] += weight * a[c].T @ target[c, i]
            flat = self._bounded(normal, right, self.unit)
            left = np.stack([target[:, i] - a @ flat[at] for i, (at, a) in enumerate(blocks)], 1)
            noise = np.maximum(np.sqrt((left**2).mean(-1)), linear_regression.FLOOR)
        return flat

    def _bounded(self, normal: np.ndarray, right: np.ndarray, about: np.ndarray) -> np.ndarray:
        """Minimiser of c.normal.c / 2 - right.c plus the prior around `about`, within the bounds."""
        names, at = force.names_of(), self.free
        prior = Prior(tuple(names[i] for i in at), about[at], self.unit[at], self.low[at], self.high[at])
        out = self.unit.copy()
        out[at] = linear_regression.bounded(prior, normal[np.ix_(at, at)], right[at])
        return out

    def _match(self, records, learnt) -> EllipsoidMatch:
        made = super()._match(records, None)
        return EllipsoidMatch(self.swim, made.fleet, made.tick, made.held, made.drag)

    def _search(self, match: EllipsoidMatch, by_forces: np.ndarray) -> list[np.ndarray]:
        """The best starts among drawn waters, by the objective on a few swims."""
        rng = np.random.default_rng([61, self.settings.seed])
        drawn = np.stack([self.unit, by_forces] * (1 + DRAWN // 2))
        factor = np.exp(SPREAD * rng.standard_normal((len(drawn) - 2, len(self.free))))
        drawn[2:, self.free] = np.maximum(drawn[2:, self.free], 0.05 * self.unit[self.free]) * factor
        drawn = np.clip(drawn, self.low, self.high)
        count = len(match.fleet.q)
        few = np.sort(rng.choice(count, min(FEW, count), replace=False))
        part = EllipsoidMatch(self.swim, rollout.some(match.fleet, few), self.tick, match.held, match.drag)
        costs = [self._cost(r, c) for r, c in zip(part.residuals(drawn), drawn, strict=True)]
        return [drawn[i] for i in np.argsort(costs)[:BEST]]

    def _cost(self, residual: np.ndarray, flat: np.ndarray) -> float:
        off = (flat - self.unit) / self.unit
        return float(0.5 * residual @ residual + 0.5 * off @ off)

    def _descend(self, match: EllipsoidMatch, flat: np.ndarray) -> tuple[np.ndarray, float]:
        """Damped Gauss-Newton within the bounds; never ends worse than it began."""
        at, damping = self.free, 1e-2
        unit, low, high = self.unit[at], self.low[at], self.high[at]

        def residual(rows: np.ndarray) -> np.ndarray:
            waters = np.tile(self.unit, (len(rows), 1))
            waters[:, at] = rows
            return match.residuals(waters)

        problem, x = Problem(residual, STEP * unit, unit, np.diag(1.0 / unit**2), low, high), flat[at]
        best = 2.0 * self._cost(match.residuals(flat[None])[0], flat)
        for _ in range(ROUNDS):
            normal, slope = problem.quadratic(x, *problem.linear(x))
            dampings = damping * 10.0 ** np.arange(-1, len(at))
            room = (low - x) / problem.step, (high - x) / problem.step
            damped = (normal + d * np.diag(np.diag(normal)) for d in dampings)
            tried = problem.best(x, np.array([linear_regression.bounded_minimum(a, -slope, *room) for a in damped]))
            fall = best - tried.cost
            if fall <= 0:
                break
            x, best, damping = tried.x, tried.cost, float(dampings[tried.place])
            if fall < LEAST * best:
                break
        fitted = self.unit.copy()
        fitted[at] = x
        return fitted, 0.5 * best


def columns(e: force.Ellipsoids, i: int, rows: RegressionRows, inertia: bool, tick: float) -> dict[str, np.ndarray]:
    """Force (3, M) on link i for a unit of each coefficient, means over the tick; with `inertia`, of the whole added mass."""
    u, w, omega = rows.of(i)
    out = {name: mean3(part) for name, part in force.parts(np, e, i, u, w, omega).items()}
    if inertia:
        along, across, turning = e.added[i]
        rate = lambda value: (value[2] - value[0]) / tick
        push = -across * rate(w + e.centre[i] * omega)
        out["added"] = out["added"] + np.stack([-along * rate(u), push, e.centre[i] * push - turning * rate(omega)])
    return out


def forces(e: force.Ellipsoids, rows: RegressionRows, flat: np.ndarray, inertia: bool, tick: float) -> np.ndarray:
    """Force of the model in every row, (3, N, M)."""
    out = []
    for i in range(len(e.semi)):
        unit = columns(e, i, rows, inertia, tick)
        own = force.coefficients_of(flat, i == len(e.semi) - 1)
        out.append(unit["viscous"] + sum(value * unit[name] for name, value in own.items()))
    return np.stack(out, 1)


class FreeRunStart(NamedTuple):
    """Attributes of a model that `free_swims.FreeSwims` needs to start a free run.

    The ellipsoids have no memory and ignore them.
    """

    base: strip_forces.Coefficients
    learnt: None = None


class EllipsoidFreeSwims(free_swims.FreeSwims):
    """All free swims of some records, whole and settled, and the free runs."""

    def __init__(self, water: Fitted, robot: Robot, records: Sequence[SegmentRecord]):
        self._swum(Bound(water.swim(robot), water.flat), robot, records, FreeRunStart(planar_chain.nominal(robot).water))


def judge(water: Fitted, robot: Robot, records: Sequence[SegmentRecord]) -> dict:
    """{"figures", "n", "freerun_s"} as from `free_swims.judge`, without error bar and guard, which this water does not have."""
    swims = EllipsoidFreeSwims(water, robot, records)
    got, n = free_swims.errors(swims, swims.late)
    held = [r for r in records if flaps(r)]
    force_of = lambda ch, rows, tick: forces(water.ellipsoids, rows, water.flat, water.inertia, tick)
    got["thrust_error"], n["thrust_error"] = free_swims.thrust_error(force_of, robot, held), len(held)
    got["freerun_position_error"], n["freerun_position_error"] = swims.freerun_error()
    return {"figures": got, "n": n, "freerun_s": float(swims.cruise.mask.sum(1).min() * records[0].tick)}
