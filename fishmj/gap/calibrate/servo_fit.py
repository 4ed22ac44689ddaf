"""Servo and command latency from joint angles: torque = clip(kp (c(t - delay) - q), +-T) - kd q' - F sign(q').

Fitted at once on sine, square and impulse in air and water (paper: "tuned to step and transient responses"), every sample at its
own stamp. The forces of water and hull are known to some per cent only: those constants take part with their tolerance.

Latencies two ways: from the clocks alone, and against a model that has the robot's servo and water.

    measured lag = transport + mechanism     `log.timebase.audit` sees only the sum
    model's lag  = mechanism                 same commands, same stamps, same estimator, the fitted servo
    latency      = nominal + mean over trials (measured - model's)

`command` is taken between commands and joints on every trial, `camera` between the first joint and the heading that recoils
against it, on abrupt signals only.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from fishmj.base.errors import LogError
from fishmj.gap.calibrate.calibration_logs import MEDIA, SIGNALS, Logs, angles
from fishmj.gap.calibrate.parameter_fit import Block, FreeParameter, LeastSquaresFit, ParameterEstimate, fit
from fishmj.gap.models.swimming_fish import STAND_CONSTANTS, ServoStand
from fishmj.gap.progress import Bar, Bars, silent_bar
from fishmj.gap.records.records import Record
from fishmj.log.timebase import Audit, audit, lag_between

FREE = ("kp", "kd", "friction", "command_latency")
OPEN = 1.0  # widest 90 % interval of an identified number, relative to it (friction: to the stall torque)
STRAINED = 3.0  # shift of a hull or water constant, in tolerances, above which the model's water is wrong
OUTLIER = 0.1  # of a joint's movement: larger residuals are weighted as outliers (Huber)
UNEXPLAINED, NOISY = 0.15, 10.0  # residual over a joint's movement and over its noise: above both the servo model is wrong
COUNT = np.radians(0.24) / np.sqrt(12.0)  # rad, noise of a joint where none is stated: one count of a hobby servo's encoder
TRIMMED = 0.95  # share of the samples, smallest residuals first, that judge a fit
SWIMS = ("gait", "gait_slow", "gait_fast", "turn_left")
ABRUPT = ("square", "impulse")  # the heading of a steady beat lags by the water's phase, where the model may be wrong


class ServoFit(NamedTuple):
    """The fit on everything, on each medium alone, and its records."""

    plant: ServoStand
    records: list[Record]
    row: np.ndarray
    whole: LeastSquaresFit
    alone: dict[str, LeastSquaresFit]

    @property
    def estimates(self) -> dict[str, ParameterEstimate]:
        """Estimates of the free servo parameters by name."""
        return {name: self.whole.estimates[name] for name in FREE}

    @property
    def hull(self) -> list[dict]:
        """Constants of hull and water, factors: shift of each in tolerances, and its bound if it lies there."""
        found = [(self.whole.estimates[c.name], c.sigma) for c in STAND_CONSTANTS[2:]]
        return [
            {"constant": e.name, "factor": e.value, "tolerance": s, "off by": abs(e.value - 1.0) / s, "at bound": e.bound}
            for e, s in found
        ]

    @property
    def words(self) -> str:
        """Text on the constants that were pushed too far; empty if there is none."""
        far = [f"{row['constant']} {row['factor']:.2f}" for row in self.hull if row["off by"] > STRAINED]
        return f"the fit needs hull or water constants far from the described ones: {', '.join(far)} times these" if far else ""


class BadFit(LogError):
    """A fit that must not be used. found: the fit, as evidence."""

    def __init__(self, message: str, found: ServoFit):
        super().__init__(message)
        self.found = found


def calibrate(logs: Logs, plant: ServoStand, *, alone: bool = True, bars: Bars = silent_bar) -> ServoFit:
    """Fits kp, kd, friction and command latency to the bench trials of `logs`.

    Args:
        alone: also fit air and water separately: a disagreement of two media is a missing effect. bars: of the fits.

    Raises:
        LogError: too few trials with joint angles and moving commands. BadFit: they leave a number undetermined, or the fit
            leaves more of a joint's movement than its noise explains.
    """
    records = logs.records(plant.dt, logs.bench())
    media = [m for m in MEDIA if any(r.medium == m for r in records)] if alone else []
    sets = {"": records} | {m: [r for r in records if r.medium == m] for m in media if len(media) > 1}
    fits = {}
    with bars(len(sets), "servo", "fits") as bar:
        for i, (medium, part) in enumerate(sets.items()):
            fits[medium] = fitted(plant, part, bar, i)
    whole, apart = fits.pop(""), fits
    found = ServoFit(plant, records, row_of(plant, whole.theta), whole, apart)
    if left := unexplained(records, whole.after):
        more = f"; and {len(left) - 3} more" if left[3:] else ""
        raise BadFit(
            f"{logs.folder}: no parameters of the model's servo explain {'; '.join(left[:3])}{more}."
            " Check those readings and commands (fishmj log check), or give the right --model",
            found,
        )
    if left := open_numbers(plant, whole.estimates):
        lacking = [m for m in MEDIA if not any(r.medium == m for r in records)]
        more = f" in {lacking[0]} as well" if lacking else " in air and in water, three times each"
        raise BadFit(
            f"{logs.folder}: {len(records)} trials do not identify {'; '.join(left)}. "
            f"Record {', '.join(SIGNALS)}{more}, with amplitudes that move the joints",
            found,
        )
    return found


def unexplained(records: list[Record], after: np.ndarray) -> list[str]:
    """Joints and trials whose movement the fit does not explain, the worst first. after: (m,) rad, the residual of the fit."""
    found, begin = [], 0
    for record in records:
        seen = angles(record)
        for j, (column, sigma) in enumerate(zip(seen.values.T, seen.sigma, strict=True), 1):
            off = np.sort(np.abs(after[begin : begin + len(column)]))
            left = float(np.sqrt(np.mean(off[: max(round(TRIMMED * len(off)), 1)] ** 2)))
            moved, noise = float(np.std(column)), float(sigma) if sigma > 0 else COUNT
            if left > max(UNEXPLAINED * moved, NOISY * noise):
                sentence = f"j{j} of trial {record.name} ({np.degrees(left):.2g} deg RMS left of {np.degrees(moved):.2g},"
                found.append((left / moved, f"{sentence} {left / noise:.0f} times its noise)"))
            begin += len(column)
    return [text for _, text in sorted(found, reverse=True)]


def parameters(plant: ServoStand) -> list[FreeParameter]:
    """Free parameters, and the hull's constants within their tolerance."""
    s, late = plant.robot.servo, plant.latency
    free = [
        FreeParameter("kp", "N m/rad", s.kp, 0.02 * s.kp, 0.1 * s.kp, 10 * s.kp),
        FreeParameter("kd", "N m s/rad", s.kb + s.kv, 0.02 * s.kb, 0.1 * s.kb, 10 * s.kb),
        FreeParameter("friction", "N m", 0.01, 0.002, 0.0, s.torque),
        FreeParameter("command_latency", "s", late, plant.dt, 0.0, late + 0.25),
    ]
    return free + [FreeParameter(c.name, "factor", 1.0, 0.02, 0.3, 3.0, c.sigma) for c in STAND_CONSTANTS[2:]]


