"""Fits the second robot, which makes the null runs, to the searched model and to the logs.

Its water is scaled until its fish swims like the questioned model's.

    s* = argmin sum_k ((v_k(s) - v_k) / tolerance)^2 + sum (ln s / WIDE)^2        v: speed and yaw rate of `SWIMS`

A model with calibrated water (`fishmj calibrate water` states `[water] model = "structured"`) swims like the logged fish. The
second robot in its own water does not: its speed is off by tens of per cent, which makes a useless null. Four scales correct that
and keep the second robot's equations, so what remains is the difference of two forms of water calibrated to one fish. A
description with literature values is not scaled, because the second robot's water has such values too.

Its sensors are those of the logs, so that null fish are measured like the logged one.

    noise      `sigma` of meta.toml if it states one: columns of the tables; `start` [m] and `start_yaw` [rad], the error of
               placing the fish at its start
    moments    if a sensor's row count does not match the robot's own rate (another rate, lost rows), null fish are sampled at
               the log's time stamps

Logs with the second robot's own noise and rates change nothing, to the last bit.
"""

import hashlib
from collections.abc import Callable
from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from fishmj.gap.laboratory.virtual_robot.robot_constants import AS_IT_IS, WaterScales, nominal
from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.records import Record, mean_speed_and_yaw_rate, record_of
from fishmj.log import excitation
from fishmj.mjcf.description import Robot
from fishmj.water.choice import STRUCTURED
from fishmj.water.dynamics.tolerance import of_movement

SWIMS = ("gait", "gait_slow", "gait_fast", "gait_small", "turn_left", "tow_ahead", "tow_sideways")
WIDE = 0.7  # prior standard deviation of ln s (chosen: a factor of two)
STEP, ROUNDS = 0.05, 8  # difference of ln s for slopes; largest number of iterations


def scales_for(model, bars: Bars = silent_bar) -> WaterScales:
    """Scales for a searched model, found once per process; unit scales if its water was never calibrated."""
    key = repr(model.robot)
    if model.robot.water.get("model") != STRUCTURED:
        return AS_IT_IS
    if key not in _known:
        with bars(ROUNDS * (1 + len(AS_IT_IS)), "second robot's water", "swims") as bar:
            _known[key] = matched(model, bar.update)
    return _known[key]


_known: dict[str, WaterScales] = {}


def matched(model, tick: Callable[[int], None] = lambda done: None) -> WaterScales:
    """Scales by which the second robot swims like the model without its listed effects. tick: number of finished sets."""
    records, done = swim_second_robot(model.robot, AS_IT_IS, model.dt), count(1)
    shown = model.predict(records, getattr(model, "nothing", model.null))
    wanted = [mean_speed_and_yaw_rate(r.pose.t, p["pose"][0]) for r, p in zip(records, shown, strict=True)]

    def off(logs: np.ndarray) -> np.ndarray:
        out = list(logs / WIDE)
        for record, (speed, turn) in zip(
            swim_second_robot(model.robot, WaterScales(*np.exp(logs)), model.dt), wanted, strict=True
        ):
            mine, tolerance = mean_speed_and_yaw_rate(record.pose.t, record.pose.values), of_movement(speed, 0.0, turn)
            out += [(mine[0] - speed) / tolerance[0], (mine[1] - turn) / tolerance[1]]
        tick(next(done))
        return np.array(out)

    found = least_squares(off, np.zeros(len(AS_IT_IS)), diff_step=STEP, x_scale=WIDE, max_nfev=ROUNDS)
    return WaterScales(*np.exp(found.x).tolist())


def swim_second_robot(robot: Robot, scales: WaterScales, dt: float) -> list:
    """Records of the second robot on `SWIMS`, without noise and with its nominal constants."""
    from fishmj.gap.laboratory.virtual_robot.trials import trial_of

    made, out = nominal(robot, scales=scales), []
    for name in SWIMS:
        what = excitation.get(name, robot.n_joints)
        out.append(record_of(trial_of(made, what, 0, 0, 0.0, name, "", (0.0, 0.0)), dt))
    return out


# ------------------------------------------------------------------------------------------------------------ sensors of the logs
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
