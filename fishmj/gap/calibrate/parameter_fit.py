"""Least squares with intervals that stay valid for correlated residuals.

    theta* = argmin sum_b |r_b|^2 / (s_b^2 tau_b) + sum_c ((theta_c - mean_c) / sigma_c)^2
    s_b: root mean square of block b's residual at theta*;  tau_b = 1 + 2 sum rho(k), its correlation in samples (Sokal's window)

The standard deviation of a parameter is the largest of three, because a model is never the robot:

    curvature   H^-1, H the normal matrix of the above
    trials      jackknife over trials:         (L - 1)/L sum_l |theta_-l - theta*|^2
    signals     the same over kinds of trial (signal and medium): the effect of another experiment

theta_-l is one Gauss-Newton step from theta* (Efron & Stein 1981). The interval is 90 %, with Student's t of the groups' number.
Fewer than FEW groups give no width (t = 6.3): then only the curvature counts.

Residuals beyond a block's `outlier` count by their size instead of their square (Huber 1964, by weights between passes), so that
a few readings that are no angle do not pull the fit.
The error of a calibration with a good fit (`data/calib/calibrate.toml`) widens every interval.
"""

from collections.abc import Callable
from math import hypot
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import read_toml, resolve
from fishmj.base.least_squares import Problem, damped_steps, jackknife

PASSES, ROUNDS = 3, 15
DAMPINGS = (1e-6, 1e-2, 1e-1, 1.0, 10.0)
NORMAL = 1.645  # standard deviations of a 90 % interval
FIELDS = ("low", "high", "start", "step", "sigma")
RIDGE = 1e-12  # per difference step, for a parameter without effect and without prior
ENOUGH = 1e-5  # of the cost: less is no progress
FEW = 3  # groups, below which no jackknife is taken
AT_BOUND = 1e-3  # of a parameter's range


class FreeParameter(NamedTuple):
    """A fitted parameter. step: for derivatives; sigma: of the prior about `start`, inf for none."""

    name: str
    unit: str
    start: float
    step: float
    low: float = -np.inf
    high: float = np.inf
    sigma: float = np.inf


class Block(NamedTuple):
    """Place of one channel of one trial in the residual.

    group: kind of trial, for the jackknife; its blocks share a weight. sigma: expected residual, if known.
    outlier: residual from which a sample counts by its size.
    """

    trial: str
    group: str
    where: slice
    sigma: float | None = None
    outlier: float = np.inf


