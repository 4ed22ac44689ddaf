"""Water from free swims: the coefficients of the strips with which the described fish swims as the logged one did.

    rates    velocity ahead, to the left, and yaw rate of the body over 0.2 s, and their means over 2 s
    r        (measured - simulated) / tolerance, whole free runs from the start pose
    theta*   by least squares; a mean counts as much as `RATE`^2 of its rates, whose error is mostly the beat's: it hides a
             mean that is wrong by a tenth

Coefficients stand in for each other: a fish cannot tell drag from thrust at one speed, and no strip is the real water. So what is
told are quantities that the body feels (water_plant.physical) with intervals, and how wrong the fish still is on swims that the
fit has not seen: the kinds of swim lie in folds, each is predicted by a fit to the others. Servo and latencies are taken as they
are described: calibrate them first.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from fishmj.calibrate.calibration_logs import QUIET, Logs
from fishmj.calibrate.least_squares import Block, LeastSquaresFit, ParameterEstimate, derived, fit
from fishmj.calibrate.water_plant import PHYSICAL, WaterPlant, physical
from fishmj.errors import LogError
from fishmj.gap.records.movement import pace
from fishmj.gap.records.records import Record, Sensor
from fishmj.gap.watch import Bars, silent
from fishmj.hydro_fit.fit.tolerance import of_movement

SHORT, LONG = 0.2, 10  # s over which places are averaged; rates of a mean
RATE, MEAN = 4.0, 1.0  # tolerances that a rate, and a mean, may be off by
FOLDS = 5
FEWEST = 4  # swims: with fewer nothing can be left out
KINDS = 3  # kinds of swim (`excitation`) at least, or one gait's thrust and drag stand in for each other
SLOW = 0.05  # m/s: below it a relative error of speed means nothing
LOOSE = 0.03  # of an amplitude: a fish's speed goes with it
FAR = 1e3  # tolerances of a fish that a coefficient too far has lost
MOVED = 0.05  # m/s or rad/s of a push


class HeldOut(NamedTuple):
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
        """Relative; NaN of a fish that hardly moves."""
        return abs(self.simulated / self.speed - 1.0) if self.speed > SLOW else np.nan


class WaterFit(NamedTuple):
    """The fit to all swims, what it says of the body, and how it does on swims left out, before and after."""

    plant: WaterPlant
    records: list[Record]
    whole: LeastSquaresFit
    physical: dict[str, ParameterEstimate]
    before: list[HeldOut]
    after: list[HeldOut]

    @property
    def water(self) -> dict:
        """The `[water]` table of a description."""
        c = self.plant.water([float(value) for value in self.whole.theta])
        angles = {f"{key}_deg": float(np.degrees(getattr(c, key))) for key in ("stall_angle", "stall_width")}
        return {key: value for key, value in c._asdict().items() if f"{key}_deg" not in angles} | angles

    @property
    def speed_error(self) -> ParameterEstimate:
        """Of swims that the fit has not seen, relative: mean, least and worst."""
        errors = np.array([swim.speed_error for swim in self.after])
        errors = errors[np.isfinite(errors)] if np.isfinite(errors).any() else np.full(1, np.nan)
        mean, least, worst = (float(f(errors)) for f in (np.mean, np.min, np.max))
        return ParameterEstimate("speed_error", "share", mean, least, worst, float(errors.std()), "swims")


def calibrate(logs: Logs, plant: WaterPlant, *, bars: Bars = silent) -> WaterFit:
    """Fit the water to the free swims of `logs`.

    Raises:
        LogError: too few swims or kinds of swim.
    """
    records = logs.records(plant.dt, swims(logs))
    folds = folded(records)
    with bars(1 + len(folds), "water", "fits") as bar:
        whole = fitted(plant, records, lambda share: bar.update(share))
        after: list[HeldOut] = []
        for done, fold in enumerate(folds, 1):
            rest = [r for i, r in enumerate(records) if i not in fold]
            theta = fitted(plant, rest, lambda share, done=done: bar.update(done + share)).theta
            after += predicted(plant, [records[i] for i in fold], theta)
    start = np.array([p.start for p in plant.parameters()])
    return WaterFit(plant, records, whole, quantities(plant, whole), predicted(plant, records, start), after)


def swims(logs: Logs) -> list[str]:
    """Trials in water that a camera saw, in which the fish beat its tail or was let go.

    Raises:
        LogError: too few of them, or all of one kind.
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
    """What the camera saw. Raises LogError where there is none."""
    if record.pose is None:
        raise LogError(f"trial {record.name}: no table pose; water is calibrated by how the fish moves")
    return record.pose


def kind_of(record: Record) -> str:
    """What was swum; a swim without a name is a kind of its own."""
    return record.excitation or record.name


