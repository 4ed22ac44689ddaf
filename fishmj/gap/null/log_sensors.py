"""Applies the sensors of the logs to the second robot, so that null fish are measured like the logged one.

    noise      `sigma` of meta.toml if it states one: columns of the tables; `start` [m] and `start_yaw` [rad], the error of
               placing the fish at its start
    moments    if a sensor's row count does not match the robot's own rate (another rate, lost rows), null fish are sampled at
               the log's time stamps

Logs with the second robot's own noise and rates change nothing, to the last bit.
"""

import hashlib
from typing import NamedTuple

import numpy as np

from fishmj.gap.records.records import Record
from fishmj.mjcf.description import Robot

ALIKE = 1e-3  # relative difference up to which a noise counts as the second robot's own
ROWS = 0.05  # share of surplus or missing rows up to which a sensor has its own rate
SENSORS = ("joint", "pose", "power")
LEAST = 1e-9  # rad, of a count


class LogSensors(NamedTuple):
    """fields: of the second robot's constants, by dotted name, SI. stamps: sensor -> times (K,) s of its readings."""

    fields: dict[str, float]
    stamps: dict[str, np.ndarray]

    @property
    def key(self) -> list:
        """Settings that determine null runs, for a hash; empty if the logs have the second robot's own sensors."""
        read = {name: hashlib.sha256(t.tobytes()).hexdigest()[:16] for name, t in sorted(self.stamps.items())}
        return [sorted(self.fields.items()), read] if self.fields or read else []


def log_sensors(record: Record, robot: Robot, noise: float) -> LogSensors:
    """Sensor settings of a record. noise: factor on the second robot's own, unless the record states it."""
    from fishmj.gap.laboratory.virtual_robot.robot_constants import nominal
    from fishmj.gap.laboratory.virtual_robot.trials import sigmas

    made = nominal(robot)
    usual, stated, factor = sigmas(made, noise), record.stated, max(noise, LEAST)
    fields: dict[str, float] = {}

    def told(*columns: str) -> float:
        """Root mean square of the stated noise of columns; NaN if none is stated or it is the usual value."""
        known = [stated[c] for c in columns if c in stated]
        rms = float(np.sqrt(np.mean(np.square(known)))) if known else np.nan
        return np.nan if abs(rms - usual[columns[0]]) <= ALIKE * usual[columns[0]] else rms

    names = {
        "camera.position_noise": ("x", "y"),
        "camera.heading_noise": ("yaw",),
        "meter.voltage_noise": ("V",),
        "meter.current_noise": ("I",),
        "placing.position": ("start",),
        "placing.heading": ("start_yaw",),
    }
    for field, columns in names.items():
        if np.isfinite(sigma := told(*columns)):
            fields[field] = sigma / factor
    if np.isfinite(sigma := told(*(f"j{j + 1}" for j in range(robot.n_joints)))):
        step = min(made.network.angle_step, sigma * np.sqrt(12.0))  # the stated noise includes the encoder's counts
        fields["network.angle_step"] = max(step, LEAST)
        fields["network.angle_noise"] = float(np.sqrt(max(sigma**2 - step**2 / 12.0, 0.0))) / factor
    periods = {"joint": made.network.period, "pose": made.camera.period, "power": made.meter.period}
    stamps = {name: t for name in SENSORS if (t := _other_rate(record, name, periods[name])) is not None}
    jitter = {"joint": "network.stamp_jitter", "pose": "camera.jitter"}
    fields |= {field: 0.0 for name, field in jitter.items() if name in stamps}  # the log's stamps contain its jitter already
    return LogSensors(fields, stamps)


def _other_rate(record: Record, name: str, period: float) -> np.ndarray | None:
    """Stamps (K,) of a sensor whose row count does not match the period [s]; None if it matches or there are too few rows."""
    sensor = getattr(record, name)
    if sensor is None or len(sensor.t) < 2:
        return None
    rows = (len(sensor.t) - 1) * period / max(float(sensor.t[-1] - sensor.t[0]), period)
    return None if abs(rows - 1.0) <= ROWS else np.asarray(sensor.t, float)