class ParameterEstimate(NamedTuple):
    """One parameter with its 90 % interval and the cause of its width."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    sd: float
    widest: str  # curvature, trials or signals; "model" where the systematic part is wider
    bound: str = ""  # "lower" or "upper" where the value ended at a bound of its range


class Spread(NamedTuple):
    """One estimate of the parameters' uncertainty: their covariance (K, K), and Student's quantile of a 90 % interval."""

    covariance: np.ndarray
    quantile: float


class LeastSquaresFit(NamedTuple):
    """theta (K,), its estimates, the residual (m,) there and at the start, both in units of the channels; spreads by kind."""

    theta: np.ndarray
    estimates: dict[str, ParameterEstimate]
    before: np.ndarray
    after: np.ndarray
    rounds: int
    spreads: dict[str, Spread]


Residual = Callable[[np.ndarray], np.ndarray]  # (R, K) -> (R, m)
Tick = Callable[[float], None]  # share of a fit that is done, at the least


def fit(
    parameters: list[FreeParameter],
    residual: Residual,
    blocks: list[Block],
    tick: Tick = lambda share: None,
    begin: np.ndarray | None = None,
) -> LeastSquaresFit:
    """Fits `parameters` so that `residual` becomes small. begin: (K,) start point, by default their `start`."""
    theta = np.array([p.start for p in parameters]) if begin is None else np.array(begin)
    before, rounds = residual(theta[None])[0], 0
    weight = _weights(before, blocks)
    for done in range(PASSES):  # weighs by what the pass before could not fit
        theta, more = _descend(parameters, residual, theta, weight, tick, done)
        rounds, after = rounds + more, residual(theta[None])[0]
        weight = _weights(after, blocks)
    problem = problem_of(parameters, residual, weight)
    spreads = _spreads(problem, theta, *problem.linear(theta), blocks)
    return LeastSquaresFit(theta, _estimates(parameters, theta, spreads), before, after, rounds, spreads)


def problem_of(parameters: list[FreeParameter], residual: Residual, weight: np.ndarray) -> Problem:
    """The weighted fit of some parameters."""
    low, high, start, step, sigma = (np.array([getattr(p, key) for p in parameters]) for key in FIELDS)
    return Problem(lambda thetas: residual(thetas) * weight, step, start, np.diag(1.0 / sigma**2), low, high)


class Minimum(NamedTuple):
    """End of a descent. theta (K,); residual (m,) weighted; slopes (m, K) a step size; held: (K,) bool, at a bound."""

    theta: np.ndarray
    cost: float
    residual: np.ndarray
    slopes: np.ndarray
    held: np.ndarray
    rounds: int


def minimum(
    parameters: list[FreeParameter], residual: Residual, weight: np.ndarray, begin: np.ndarray, rounds: int, enough: float,
) -> Minimum:  # fmt: skip
    """Minimises |weight residual|^2 + prior by Levenberg and Marquardt; a parameter that pushes against its bound stays there.

    Args:
        begin: (K,). rounds: at most. enough: two successive rounds that lower the cost by a smaller share end the descent.
    """
    problem, theta, small = problem_of(parameters, residual, weight), np.array(begin, float), 0
    for done in range(rounds + 1):
        r, jac = problem.linear(theta)
        now = problem.cost(r[None], theta[None])[0]
        normal, push = problem.quadratic(theta, r, jac)
        held = ((theta <= problem.low) & (push > 0)) | ((theta >= problem.high) & (push < 0))
        if done == rounds or small == 2:
            break
        free, changes = ~held, np.zeros((len(DAMPINGS) + 1, len(theta)))
        changes[:-1, free] = damped_steps(normal[np.ix_(free, free)], push[free], DAMPINGS)
        changes[-1] = 0.5 * changes[0]
        best = problem.best(theta, changes)
        small = small + 1 if not best.cost < now * (1 - enough) else 0
        if not best.cost < now:
            break
        theta = best.x
    return Minimum(theta, float(now), r, jac.T, held, done)


def _weights(r: np.ndarray, blocks: list[Block]) -> np.ndarray:
    """(m,) 1 / (s sqrt(tau)) of each block, from the blocks of its group: correlated samples weigh less."""
    groups: dict[str, list[Block]] = {}
    for b in blocks:
        groups.setdefault(b.group, []).append(b)
    out = np.empty(len(r))
    for members in groups.values():
        robust = [np.sqrt(np.minimum(1.0, b.outlier / np.maximum(np.abs(r[b.where]), 1e-18))) for b in members]
        kept = [r[b.where] * share for b, share in zip(members, robust, strict=True)]
        square = np.mean([np.mean(part**2) for part in kept])
        tau = np.mean([correlation_length(part) for part in kept])
        for b, share in zip(members, robust, strict=True):
            out[b.where] = share * (1.0 / np.sqrt(square * tau + 1e-18) if b.sigma is None else 1.0 / b.sigma)
    return out


def _descend(parameters: list[FreeParameter], residual: Residual, theta, weight, tick: Tick, done: int) -> tuple[np.ndarray, int]:
    """Descends by Levenberg and Marquardt, after `done` passes; tries all dampings of a round in one batch."""
    problem = problem_of(parameters, residual, weight)
    for rounds in range(1, ROUNDS + 1):
        r, jac = problem.linear(theta)
        best = problem.best(theta, damped_steps(*problem.quadratic(theta, r, jac), DAMPINGS, RIDGE))
        tick((done + rounds / ROUNDS) / PASSES)
        if not best.cost < problem.cost(r[None], theta[None])[0] * (1 - ENOUGH):
            return theta, rounds
        theta = best.x
    return theta, ROUNDS


def _spreads(problem: Problem, theta, r, jac, blocks) -> dict[str, Spread]:
    """Curvature, and the jackknifes over trials and groups."""
    from scipy.stats import t as student

    normal, _ = problem.quadratic(theta, r, jac)
    floor = 1e-9 * np.diag(np.diag(normal) + 1e-12)
    scaled = lambda covariance: covariance * np.outer(problem.step, problem.step)
    found = {"curvature": Spread(scaled(np.linalg.inv(normal + floor)), NORMAL)}
    for kind, key in (("trials", lambda b: b.trial), ("signals", lambda b: b.group)):
        groups = sorted({key(b) for b in blocks})
        if len(groups) >= FEW:
            quantile = float(student.ppf(0.95, len(groups) - 1))
            found[kind] = Spread(scaled(_jackknife(r, jac, blocks, normal + floor, key, groups)), quantile)
    return found


def _estimates(parameters, theta, spreads: dict[str, Spread]) -> dict[str, ParameterEstimate]:
    out = {}
    for k, p in enumerate(parameters):
        sds = {kind: float(np.sqrt(spread.covariance[k, k])) for kind, spread in spreads.items()}
        widest = max(sds, key=lambda kind: sds[kind] * spreads[kind].quantile)
        sd, quantile, value = sds[widest], spreads[widest].quantile, float(theta[k])
        low, high = max(value - quantile * sd, p.low), min(value + quantile * sd, p.high)
        out[p.name] = ParameterEstimate(p.name, p.unit, value, low, high, sd, widest, bound_of(p, value))
    return out


def bound_of(parameter: FreeParameter, value: float) -> str:
    """ "lower" or "upper" for a fitted value at that bound, else an empty text."""
    width = parameter.high - parameter.low
    near = AT_BOUND * (width if np.isfinite(width) else abs(parameter.step))
    return "lower" if value <= parameter.low + near else "upper" if value >= parameter.high - near else ""


def _jackknife(r, jac, blocks, normal, key, groups) -> np.ndarray:
    """(K, K) covariance per step size from leaving out one group after another."""
    slope, steps = jac @ r, []
    for group in groups:
        rows = np.concatenate([np.arange(b.where.start, b.where.stop) for b in blocks if key(b) == group])
        part = jac[:, rows]
        # at a bound, theta* need not be a root of the slope: the change is relative to it
        push = slope - part @ r[rows] - slope * (len(groups) - 1) / len(groups)
        steps.append(-np.linalg.solve(normal - part @ part.T, push))
    return jackknife(np.array(steps))


def correlation_length(r: np.ndarray, longest: int | None = None) -> float:
    """tau = 1 + 2 sum rho(k), in samples, up to the first k > 5 tau, or below `longest`; at least 1."""
    x = r - r.mean()
    power = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    rho = np.fft.irfft(power)[: len(x)][:longest]
    if rho[0] <= 0:
        return 1.0
    rho = rho / rho[0]
    tau = 1.0 + 2.0 * np.cumsum(rho[1:])
    stop = np.flatnonzero(np.arange(1, len(rho)) > 5 * tau)
    return float(max(1.0, tau[stop[0]] if len(stop) else tau[-1]))


def calibration_table() -> dict:
    """The content of `calibrate.toml`."""
    return read_toml(resolve("calibrate"))


def widened(estimate: ParameterEstimate) -> ParameterEstimate:
    """The estimate with the systematic error of its name added in squares to sd and interval."""
    entry = calibration_table()["systematic"].get(estimate.name)
    if entry is None:
        return estimate
    more = entry["value"] * (abs(estimate.value) if entry["of"] == "value" else 1.0)
    low, high = (hypot(end - estimate.value, NORMAL * more) for end in (estimate.low, estimate.high))
    widest = "model" if NORMAL * more > max(estimate.value - estimate.low, estimate.high - estimate.value) else estimate.widest
    bottom = max(estimate.value - low, 0.0)
    return estimate._replace(low=bottom, high=estimate.value + high, sd=hypot(estimate.sd, more), widest=widest)
