"""Coefficients that enter the forces linearly, by least squares over link wrenches with a prior.

    min  sum_rows ((F - A theta) / noise)^2 / n_c  +  sum ((theta - prior) / sd)^2,      low <= theta <= high

theta = k, cn (a link), cf, ca_forward, ca_backward, the trailing edge's ke, ke a, ke b, and k s of the suction behind the head,
whose share is s = sum k s / sum k. Noise is a channel's own remaining error, found in two iterations, so that the large forces of
acceleration do not dominate the small ones of drag; n_c = 15 rows, 0.3 s, is the correlation time of such errors. The nonlinear
parameters, stall angle and lag, are searched on a grid.
"""

from typing import NamedTuple

import numpy as np

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.fit.identifiability import Identified, identify
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, added, attachment, mean3
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.prior import STEEPEST, Prior, names_of, prior_of

HANG = 15.0  # rows that one independent error lasts
ROUNDS = 3
FLOOR = 1e-4  # N, N m: smallest noise of a channel
ANGLES, LAGS = np.radians([22.0, 28.0, 35.0, 43.0, 52.0]), (1.2, 2.0, 3.0, 4.5)
EDGE = ("ke", "edge_a", "edge_b")  # ke, ke lift_a, ke lift_b
SUCTION = "k_suction"  # k s, with the number of the link


class LinearFit(NamedTuple):
    """Coefficients, fit result of each, and the remaining error of every channel, (3, N), N and N m."""

    water: strip_forces.Coefficients
    found: Identified
    noise: np.ndarray


def fit_linear(robot: Robot, ch: planar_chain.Chain, data: RegressionRows, tick: float, *, stall: bool = True) -> LinearFit:
    """Fits all linear coefficients; with `stall`, also the stall angle, of a grid or the robot's own, and the lag on a grid.

    Raises DatasetError: forces are not finite.
    """
    if not np.isfinite(data.force).all():
        raise DatasetError("linear fit: a wrench is not finite; collect the record again")
    start = strip_forces.coefficients(robot.water, ch.n)
    prior = _prior(robot, ch.n)
    target = data.force - _known(data, ch.strips)
    blocks = [_block(data, ch.strips, i) for i in range(ch.n)]
    sums = lambda i, columns: _sums(prior, columns, target[:, i])
    last = ch.n - 1  # the grid moves the columns of the last link alone
    ahead = [sums(i, block) for i, block in enumerate(blocks[:last])]
    angles = sorted({*ANGLES.tolist(), start.stall_angle})
    grid = [(a, t) for a in angles for t in LAGS] if stall else [(start.stall_angle, start.stall_lag)]
    best: tuple = ()
    noise = np.maximum(target.std(-1), FLOOR)
    for angle, lag in grid:
        c = start._replace(stall_angle=float(angle), stall_lag=float(lag))
        columns = _edge(data, ch.strips, attachment(data, ch.strips, c, tick))
        links = [*ahead, sums(last, blocks[last] | columns)]
        solved = _solve(prior, links, noise)
        if not best or solved[-1] < best[-1]:
            best = (c, links, *solved)
    c, links, theta, normal, noise, _ = best
    for _ in range(ROUNDS - 1):
        theta, normal, noise, _ = _solve(prior, links, noise)
    water = _coefficients(c, theta, ch.n)
    return LinearFit(water, identify(prior, theta, normal), noise)


def _prior(robot: Robot, links: int) -> Prior:
    """Prior of theta; ke a and ke b take their means from the robot and their spread from both factors."""
    whole = prior_of(robot)
    kept = whole.only(names_of(links)[: 2 * links + 4])
    edge, share = whole.only(("lift_a", "lift_b")), whole.only(("suction",))
    behind = whole.only(tuple(f"k{i + 1}" for i in range(1, links)))
    ke = kept.mean[-1]
    mean, sd = ke * edge.mean, ke * np.hypot(edge.sd, edge.mean * kept.sd[-1] / ke)
    join = np.concatenate
    return Prior(
        (*kept.names[:-1], *EDGE, *(f"{SUCTION}{i + 1}" for i in range(1, links))),
        join([kept.mean, mean, behind.mean * share.mean]),
        join([kept.sd, sd, behind.mean * share.sd]),
        join([kept.low, [0.0, 0.0], 0.0 * behind.low]),
        join([kept.high, kept.high[-1] * edge.high, behind.high]),
    )


def _known(data: RegressionRows, s: strip_forces.Strips) -> np.ndarray:
    """Forces without a coefficient: the stream's acceleration on the displaced water, (3, N, M)."""
    out = np.zeros_like(data.force)
    for i, (d, b) in enumerate(zip(s.displaced, s.buoyancy, strict=True)):
        out[0, i], out[1, i], out[2, i] = d * data.du[0, i], d * data.du[1, i], d * b * data.du[1, i]
    return out


