"""Latencies two ways: from the clocks alone, and against a model that has the robot's servo and water.

    measured lag = transport + mechanism     `log.timebase.audit` sees only the sum
    model's lag  = mechanism                 same commands, same stamps, same estimator, the fitted servo
    latency      = nominal + mean over trials (measured - model's)

`command` is taken between commands and joints on every trial, `camera` between the first joint and the heading that recoils
against it, on abrupt signals only.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from fishmj.calibrate.calibration_logs import Logs
from fishmj.calibrate.least_squares import ParameterEstimate
from fishmj.calibrate.servo_fit import ServoFit
from fishmj.errors import LogError
from fishmj.gap.records.records import Record
from fishmj.log.delay import lag_between
from fishmj.log.timebase import Audit, audit

SWIMS = ("gait", "gait_slow", "gait_fast", "turn_left")
ABRUPT = ("square", "impulse")  # the heading of a steady beat lags by the water's phase, which is the model's to get wrong


class LatencyRow(NamedTuple):
    """One trial: lags in s, NaN where none could be told."""

    trial: str
    path: str  # command or camera
    measured: float
    model: float

    @property
    def more(self) -> float:
        """What the robot has beyond the model."""
        return self.measured - self.model


class Latencies(NamedTuple):
    """Estimates by name, the trials behind them, and the audits."""

    estimates: dict[str, ParameterEstimate]
    rows: list[LatencyRow]
    audits: dict[str, Audit]


def calibrate(logs: Logs, servo: ServoFit) -> Latencies:
    """Both latencies from the bench and the swims.

    Raises:
        LogError: no lag could be told on any trial.
    """
    names = [*logs.bench(), *logs.of("water", SWIMS)]
    records = logs.records(servo.plant.dt, names)
    predicted = servo.plant.predict(records, servo.row)
    rows = [row for r, p in zip(records, predicted, strict=True) for row in _rows(r, p)]
    plant = servo.plant
    fitted = servo.estimates["command_latency"]
    found = {"command_latency": _mean(rows, "command", "command_latency", fitted.value)}
    if any(row.path == "camera" for row in rows):
        found["camera_latency"] = _mean(rows, "camera", "camera_latency", plant.camera)
    return Latencies(found, rows, {name: audit(logs.trials[name]) for name in names})


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
    """Mean of what is more than the model's, with the trials' scatter."""
    more = np.array([row.more for row in rows if row.path == path])
    if len(more) < 2:
        raise LogError(f"{name}: {len(more)} trials show a lag; record sine, square or impulse at least twice")
    sd = float(more.std(ddof=1) / np.sqrt(len(more)))
    half, value = float(student.ppf(0.95, len(more) - 1)) * sd, nominal + float(np.median(more))
    return ParameterEstimate(name, "s", value, max(value - half, 0.0), value + half, sd, "trials")
