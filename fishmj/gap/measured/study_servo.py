"""Study of one servo and its load: compares free runs from measured starts with the logged angle, at the log's stamps."""

from collections.abc import Sequence

import numpy as np

from fishmj.base.errors import LogError
from fishmj.gap.measured.servo_model import DT, Pendulum, PendulumLog
from fishmj.gap.measured.study_logs import Log, Series
from fishmj.gap.measured.study_schema import StudyInput
from fishmj.gap.records.records import Sensor
from fishmj.log.limits import bare

UNSATURATED = 0.9  # share of the largest duty in the logs
START = 0.05  # s around the start of a run, for its rate if the log has none
FINE = 1e-3  # s, largest step
LEAST = 5  # least rows below the largest duty for a gain


def rig(study: StudyInput) -> Pendulum:
    """Load and supply."""
    nominal = study.given.nominal
    return Pendulum(mass=nominal["mass"], length=nominal["length"], voltage=nominal["voltage"])


def noise(study: StudyInput) -> tuple[float, float]:
    """(standard deviation [rad], its square) of one reading, rounding to a count included."""
    n = study.given.noise
    square = n.angle**2 + n.resolution**2 / 12
    return (n.resolution / np.sqrt(12) if not n.angle else float(np.sqrt(square))), square


def step(study: StudyInput, logs: Sequence[Log]) -> float:
    """Step of the model, s: DT for rows as logged, else an integer fraction of the median row, at most FINE."""
    if study.given.prediction.as_logged:
        return DT
    row = float(np.median(np.concatenate([np.diff(log.series["angle"].t) for log in logs])))
    return row / np.ceil(row / FINE)


def records(study: StudyInput, logs: Sequence[Log], groups: Sequence[str], dt: float) -> list[PendulumLog]:
    """Records of all logs, whole or in runs of the horizon. Raises LogError: neither study nor log determines the gain."""
    nominal = study.given.nominal
    lacking = [log.where for log in logs if "duty" not in log.series]
    if lacking and not ("gain" in nominal and "duty" in nominal):
        raise LogError(
            f"{lacking[0]}: has no duty, and [nominal] not both gain (duty per rad of error) and duty (the largest, at most 1); "
            "give the column or the two numbers"
        )
    most = nominal.get("duty") or max(float(np.abs(log.series["duty"].values).max()) for log in logs)
    if not most > 0:
        raise LogError(f"{study.where}: the duty is 0 in all logs, expected a servo that was driven")
    whole = [_log(study, log, group, most, dt) for log, group in zip(logs, groups, strict=True)]
    return [piece for log, r in zip(logs, whole, strict=True) for piece in _pieces(study, log, r)]


def _gain(study: StudyInput, log: Log, most: float) -> float:
    """Duty per rad of error."""
    if "gain" in study.given.nominal:
        return study.given.nominal["gain"]
    goal, angle, duty = (log.series[k] for k in ("goal", "angle", "duty"))
    error = _at(goal, angle.t) - angle.values
    inside = (_on(log, angle.t) > 0) & (np.abs(_at(duty, angle.t)) < UNSATURATED * most)
    power = float(error[inside] @ error[inside])
    if inside.sum() < LEAST or not power > 0:
        raise LogError(
            f"{log.where}: {int(inside.sum())} rows with the torque on and a duty below {UNSATURATED:.0%} of the largest "
            f"({most:.3g}), expected {LEAST} with an error of the angle; the gain cannot be determined: is duty from -1 to 1, "
            "goal in the unit of angle? Or give [nominal] gain in duty per rad"
        )
    gain = float(error[inside] @ _at(duty, angle.t)[inside] / power)
    if not gain > 0:
        raise LogError(
            f"{log.where}: the duty falls where the goal is ahead (gain {gain:.3g} per rad), expected it to rise; "
            'turn a sign in [columns], such as duty = { column = "...", sign = -1 }'
        )
    return gain


def _at(s: Series, t: np.ndarray) -> np.ndarray:
    """Values at stamps t, interpolated unless the stamps are identical."""
    return s.values if s.t is t or np.array_equal(s.t, t) else np.interp(t, s.t, s.values)


def _on(log: Log, t: np.ndarray) -> np.ndarray:
    return np.ones(len(t)) if "on" not in log.series else _at(log.series["on"], t)


def _log(study: StudyInput, log: Log, group: str, most: float, dt: float) -> PendulumLog:
    """Whole log at the plant's steps. most: largest duty that the firmware sets."""
    goal, angle = log.series["goal"], log.series["angle"]
    begin = float(goal.t[0])
    gain = _gain(study, log, most)
    steps = int(np.ceil((angle.t[-1] - begin) / dt)) + 1
    i = np.maximum(np.searchsorted(goal.t - begin, np.arange(steps) * dt + 1e-9, side="right") - 1, 0)
    on = _on(log, goal.t) > 0
    volts = _at(log.series["volts"], goal.t) if "volts" in log.series else np.full(len(goal.t), study.given.nominal["voltage"])
    held = [goal.values[i], on[i].astype(float), volts[i], np.full(steps, gain), np.full(steps, most)]
    keep = angle.t >= begin
    if keep.sum() < LEAST:
        raise LogError(
            f"{log.where}: {int(keep.sum())} angles after the first goal, expected {LEAST}; do both have the same time zero?"
        )
    return PendulumLog(
        name=log.name,
        group=group,
        dt=dt,
        commands=np.stack(held, 1),
        joint=Sensor(angle.t[keep] - begin, angle.values[keep][:, None], np.array([noise(study)[0]])),
        start=(float(angle.values[keep][0]), _rate(log, int(np.argmax(keep)))),
        session=0.0,
    )


def _rate(log: Log, row: int) -> float:
    """Rate at a row: as logged, else the slope of a parabola through the rows around it; zero at the first row."""
    angle = log.series["angle"]
    if "rate" in log.series:
        return float(_at(log.series["rate"], angle.t)[row])
    near = np.flatnonzero(np.abs(angle.t - angle.t[row]) <= 0.5 * START)
    if row == 0 or len(near) < 3:
        return 0.0
    return float(np.polyfit(angle.t[near] - angle.t[row], angle.values[near], 2)[1])


def _pieces(study: StudyInput, log: Log, r: PendulumLog) -> list[PendulumLog]:
    """Splits a log into runs of the horizon; drops the rest at the end."""
    span = study.given.prediction.horizon
    if not span or span >= r.joint.t[-1]:
        return [r]
    offset = float(log.series["goal"].t[0])
    out = []
    for k in range(int(r.joint.t[-1] / span + 1e-9)):
        first, last = (int(np.searchsorted(r.joint.t, x)) for x in (k * span, (k + 1) * span))
        if last - first < LEAST:
            raise LogError(
                f"{bare(log.where, 200)}: fewer than {LEAST} rows in the run from {k * span:.4g} s; lengthen [prediction] horizon"
            )
        t0 = r.joint.t[first]
        step = int(t0 / r.dt + 1e-9)
        row = int(np.searchsorted(log.series["angle"].t - offset, t0))
        sensor = Sensor(r.joint.t[first:last] - t0, r.joint.values[first:last], r.joint.sigma)
        steps = int(np.ceil(sensor.t[-1] / r.dt)) + 1
        start = (float(sensor.values[0, 0]), _rate(log, row))
        out.append(
            r._replace(
                name=f"{r.name} {k + 1}", commands=r.commands[step : step + steps], joint=sensor, start=start, session=float(t0)
            )
        )
    return out