def _block(data: RegressionRows, s: strip_forces.Strips, i: int) -> dict[str, np.ndarray]:
    """Force on link i for a unit of each of its own coefficients, (3, M) by name."""
    n, motion = len(s.mu), data.of(i)
    unit = strip_forces.Coefficients([1.0] * n, [1.0] * n, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.1, 3.0, 0.0)
    across = mean3(strip_forces.reactive(s, unit, i, *motion))  # behind the head: without suction
    inertia = across + added(data, s, i)
    m0, m1, _ = s.mu[i]
    inertia += np.stack([0 * data.du[1, i], m0 * data.du[1, i], m1 * data.du[1, i]])
    skin = strip_forces.resistive(np, s, unit._replace(cn=[0.0] * n, cf=1.0), i, *motion)
    out = {f"k{i + 1}": inertia, f"cn{i + 1}": mean3(strip_forces.resistive(np, s, unit, i, *motion)), "cf": mean3(skin)}
    if i:
        out[f"{SUCTION}{i + 1}"] = mean3(strip_forces.reactive(s, unit._replace(suction=1.0), i, *motion)) - across
    else:
        for key in ("ca_forward", "ca_backward"):
            force = strip_forces.head_form(np, s, unit._replace(**{key: 1.0}), motion[0])
            out[key] = mean3((force, 0 * force, 0 * force))
    return out


def _edge(data: RegressionRows, s: strip_forces.Strips, attached: np.ndarray) -> dict[str, np.ndarray]:
    """The trailing edge's three columns on the last link."""
    n = len(s.mu)
    u, w, omega = data.of(n - 1)
    unit = strip_forces.Coefficients([0.0] * n, [0.0] * n, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.6, 0.1, 3.0)
    part = lambda a, b: mean3(strip_forces.trailing_edge(np, s, unit._replace(lift_a=a, lift_b=b), u, w, omega, attached))
    push, whole, share = part(0.0, 0.0), part(1.0, 0.0), part(0.0, 1.0)
    return dict(zip(EDGE, (push, whole - push, share - push), strict=True))


class _Sums(NamedTuple):
    """Sums over M rows for one link's columns A and target b, each by channel, as least squares need them."""

    at: list[int]  # of theta, p of them
    square: np.ndarray  # (3, p, p) A^T A
    right: np.ndarray  # (3, p) A^T b
    size: np.ndarray  # (3,) b^T b
    rows: int


def _sums(prior: Prior, columns: dict[str, np.ndarray], target: np.ndarray) -> _Sums:
    a = np.stack(list(columns.values()), 1)  # (3, p, M)
    at = [prior.names.index(name) for name in columns]
    right = (a @ target[:, :, None])[..., 0]
    return _Sums(at, a @ np.swapaxes(a, 1, 2), right, np.einsum("cm,cm->c", target, target), target.shape[1])


def _solve(prior: Prior, links: list[_Sums], noise):
    """theta, the data's normal matrix, the remaining error of every channel, and the objective."""
    size = len(prior.names)
    normal, right, square = np.zeros((size, size)), np.zeros(size), 0.0
    for i, link in enumerate(links):
        weight = 1.0 / (noise[:, i] ** 2 * HANG)
        normal[np.ix_(link.at, link.at)] += np.einsum("c,cpq->pq", weight, link.square)
        right[link.at] += weight @ link.right
        square += float(weight @ link.size)
    theta = bounded(prior, normal, right)
    left = [s.size - 2 * s.right @ theta[s.at] + s.square @ theta[s.at] @ theta[s.at] for s in links]  # |b - A theta|^2
    error = np.stack([np.sqrt(np.maximum(part, 0.0) / s.rows) for part, s in zip(left, links, strict=True)], 1)
    off = (theta - prior.mean) / prior.sd
    objective = square - 2 * right @ theta + theta @ normal @ theta + off @ off
    return theta, normal, np.maximum(error, FLOOR), float(objective)


def bounded(prior: Prior, normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """argmin of the quadratic plus prior within the bounds."""
    scaled = normal * np.outer(prior.sd, prior.sd) + np.eye(len(prior.mean))
    wanted = prior.sd * (right - normal @ prior.mean)
    low, high = (prior.low - prior.mean) / prior.sd, (prior.high - prior.mean) / prior.sd
    return prior.mean + prior.sd * bounded_minimum(scaled, wanted, low, high)


def bounded_minimum(normal: np.ndarray, right: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """argmin of x.normal.x / 2 - right.x within the bounds."""
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(normal).T
    return lsq_linear(root, np.linalg.solve(root.T, right), (low, high), method="bvls").x


def _coefficients(c: strip_forces.Coefficients, theta: np.ndarray, links: int) -> strip_forces.Coefficients:
    """theta as coefficients; the edge stays passive, a + b >= 1/2."""
    push = 2 * links + 3  # where the edge begins
    ke, a, b = theta[push : push + 3].tolist()
    ke = max(ke, a / STEEPEST, b / STEEPEST, 1e-6)  # a normal force without suction would need an infinite ratio
    a, b = a / ke, b / ke
    if a + b < 0.5:
        a = 0.5 - b
    k, cn = theta[:links].tolist(), theta[links : 2 * links].tolist()
    cf, forward, backward = theta[2 * links : 2 * links + 3].tolist()
    share = min(1.0, float(theta[push + 3 :].sum() / max(sum(k[1:]), 1e-6)))
    drags = {"cf": cf, "ca_forward": forward, "ca_backward": backward}
    return c._replace(k=k, cn=cn, **drags, ke=ke, lift_a=a, lift_b=b, suction=share)
