"""Servo laws and identified constants of BAM, Better Actuator Models (Duclusaud & Passault, Rhoban; Apache-2.0).

github.com/Rhoban/bam at commit 1b5a1ce, bam/model.py; the constants (data/calib/bam_servos.toml) are theirs, the code is not.

    motor     tau_m = clip(k_p e, V_max) k_t / R - k_t^2 v / R
    friction  |tau_f| <= F_b + D |v| + c(v) F_s + load,   c(v) = exp(-|v / v_s|^alpha)

    M1  no load                            M2  with c(v) F_s
    M3  load = mu |tau_e - tau_m|          M4  load = (mu + c mu_s) |tau_e - tau_m|, with c(v) F_s
    M5  load = |mu_e tau_e - mu_m tau_m| + c |mu_es tau_e - mu_ms tau_m|
    M6  M5 and, where both torques oppose each other, c k_e tau_e^2 if the motor is stronger, else c k_m tau_m^2

tau_e is the torque of gravity and motion at the joint.
"""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import calib_folder, read_toml


class BamServo(NamedTuple):
    """Servo. stiffness: controller gain, duty per rad; volts: supply; duty: largest duty. laws: M1 to M6, SI."""

    stiffness: float
    volts: float
    duty: float
    laws: Mapping[str, Mapping[str, float]]


@cache
def servos() -> dict[str, BamServo]:
    """The servos of data/calib/bam_servos.toml by name."""
    out = {}
    for name, entry in read_toml(calib_folder() / "bam_servos.toml").items():
        laws = {key: value for key, value in entry.items() if isinstance(value, dict)}
        out[name] = BamServo(entry["stiffness"], entry["volts"], entry["duty"], laws)
    return out


LAWS = {"stribeck": ("M2",), "load_friction": ("M3", "M5", "M6"), "": ("M1",)}  # effect -> laws that hold it; "": none of them


def friction_budget(driven: Mapping[int, Mapping[str, float]], v, motor, external) -> np.ndarray:
    """Friction (J,) [N m] beyond F_b and D |v|. driven: constants by joint. external: torques of gravity and motion, N m."""
    out = np.zeros(len(v))
    for k, p in driven.items():
        m, e, get = motor[k], external[k], p.get
        c = np.exp(-(abs(v[k] / p["speed"]) ** p["alpha"])) if "speed" in p else 0.0
        out[k] = c * get("stribeck", 0.0)
        out[k] += (get("load", 0.0) + c * get("load_stribeck", 0.0)) * abs(e - m)
        out[k] += abs(get("external", 0.0) * e - get("motor", 0.0) * m)
        out[k] += c * abs(get("external_stribeck", 0.0) * e - get("motor_stribeck", 0.0) * m)
        if "motor_quad" in p and e * m < 0:
            out[k] += c * (p["external_quad"] * e**2 if abs(m) > abs(e) else p["motor_quad"] * m**2)
    return out