def folded(records: list[Record]) -> list[list[int]]:
    """Numbers of the records in each fold; repeats of one experiment lie in one, or a swim would be known beforehand."""
    kinds = list(dict.fromkeys(map(kind_of, records)))
    fold_of = {kind: i % FOLDS for i, kind in enumerate(kinds)}
    folds = [[i for i, r in enumerate(records) if fold_of[kind_of(r)] == fold] for fold in range(FOLDS)]
    return [fold for fold in folds if fold]


class Movement(NamedTuple):
    """How the rates of one record are taken: the windows of its stamps, and what its fish may be off by."""

    first: np.ndarray  # (W,) first stamp of each window
    counts: np.ndarray  # (W,)
    t: np.ndarray  # (W,) s
    rates: np.ndarray  # (W - 1, 3) measured: ahead, to the left [m/s], yaw rate [rad/s]
    tolerance: np.ndarray  # (W - 1, 3)

    @classmethod
    def of(cls, pose: Sensor) -> "Movement":
        """Of what a camera saw."""
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


def fitted(plant: WaterPlant, records: list[Record], tick) -> LeastSquaresFit:
    """The fit to some records."""
    bare = [r._replace(joint=None, power=None, placed=None, weighed=None) for r in records]
    poses = [pose_of(r) for r in records]
    movements = [Movement.of(pose) for pose in poses]

    def residual(thetas: np.ndarray) -> np.ndarray:
        seen = plant.predict(bare, plant.rows(thetas))
        parts = [part for m, p in zip(movements, seen, strict=True) for part in m.misses(p["pose"])]
        made = np.concatenate([part.reshape(len(thetas), -1) for part in parts], 1)
        return np.nan_to_num(made, nan=FAR, posinf=FAR, neginf=-FAR)

    blocks, size = [], 0
    for record, pose, m in zip(bare, poses, movements, strict=True):
        for part, sigma in zip(m.misses(pose.values[None]), (RATE, MEAN), strict=True):
            for _ in range(3):
                where = slice(size, size + part.shape[2])
                blocks.append(Block(record.name, kind_of(record), where, sigma))
                size = where.stop
    parameters = plant.parameters()
    first = fit(parameters, residual, blocks, lambda share: tick(0.5 * share))
    return fit(parameters, residual, robust(blocks, first.after), lambda share: tick(0.5 + 0.5 * share), first.theta)


def robust(blocks: list[Block], misses: np.ndarray) -> list[Block]:
    """The same, each kind of swim with the less weight the further the first fit has missed it, beyond what is usual.

    A kind whose forces the strips have no form for would else spoil what they can tell.
    """
    off: dict[str, list[np.ndarray]] = {}
    for b in blocks:
        if b.sigma == MEAN:
            off.setdefault(b.group, []).append(misses[b.where])
    rms = {kind: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for kind, parts in off.items()}
    usual = float(np.median(list(rms.values())))
    return [b._replace(sigma=(b.sigma or MEAN) * max(1.0, rms[b.group] / max(usual, 1e-9)) ** 2) for b in blocks]


def quantities(plant: WaterPlant, found: LeastSquaresFit) -> dict[str, ParameterEstimate]:
    """What the water does to the body, with intervals."""
    steps = np.array([p.step for p in plant.parameters()])

    def of(name: str):
        return lambda rows: physical(plant.chain, plant.nominal._replace(water=plant.water(list(rows.T))))[name]

    return {name: derived(found, name, unit, of(name), steps) for name, unit in PHYSICAL.items()}


def predicted(plant: WaterPlant, records: list[Record], theta: np.ndarray) -> list[HeldOut]:
    """Speed, yaw rate and place of swims, measured and simulated."""
    out = []
    for record, prediction in zip(records, plant.predict(records, plant.rows(theta[None])), strict=True):
        (t, seen, _), made = pose_of(record), prediction["pose"][0]
        (speed, turn), (other, other_turn) = pace(t, seen), pace(t, made)
        place = float(np.hypot(*(made[-1] - seen[-1])[:2]))
        out.append(HeldOut(record.name, kind_of(record), speed, other, turn, other_turn, place))
    return out


def loose_servo(plant: WaterPlant, records: list[Record], theta: np.ndarray) -> str:
    """What to say where the measured joints do not move as far as the described servo moves them; "" where they do."""
    seen = plant.predict(records, plant.rows(theta[None]))
    spans = [(r.joint.values.std(), p["joint"][0].std()) for r, p in zip(records, seen, strict=True) if r.joint is not None]
    ratios = [measured / made for measured, made in spans if made > QUIET / 2]
    if not ratios:
        return "no trial has joint angles that move: whether the servos move as they are described is not known"
    if abs((ratio := float(np.median(ratios))) - 1.0) <= LOOSE:
        return ""
    moved = f"the joints move {ratio:.2f} times as far as the described servos move them"
    return f"{moved}: run calibrate servo first, or thrust takes the blame"
