"""Camera above the tank and meter in the battery lead.

marker      p = (X, Y) + R(yaw) (d, 0)                        position of the marker
lens        p (1 + k1 |p|^2),  then scale, then turned by the mounting angle
stamp       t = exposure + latency, on the camera's own clock t drift + offset
velocity    slope of a straight line through the last frames, then an optional low-pass
"""

import numpy as np

from fishmj.gap.laboratory.virtual_robot.constant_groups import CameraConstants, MeterConstants, UncataloguedEffects
from fishmj.gap.laboratory.virtual_robot.simulate import StateRecording


def watch(
    camera: CameraConstants,
    odd: UncataloguedEffects,
    record: StateRecording,
    frames: np.ndarray,
    rng: np.random.Generator,
    noise: float,
) -> dict:
    """Table `pose` (t, x, y, yaw) of frames that reach the host at times `frames` (K,) s, on the host's clock."""
    late = camera.latency + camera.delay
    stamps = frames + noise * camera.jitter * rng.uniform(0.0, 1.0, len(frames))
    x, y, yaw = record.at(stamps - late, "x", "y", "yaw").T
    x, y = x + camera.marker * np.cos(yaw), y + camera.marker * np.sin(yaw)
    if odd.parallax != 0.0:  # the image of the raised marker shifts with the heading
        x, y = x + odd.parallax * np.sin(yaw + 0.4), y + odd.parallax * np.sin(2.0 * yaw)
    far = 1.0 + camera.k1 * (x * x + y * y)
    size = 1.0 + camera.scale
    x, y = x * far * size, y * far * size
    c, s = np.cos(camera.angle), np.sin(camera.angle)
    x, y, yaw = c * x - s * y, s * x + c * y, yaw + camera.angle + camera.heading
    error = rng.standard_normal((3, len(frames)))
    x, y = x + noise * camera.position_noise * error[0], y + noise * camera.position_noise * error[1]
    yaw = yaw + noise * camera.heading_noise * error[2]
    return {"t": stamps, "x": x, "y": y, "yaw": yaw}


def track(camera: CameraConstants, seen: dict) -> dict:
    """Adds the tracker's velocity vx, vy, wz in the tank frame to the pose table."""
    names = {"x": "vx", "y": "vy", "yaw": "wz"}
    slopes = {rate: slope(seen["t"], seen[name], int(camera.window)) for name, rate in names.items()}
    return seen | {rate: low_pass(value, camera.period, camera.filter) for rate, value in slopes.items()}


def on_its_clock(camera: CameraConstants, seen: dict) -> dict:
    """Pose table with stamps of the camera's clock."""
    return seen | {"t": seen["t"] * camera.drift + camera.offset}


def slope(t: np.ndarray, value: np.ndarray, window: int) -> np.ndarray:
    """Least-squares slope over the last `window` samples; the first ones use as many as there are."""
    out = np.zeros(len(t))
    for k in range(1, min(window - 1, len(t))):
        out[k] = _slopes(t[None, : k + 1], value[None, : k + 1])[0]
    if len(t) >= window:
        windows = np.lib.stride_tricks.sliding_window_view
        out[window - 1 :] = _slopes(windows(t, window), windows(value, window))
    return out


def _slopes(t: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Least-squares slope of every row, (n, window) -> (n,)."""
    dt = t - t.mean(1, keepdims=True)
    return (dt * value).sum(1) / (dt * dt).sum(1)


def low_pass(value: np.ndarray, step: float, time: float) -> np.ndarray:
    """First-order filter with time constant `time` [s]; no filter if 0."""
    if time <= 0.0:
        return value
    keep, out = np.exp(-step / time), value.copy()
    for k in range(1, len(out)):
        out[k] = keep * out[k - 1] + (1.0 - keep) * value[k]
    return out


def metered(meter: MeterConstants, record: StateRecording, t: np.ndarray, rng: np.random.Generator, noise: float) -> dict:
    """Table `power`: battery voltage and current, averaged over the time before each stamp t (K,), a reading every millisecond.

    Single readings would alias with the servos' clock: mean power would depend on the phase at which commands arrive.
    """
    lags = np.arange(0.5, 1000.0 * meter.average) / 1000.0
    volts, amps = np.mean([record.at(t - lag, "V", "I") for lag in lags], 0).T
    amps = amps + meter.offset / volts
    volts = volts + noise * meter.voltage_noise * rng.standard_normal(len(t))
    amps = amps + noise * meter.current_noise * rng.standard_normal(len(t))
    return {"t": t, "V": volts, "I": amps}
