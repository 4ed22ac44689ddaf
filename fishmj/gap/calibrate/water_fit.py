"""Fits the strip coefficients so that simulated free swims match the logged ones.

    rates    velocity ahead, to the left, and yaw rate of the body over 0.2 s, and their means over 2 s
    r        (measured - simulated) / tolerance, whole free runs from the start pose
    theta*   by least squares from two starts; a mean counts as much as (`RATE` / `MEAN`)^2 of its rates: their error is mostly
             the beat's and hides a mean that is wrong by a tenth

Coefficients compensate each other: one speed cannot separate drag from thrust, and strips only approximate real water. So the
result states body-level quantities (water_plant.physical) with intervals, and the fish's error on swims outside the fit: the
kinds of swim lie in folds, and each fold is predicted by a fit to the others. Servo and latencies are taken from the description:
calibrate them first.

Intervals are 90 %: two standard errors, from the curvature (noise) and from a delete-one-fold jackknife with refits, added in
quadrature. The second is the structural part: a wrong form of water gives other coefficients on other swims.
"""

import shlex
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import t as student

from fishmj.base.calib import read_toml, resolve
from fishmj.base.errors import LogError
from fishmj.base.least_squares import jackknife_sd
from fishmj.gap.calibrate.calibration_logs import QUIET, Logs
from fishmj.gap.calibrate.parameter_fit import NORMAL, Minimum, ParameterEstimate, bound_of, minimum
from fishmj.gap.calibrate.servo_fit import OPEN
from fishmj.gap.calibrate.water_plant import PHYSICAL, WaterPlant
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.records import Record, Sensor, mean_speed_and_yaw_rate
from fishmj.log import Trial
from fishmj.mjcf.description import Robot
from fishmj.water.choice import STRUCTURED
from fishmj.water.dynamics.tolerance import of_movement

SHORT, LONG = 0.2, 10  # s over which places are averaged; rates of a mean
RATE, MEAN = 8.0, 0.5  # tolerance weights of a rate, and of a mean
FOLDS = 5
ROUNDS, AGAIN = 40, 12  # of a fit, and of a fit to other swims that begins at the whole one's end
ENOUGH, ENOUGH_AGAIN = 1e-3, 3e-3  # of the cost
FEWEST = 4  # swims needed for cross-validation
KINDS = 3  # kinds of swim (`excitation`) at least, or one gait's thrust and drag stand in for each other
SLOW = 0.05  # m/s: below it a relative speed error is meaningless
LOOSE = 0.03  # relative error of an amplitude, to which the speed is proportional
FAR = 1e3  # error of a diverged fish, in tolerances
MOVED = 0.05  # m/s or rad/s of a push


class HeldOutSwim(NamedTuple):
    """One swim, predicted by a fit to others. Speeds in m/s, yaw rates in rad/s; `place`: m between the paths at the end."""

    trial: str
    kind: str
    speed: float
    simulated: float
    yaw_rate: float
    simulated_yaw_rate: float
    place: float

    @property
    def speed_error(self) -> float:
        """Relative speed error; NaN for a fish that hardly moves."""
        return abs(self.simulated / self.speed - 1.0) if self.speed > SLOW else np.nan


class WaterFit(NamedTuple):
    """The fit to all swims, its body-level quantities, and its errors on swims left out, before and after."""

    plant: WaterPlant
    records: list[Record]
    theta: np.ndarray
    coefficients: dict[str, ParameterEstimate]
    physical: dict[str, ParameterEstimate]
    before: list[HeldOutSwim]
    after: list[HeldOutSwim]
    misfit: tuple[float, float]  # of `after` and `before`, squared and weighted as in the fit

    @property
    def water(self) -> dict:
        """The `[water]` table of a description."""
        return self.plant.table(self.theta)

    @property
    def robot(self) -> Robot:
        """The described robot in its calibrated water, as `fishmj calibrate water --out` writes it."""
        kept = {key: value for key, value in self.plant.robot.water.items() if key == "stations"}
        return replace(self.plant.robot, water={**self.water, **kept, "model": STRUCTURED})

    @property
    def refusal(self) -> str:
        """Reason not to use the fit: it predicts held-out swims worse than the described coefficients do; else ""."""
        unseen, described = self.misfit
        off = f"{np.sqrt(unseen / max(described, 1e-12)):.3g} times the error of the described coefficients"
        return f"water: the error on held-out swims is {off}; keep those, or record more swims" if unseen > described else ""

    @property
    def speed_error(self) -> ParameterEstimate:
        """Relative speed error on swims outside the fit: mean, least and worst."""
        errors = np.array([swim.speed_error for swim in self.after])
        errors = errors[np.isfinite(errors)] if np.isfinite(errors).any() else np.full(1, np.nan)
        mean, least, worst = (float(f(errors)) for f in (np.mean, np.min, np.max))
        return ParameterEstimate("speed_error", "share", mean, least, worst, float(errors.std()), "swims")