def open_numbers(plant: ServoStand, estimates: dict[str, ParameterEstimate]) -> list[str]:
    """Free parameters that the trials leave undetermined: an interval as wide as the number, or one at its bound."""
    out = []
    for p in (p for p in parameters(plant) if p.name in FREE):
        e = estimates[p.name]
        scale = plant.robot.servo.torque if p.name == "friction" else abs(e.value)
        if e.high - e.low > OPEN * scale or e.value >= p.high or (e.value <= p.low and p.name != "friction"):
            out.append(f"{p.name} ({e.low:.3g} to {e.high:.3g} {e.unit}, searched in {p.low:.3g} to {p.high:.3g})")
    return out


def row_of(plant: ServoStand, theta) -> np.ndarray:
    """The plant's row for fitted parameters (K,)."""
    row = plant.null.copy()
    row[[plant.place("kp"), plant.place("kd")]] = theta[:2]
    row[plant.index("coulomb_friction", "torque")] = theta[2]
    row[plant.index("command_latency", "delay")] = theta[3] - plant.latency
    row[[plant.place(c.name) for c in STAND_CONSTANTS[2:]]] = theta[4:]
    return row


def fitted(plant: ServoStand, records: list[Record], bar: Bar, before: int) -> LeastSquaresFit:
    """The fit on some records. bar: of all fits; before: number of finished ones."""
    blocks, size = [], 0
    for record in records:
        for column in angles(record).values.T:
            where = slice(size, size + len(column))
            outlier = max(OUTLIER * float(np.std(column)), NOISY * COUNT)
            blocks.append(Block(record.name, f"{record.excitation} {record.medium}", where, outlier=outlier))
            size = where.stop

    def residual(thetas: np.ndarray) -> np.ndarray:
        predicted = plant.predict(records, np.array([row_of(plant, theta) for theta in thetas]))
        parts = [(angles(r).values - p["joint"]).transpose(0, 2, 1) for r, p in zip(records, predicted, strict=True)]
        return np.concatenate([part.reshape(len(thetas), -1) for part in parts], 1)

    return fit(parameters(plant), residual, blocks, lambda share: bar.update(before + share))


