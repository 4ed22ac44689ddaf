"""Numbers that a robot's description in MJCF leaves open, from its logs: friction, damping, rotor inertia, gains, delay, masses.

    z(theta)  residual of the segments (records/shooting.py), whitened by noise, errors of the starts and unexplained torques
    theta*    argmin |z|^2 + sum ((theta - stated) / sigma)^2        parameter_fit.py, with its intervals
    sigma     tolerance of masses, inertias and centres (data/calib/robot.toml); of the others the search's prior, which is wide

A parameter is identified if the standard deviation of its estimate is below half of sigma, or (except for bodies) of its change.
Others keep their stated value, because their interval is mostly the prior. Two that compensate each other are not identified.
The identified ones are fitted again with the others at their stated values: half of a joint fit may be worse than none. Their
intervals keep the width of the fit of all, since the others stay uncertain.
"""

from collections.abc import Sequence
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base.errors import LogError
from fishmj.gap.calibrate.parameter_fit import Block, FreeParameter, LeastSquaresFit, ParameterEstimate, fit
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import RobotDescription
from fishmj.gap.models.robot_sizes import sizes_of
from fishmj.gap.null.whitening import record_whitening
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.search.free_numbers import KINDS, OpenNumber, effects_of, free_numbers, stated
from fishmj.gap.thresholds import thresholds
from fishmj.gap.wording import title

TOLD = 0.5  # of sigma, or of the change: largest standard deviation of an identified parameter
STILL = 0.02  # rad or m: a joint with less movement counts as still
TRADED = 0.8  # correlation from which two parameters compensate each other
PERCENT = 100


class FittedNumber(NamedTuple):
    """One number of a description, SI, with its 90 % interval.

    stated: of the description, a factor of 1 for gains and bodies. told: share by which the prior's standard deviation (or
    the change) was reduced. traded: parameters that could compensate it. inert: no log shows it. bound: the bound it reached.
    """

    name: str
    unit: str
    stated: float
    value: float
    low: float
    high: float
    told: float
    is_told: bool
    traded: tuple[str, ...] = ()
    inert: bool = False
    bound: str = ""


class RobotFit(NamedTuple):
    """numbers: in the order of KINDS. model, delay: MjModel with the identified ones, and delay of all commands, s.

    errors: {joint: RMS error [rad or m] as described, with the identified numbers, with all}. misfit: |z|^2 / m of the same.
    """

    numbers: tuple[FittedNumber, ...]
    model: Any
    delay: float
    errors: dict[str, tuple[float, ...]]
    misfit: tuple[float, ...]


def fit_robot(
    robot: RobotDescription, records: Sequence, kinds: Sequence[str] = tuple(KINDS), bars: Bars = silent_bar
) -> RobotFit:
    """Fits the numbers of some kinds. records: `RobotRecord`s. bars: of the fit. Raises LogError if no joint moves."""
    records = list(records)
    listed = effects_of(kinds)
    sizes = sizes_of(robot, records)
    whole = RigidRobot(robot, sizes, listed)
    still = _still(robot, records)
    if len(still) == len(robot.channels):
        raise LogError(f"no joint moves by {STILL:g} rad or m in any log; record motions of every joint, slow and fast")
    inert = frozenset(e.name for e in whole.active.effects if effects.site_of(e.name) in still)
    inert |= whole.inert(records) if listed else frozenset()
    model = RigidRobot(robot, sizes, listed, without=inert)
    layout = ResidualLayout(records)
    free = free_numbers(model, kinds)
    places = [n.place for n in free]
    parameters = [FreeParameter(n.name, n.unit, n.start, n.step, n.low, n.high, n.sigma) for n in free]
    whiten = record_whitening(layout.noise(), model.record_errors(records, layout), layout.record)

    def rows(thetas: np.ndarray) -> np.ndarray:
        out = np.tile(model.nothing, (len(thetas), 1))
        out[:, places] = thetas
        return out

    def residual(thetas: np.ndarray) -> np.ndarray:
        raw = layout.residuals(model.predict(records, rows(np.atleast_2d(thetas))))
        return np.nan_to_num(whiten(raw), nan=1e6, posinf=1e6, neginf=-1e6)

    blocks = [Block(r.name, "", slice(*np.searchsorted(layout.record, [i, i + 1]))) for i, r in enumerate(records)]
    start = np.array([n.start for n in free])

    def fit_some(some: np.ndarray, label: str) -> LeastSquaresFit:
        """Fit of the parameters `some` (P,) bool, with the others at their stated values."""

        def of_some(thetas: np.ndarray) -> np.ndarray:
            every = np.tile(start, (len(np.atleast_2d(thetas)), 1))
            every[:, some] = thetas
            return residual(every)

        with bars(PERCENT, label, "%", at_most=True) as bar:
            found = fit(list(compress(parameters, some)), of_some, blocks, tick=lambda share: bar.update(PERCENT * share))
            bar.update(PERCENT)
        return found

    found = fit_some(np.ones(len(free), bool), "fit")
    numbers = _numbers(free, found)
    told, written = np.array([n.is_told for n in numbers], bool), start.copy()
    while told.any() and not told.all():
        again = fit_some(told, "fit of the identified numbers")
        firm = told.copy()
        firm[told] = [n.is_told for n in _numbers(list(compress(free, told)), again)]
        if np.array_equal(firm, told):
            written[told] = again.theta
            break
        told = firm
    else:
        written = np.where(told, found.theta, start)
    numbers = tuple(_written(n, value, t) for n, value, t in zip(numbers, [n.base for n in free] + written, told, strict=True))
    three = np.stack([start, written, found.theta])
    raw = layout.residuals(model.predict(records, rows(three)))
    errors = {name: tuple(np.sqrt(np.nanmean(raw[:, layout.channel == name] ** 2, 1)).tolist()) for name in robot.channels}
    row = rows(written[None])[0]
    misfit = tuple(np.mean(residual(three) ** 2, 1).tolist())
    left = tuple(_inert(whole, name) for name in sorted(inert))
    return RobotFit((*numbers, *left), model.model(row), float(np.round(model.delay(row), 6)), errors, misfit)


