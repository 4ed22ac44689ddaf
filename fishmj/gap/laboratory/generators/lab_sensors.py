"""Sensors of the lab: packet arrivals, joint encoders, camera frames, power meter."""

import numpy as np

from fishmj.gap.laboratory.generators.mujoco_robot import TrueMotion
from fishmj.gap.laboratory.generators.robot_parameters import BatteryMeter, RadioAndBus, RobotParameters, TankTracker
from fishmj.gap.laboratory.instruments import noise_sigmas, order_of_arrival, read_encoders


def arrivals(net: RadioAndBus, sent: np.ndarray, rng: np.random.Generator, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(times (K,) s, rows (K,)) of arrival at the servos of packets sent at `sent`, in order of arrival, without lost ones."""
    usual, tail, lost = rng.standard_exponential(len(sent)), rng.standard_exponential(len(sent)), rng.random(len(sent))
    at = sent + net.latency + noise * net.jitter * (usual - 1.0) + net.late * tail
    order = order_of_arrival(np.where(lost < net.loss, np.nan, at))
    return at[order], order


def joints(fish: RobotParameters, record: TrueMotion, rng: np.random.Generator, noise: float) -> dict:
    """Table `joint`, angles in rad."""
    net = fish.network
    t = np.arange(0.0, record.t[-1], net.period)
    angles = np.stack([record.at(t - net.reading_delay, 3 + j) for j in range(fish.joints)], 1) - fish.zero
    for change in fish.read:
        angles = change(t, angles)
    return {"t": t, **read_encoders(net, angles, rng, noise)}


def poses(fish: RobotParameters, record: TrueMotion, rng: np.random.Generator, noise: float) -> dict:
    """Table `pose`: stamped on arrival by the camera's clock."""
    cam: TankTracker = fish.camera
    t = np.arange(0.0, record.t[-1], cam.period)
    t = t + noise * cam.jitter * np.abs(rng.standard_normal(len(t)))
    exposure = t - cam.latency
    x, y, yaw = (record.at(exposure, k) for k in range(3))
    x, y = x + cam.marker * np.cos(yaw), y + cam.marker * np.sin(yaw)
    for change in fish.seen:
        x, y, yaw = change(exposure, x, y, yaw, record)
    size = (1.0 + cam.scale) * (1.0 + cam.lens * (x**2 + y**2))
    turn = np.exp(1j * cam.turned) * size * (x + 1j * y)
    error = noise * rng.standard_normal((3, len(t)))
    x, y = turn.real + cam.position_noise * error[0], turn.imag + cam.position_noise * error[1]
    yaw = yaw + cam.turned + cam.heading + cam.heading_noise * error[2]
    return {"t": cam.offset + cam.drift * t, "x": x, "y": y, "yaw": yaw}


def power(meter: BatteryMeter, record: TrueMotion, rng: np.random.Generator, noise: float) -> dict:
    """Table `power`: means over the period before each stamp, V and A."""
    step = record.t[1] - record.t[0]
    many = max(round(meter.period / step), 1)
    rows = len(record.t) // many
    volts, amps = (c[: rows * many].reshape(rows, many).mean(1) for c in (record.volts, record.amps))
    t = (np.arange(rows) + 1) * many * step
    error = noise * rng.standard_normal((2, rows))
    amps = amps + meter.offset / volts
    return {"t": t, "V": volts + meter.voltage_noise * error[0], "I": amps + meter.current_noise * error[1]}


def sigmas(fish: RobotParameters, noise: float) -> dict[str, float]:
    """Standard deviation of each channel's noise, quantisation included, in the channel's unit."""
    return noise_sigmas(fish.network, fish.camera, fish.meter, fish.joints, noise)