def calibrate_trials(trials: Iterable[Trial], robot: "Robot | str" = "fish") -> tuple[Robot, WaterFit]:
    """The robot in the water of its free swims, and the fit; nothing is read or written.

    Args:
        trials: free swims from a generator or a log folder; equal names are numbered.

    Raises LogError: too few swims or kinds of swim, joints that do not match the robot, or a fit worse than the description.
    """
    listed = list(trials)
    named = {trial.name or f"{i:03d}": trial for i, trial in enumerate(listed)}
    if len(named) < len(listed):
        named = {f"{i:03d}_{trial.name}": trial for i, trial in enumerate(listed)}
    found = calibrate(Logs(Path("trials in memory"), named), WaterPlant(robot))
    if found.refusal:
        raise LogError(found.refusal)
    return found.robot, found


def calibrate(logs: Logs, plant: WaterPlant, *, bars: Bars = silent_bar) -> WaterFit:
    """Fits the water to the free swims of `logs`. Raises LogError: too few swims or kinds of swim."""
    records = logs.records(plant.dt, swims(logs), plant.camera)
    folds, starts = folded(records), plant.starts()
    with bars(len(starts) + len(folds), "water", "fits") as bar:
        ends = []
        for done, start in enumerate(starts, 1):
            ends.append(fitted(plant, records, start, ROUNDS, ENOUGH))
            bar.update(done)
        whole = min(ends, key=lambda end: end.cost)
        after: list[HeldOutSwim] = []
        others, misfits = [], np.zeros(2)
        for done, fold in enumerate(folds, len(starts) + 1):
            rest = [r for i, r in enumerate(records) if i not in fold]
            others.append(fitted(plant, rest, whole.theta, AGAIN, ENOUGH_AGAIN).theta)
            after += predicted(plant, [records[i] for i in fold], others[-1])
            misfits += misfit(plant, [records[i] for i in fold], np.stack([others[-1], starts[0]]))
            bar.update(done)
    coefficients, physical = intervals(plant, whole, np.array(others))
    before, apart = predicted(plant, records, starts[0]), (float(misfits[0]), float(misfits[1]))
    return WaterFit(plant, records, whole.theta, coefficients, physical, before, after, apart)


def swims(logs: Logs) -> list[str]:
    """Trials in water with a camera, in which the fish beats its tail or was launched.

    Raises LogError: too few of them, or all of one kind.
    """
    names = [name for name, trial in logs.trials.items() if trial.value("medium", "water") == "water" and "pose" in trial.tables]
    records = logs.records(0.02, names) if names else []
    moves = {r.name: r for r in records if np.ptp(r.commands, 0).max() > QUIET or np.abs(r.push).max() > MOVED}
    kinds = {kind_of(r) for r in moves.values()}
    if len(moves) < FEWEST or len(kinds) < KINDS:
        what = f"{len(moves)} swims of {len(kinds)} kinds ({', '.join(sorted(kinds)) or 'none'})"
        raise LogError(
            f"{logs.folder}: water: got {what}, expected {FEWEST} or more of {KINDS} kinds, in water and seen by a camera; record"
            " gaits at two frequencies or amplitudes, turns to both sides, and coasting (excitation in meta.toml names the kind)"
        )
    return list(moves)


def pose_of(record: Record) -> Sensor:
    """The camera's poses. Raises LogError without any."""
    if record.pose is None:
        raise LogError(f"trial {record.name}: no table pose; a water calibration needs the camera's poses")
    return record.pose


def kind_of(record: Record) -> str:
    """Kind of a swim; a swim without a name is its own kind."""
    return record.excitation or record.name


def folded(records: list[Record]) -> list[list[int]]:
    """Indices of the records in each fold; repeats of one experiment share a fold, so that none is known from another."""
    kinds = list(dict.fromkeys(map(kind_of, records)))
    fold_of = {kind: i % FOLDS for i, kind in enumerate(kinds)}
    folds = [[i for i, r in enumerate(records) if fold_of[kind_of(r)] == fold] for fold in range(FOLDS)]
    return [fold for fold in folds if fold]