def _written(number: FittedNumber, value: float, identified: bool) -> FittedNumber:
    """The number at its written value, with the width of the fit of all; as it was if it is not identified."""
    if not identified:
        return number._replace(is_told=False)
    move = value - number.value
    return number._replace(value=value, low=number.low + move, high=number.high + move)


def _still(robot: RobotDescription, records: list) -> set[str]:
    """Names of the joints that do not move, whose friction cannot be identified."""
    moved = np.max([np.ptp(r.joint.values, 0) for r in records], 0)
    return {name for name, way in zip(robot.channels, moved, strict=True) if way < STILL}


def _numbers(free: list[OpenNumber], found: LeastSquaresFit) -> tuple[FittedNumber, ...]:
    """The estimates as absolute values, and whether the logs identify them."""
    estimates: list[ParameterEstimate] = [found.estimates[n.name] for n in free]
    covariance = found.spreads["curvature"].covariance
    sd = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance) / np.maximum(np.outer(sd, sd), 1e-300)
    # A body beyond its tolerance compensates something that is not fitted, so its change is no measure.
    change = [0.0 if n.is_factor else abs(e.value - n.start) for n, e in zip(free, estimates, strict=True)]
    scale = [max(n.sigma, c) for n, c in zip(free, change, strict=True)]
    # Zero friction is a valid value; any other bound only ends the search.
    bound = [e.bound if e.bound == "upper" or n.low > -n.base else "" for n, e in zip(free, estimates, strict=True)]
    is_told = [e.sd <= TOLD * size and not b for e, size, b in zip(estimates, scale, bound, strict=True)]
    out = []
    for k, (n, e) in enumerate(zip(free, estimates, strict=True)):
        others = [free[i].name for i in np.flatnonzero(correlation[k] > TRADED) if i != k and not is_told[k]]
        values = (n.base + n.start, n.base + e.value, n.base + e.low, n.base + e.high)
        told = max(0.0, 1.0 - e.sd / scale[k])
        out.append(FittedNumber(n.name, n.unit, *values, told, bool(is_told[k]), tuple(others), bound=bound[k]))
    return tuple(out)


def _inert(model: RigidRobot, name: str) -> FittedNumber:
    """An effect that no log shows."""
    p = model.active.effect(name).parameters[0]
    base, sigma = stated(model, name), thresholds().fit.prior_sd * abs(p.typical[1] - p.null)
    return FittedNumber(name, p.unit, base, base, max(base - sigma, base + p.low), base + sigma, 0.0, False, (), True)


def described(number: FittedNumber) -> str:
    """Words for the treatment of a parameter."""
    if number.inert:
        return "left: no log shows it"
    if number.is_told:
        return "written"
    if number.bound:
        return f"unchanged: at the {number.bound} bound of its range"
    return (
        f"unchanged: compensated by {', '.join(map(title, number.traded))}"
        if number.traded
        else "unchanged: not identified by the logs"
    )