class LatencyRow(NamedTuple):
    """One trial: lags in s, NaN if none was found."""

    trial: str
    path: str  # command or camera
    measured: float
    model: float


class LatencyEstimates(NamedTuple):
    """Estimates by name, the trials behind them, and the audits."""

    estimates: dict[str, ParameterEstimate]
    rows: list[LatencyRow]
    audits: dict[str, Audit]


def calibrate_latency(logs: Logs, servo: ServoFit) -> LatencyEstimates:
    """Both latencies from the bench and the swims. Raises LogError: no lag was found on any trial."""
    names = [*logs.bench(), *logs.of("water", SWIMS)]
    records = logs.records(servo.plant.dt, names)
    predicted = servo.plant.predict(records, servo.row)
    rows = [row for r, p in zip(records, predicted, strict=True) for row in _rows(r, p)]
    plant = servo.plant
    fitted = servo.estimates["command_latency"]
    found = {"command_latency": _mean(rows, "command", "command_latency", fitted.value)}
    if any(row.path == "camera" for row in rows):
        found["camera_latency"] = _mean(rows, "camera", "camera_latency", plant.camera)
    return LatencyEstimates(found, rows, {name: audit(logs.trials[name]) for name in names})


def _rows(record: Record, predicted: dict) -> list[LatencyRow]:
    """Command and camera lag of one trial, measured and by the model."""
    out, joint, pose = [], record.joint, record.pose
    sent = np.arange(len(record.commands)) * record.dt
    pairs = []
    if joint is not None:
        now = (joint.values, predicted["joint"][0])
        pairs.append(("command", [((sent, record.commands), (joint.t, values)) for values in now], False))
        if pose is not None and record.excitation in ABRUPT:
            seen = (pose.values[:, 2:], predicted["pose"][0, :, 2:])
            ends = zip(now, seen, strict=True)
            pairs.append(("camera", [((joint.t, j[:, :1]), (pose.t, yaw)) for j, yaw in ends], True))
    for path, cases, either in pairs:
        try:
            lags = [lag_between((path, *a), (path, *b), either_sign=either).lag for a, b in cases]
        except LogError:
            continue
        out.append(LatencyRow(record.name, path, *map(float, lags)))
    return out


def _mean(rows: list[LatencyRow], path: str, name: str, nominal: float) -> ParameterEstimate:
    """Mean excess over the model's lag, with the trials' scatter."""
    more = np.array([row.measured - row.model for row in rows if row.path == path])
    if len(more) < 2:
        raise LogError(f"{name}: {len(more)} trials show a lag; record sine, square or impulse at least twice")
    sd = float(more.std(ddof=1) / np.sqrt(len(more)))
    half, value = float(student.ppf(0.95, len(more) - 1)) * sd, nominal + float(np.median(more))
    return ParameterEstimate(name, "s", value, max(value - half, 0.0), value + half, sd, "trials")