class Movement(NamedTuple):
    """Rates of one record: the windows of its stamps, the measured rates, and the tolerance of simulated ones."""

    first: np.ndarray  # (W,) first stamp of each window
    counts: np.ndarray  # (W,)
    t: np.ndarray  # (W,) s
    rates: np.ndarray  # (W - 1, 3) measured: ahead, to the left [m/s], yaw rate [rad/s]
    tolerance: np.ndarray  # (W - 1, 3)

    @classmethod
    def of(cls, pose: Sensor) -> "Movement":
        """Rates of a camera's poses."""
        number = np.floor(pose.t / SHORT).astype(int)
        _, first, counts = np.unique(number, return_index=True, return_counts=True)
        blank = cls(first, counts, np.add.reduceat(pose.t, first) / counts, np.empty(0), np.empty(0))
        rates = blank.of_poses(pose.values[None])[0]
        speed, turn = of_movement(*uniform_filter1d(rates, LONG + 1, axis=0, mode="nearest").T)
        return blank._replace(rates=rates, tolerance=np.stack([speed, speed, turn], 1))

    def of_poses(self, poses: np.ndarray) -> np.ndarray:
        """(R, W - 1, 3) rates of poses (R, K, 3) at the record's stamps."""
        mean = np.add.reduceat(poses, self.first, axis=1) / self.counts[:, None]
        dt = np.diff(self.t)[:, None]
        step, yaw = np.diff(mean, axis=1) / dt, 0.5 * (mean[:, 1:, 2] + mean[:, :-1, 2])
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, left = c * step[..., 0] + s * step[..., 1], c * step[..., 1] - s * step[..., 0]
        return np.stack([ahead, left, step[..., 2]], -1)

    def misses(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(R, 3, W - 1) and of means (R, 3, M): measured minus simulated, in tolerances."""
        off = ((self.rates - self.of_poses(poses)) / self.tolerance).transpose(0, 2, 1)
        size = min(LONG, off.shape[2])
        whole = off.shape[2] // size
        return off, off[..., : whole * size].reshape(*off.shape[:2], whole, size).mean(-1)


def misfit(plant: WaterPlant, records: list[Record], thetas: np.ndarray) -> np.ndarray:
    """(R,) squared errors of parameters (R, K) on some records, weighted as in the fit."""
    residual, weight = residual_of(plant, records)
    return np.sum((weight * residual(thetas)) ** 2, 1)


def fitted(plant: WaterPlant, records: list[Record], begin: np.ndarray, rounds: int, enough: float) -> Minimum:
    """The fit to some records, from parameters (K,)."""
    return minimum(plant.parameters(), *residual_of(plant, records), begin, rounds, enough)


def residual_of(plant: WaterPlant, records: list[Record]) -> tuple[Callable, np.ndarray]:
    """Errors (R, M) of parameters (R, K) on some records in tolerances, and their weights (M,)."""
    bare = [r._replace(joint=None, power=None, placed=None, weighed=None) for r in records]
    poses = [pose_of(r) for r in records]
    movements = [Movement.of(pose) for pose in poses]

    def residual(thetas: np.ndarray) -> np.ndarray:
        seen = plant.predict(bare, plant.rows(thetas))
        parts = [part for m, p in zip(movements, seen, strict=True) for part in m.misses(p["pose"])]
        made = np.concatenate([part.reshape(len(thetas), -1) for part in parts], 1)
        return np.nan_to_num(made, nan=FAR, posinf=FAR, neginf=-FAR)

    sizes = [part.size for m, pose in zip(movements, poses, strict=True) for part in m.misses(pose.values[None])]
    return residual, np.repeat(np.tile([1.0 / RATE, 1.0 / MEAN], len(records)), sizes)


def intervals(plant: WaterPlant, whole: Minimum, others: np.ndarray) -> tuple[dict, dict]:
    """Estimates of the coefficients and of the body-level quantities. others: (F, K) fits, each without one fold."""
    parameters = plant.parameters()
    step, prior = np.array([p.step for p in parameters]), np.array([p.sigma for p in parameters])
    free = np.flatnonzero(~whole.held)
    normal = (whole.slopes.T @ whole.slopes + np.diag((step / prior) ** 2))[np.ix_(free, free)]
    noise = np.zeros((len(step), len(step)))
    noise[np.ix_(free, free)] = np.linalg.inv(normal) * np.outer(step[free], step[free])
    rows = np.concatenate([whole.theta[None], whole.theta + np.diag(step), others])
    quantile = float(student.ppf(0.95, len(others) - 1))

    def estimate(name: str, unit: str, values: np.ndarray, low: float = -np.inf, high: float = np.inf) -> ParameterEstimate:
        value, slope, left_out = values[0], (values[1 : 1 + len(step)] - values[0]) / step, values[1 + len(step) :]
        curved = NORMAL * float(np.sqrt(slope @ noise @ slope))
        apart = quantile * float(jackknife_sd(left_out))
        half = float(np.hypot(curved, apart))
        widest = "curvature" if curved > apart else "kinds of swim"
        return ParameterEstimate(
            name, unit, float(value), max(float(value) - half, low), min(float(value) + half, high), half / NORMAL, widest
        )

    coefficients = {
        p.name: estimate(p.name, p.unit, rows[:, k], p.low, p.high)._replace(bound=bound_of(p, float(rows[0, k])))
        for k, p in enumerate(parameters)
    }
    felt = plant.physical(rows)
    least = lambda name: -np.inf if name == "thrust" else 0.0  # drag and added mass are positive
    return coefficients, {name: estimate(name, unit, felt[name], least(name)) for name, unit in PHYSICAL.items()}


def predicted(plant: WaterPlant, records: list[Record], theta: np.ndarray) -> list[HeldOutSwim]:
    """Speed, yaw rate and place of swims, measured and simulated."""
    out = []
    for record, prediction in zip(records, plant.predict(records, plant.rows(theta[None])), strict=True):
        (t, seen, _), made = pose_of(record), prediction["pose"][0]
        (speed, turn), (other, other_turn) = mean_speed_and_yaw_rate(t, seen), mean_speed_and_yaw_rate(t, made)
        place = float(np.hypot(*(made[-1] - seen[-1])[:2]))
        out.append(HeldOutSwim(record.name, kind_of(record), speed, other, turn, other_turn, place))
    return out


def loose_servo(plant: WaterPlant, records: list[Record], theta: np.ndarray) -> str:
    """Warning if the measured joints do not move as far as those of the described servo; "" if they do."""
    seen = plant.predict(records, plant.rows(theta[None]))
    spans = [(r.joint.values.std(), p["joint"][0].std()) for r, p in zip(records, seen, strict=True) if r.joint is not None]
    ratios = [measured / made for measured, made in spans if made > QUIET / 2]
    if not ratios:
        return "no trial has moving joint angles: the described servos could not be checked"
    if abs((ratio := float(np.median(ratios))) - 1.0) <= LOOSE:
        return ""
    moved = f"the joints move {ratio:.2f} times as far as the described servos move them"
    return f"{moved}: run calibrate servo first, or the error goes into the thrust"


# ----------------------------------------------------------------------------------------------------------------------- warnings
# mean relative speed error on unseen swims; robots whose truth is known: 0.04 to 0.06 (docs/search/calibrated_water.md)
POOR = 0.1


def unnamed(trials: Iterable[Trial]) -> list[str]:
    """Note on swims without a named experiment: each counts as its own kind, so that a repeat is predicted from its twin."""
    listed = list(trials)
    if not (count := sum(not trial.value("excitation") for trial in listed)):
        return []
    todo = "so repeats make the result look too good; name them: log import --excitation TRIAL=NAME"
    return [f"excitation not stated by {count} of {len(listed)} swims: each such trial counts as its own kind, {todo}"]


def unmeasured(model: str, out: Path | None = None) -> list[str]:
    """Warning about parameters that the fit relied on but no calibration of the model states; [] if all are stated.

    out: existing fish file, which may state them although the fit did not use it.
    """
    lacking = _unstated(model)
    if not lacking:
        return []
    line = f"relied on {', '.join(lacking)} as described: no calibration block of {model} states them"
    if out and out.is_file() and len(_unstated(out)) < len(lacking):
        return [f"{line}, but {out} does: fit again with --model {shlex.quote(str(out))}"]
    return [f"{line}; run calibrate servo and latency first, and give their file as --model"]


def doubts(found: WaterFit) -> list[str]:
    """Lines on parameters at a bound, numbers that the swims do not tell, and servos that move otherwise than described."""
    held = [f"{e.name} ({e.bound})" for e in found.coefficients.values() if e.bound]
    open_ended = [
        f"{e.name} ({e.low:.3g} to {e.high:.3g} {e.unit})"
        for e in found.physical.values()
        if e.high - e.low > OPEN * abs(e.value)
    ]
    slow = [] if np.isfinite(found.speed_error.value) else [f"no swim is faster than {SLOW:g} m/s, so the speed error is unknown"]
    servo = loose_servo(found.plant, found.records, found.theta)
    return [
        *([f"{len(held)} of {len(found.coefficients)} parameters at a bound: {', '.join(held)}"] if held else []),
        *([f"not identified by these swims (90 % interval wider than the value): {', '.join(open_ended)}"] if open_ended else []),
        *slow,
        *([servo] if servo else []),
    ]


def too_poor(found: WaterFit) -> str:
    """Warning if the mean speed error on unseen swims is above `POOR`; else ""."""
    off = found.speed_error.value
    words = f"too poor to search with: {100 * off:.1f} % mean speed error on unseen swims, above {100 * POOR:g} %"
    return words if off > POOR else ""


def _unstated(model: "str | Path") -> list[str]:
    """Numbers that no block [calibration.*] of a description states."""
    blocks = read_toml(resolve(model)).get("calibration", {})
    stated = {"servo"} if "servo" in blocks else set()
    stated |= {name for verb in ("servo", "latency") for name in blocks.get(verb, {})}
    return [name for name in ("servo", "command_latency", "camera_latency") if name not in stated]
