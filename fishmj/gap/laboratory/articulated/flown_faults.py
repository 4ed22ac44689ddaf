"""Effects and faults to hide in a quadrotor: those shared with arms (hidden_faults.py), and those of rotors."""

from typing import Any

import numpy as np

from fishmj.gap.laboratory.articulated.hidden_faults import FAULTS, Fault, UsualMotion, log_uniform, one_parameter, stronger
from fishmj.gap.laboratory.articulated.robot_plan import GRAVITY, RobotPlan, body, rotor

SHARED = (
    *("body_mass", "link_inertia", "air_drag", "steady_wind", "command_latency", "joint_sensor_delay", "command_hold"),
    *("clock_drift", "latency_jitter", "packet_loss"),
)


def _hover(plan: RobotPlan, usual: UsualMotion, k: int) -> float:
    return plan.limbs[0].mass * GRAVITY / len(plan.rotors)


def _draw_centre(rng, plan, usual, k) -> dict[str, float]:
    offset = rng.standard_normal(3) * [1.0, 1.0, 0.3]
    offset *= log_uniform(rng, 0.004, 0.02) / np.linalg.norm(offset)
    return dict(zip("xyz", map(float, offset), strict=True))


def _draw_tether(rng, plan, usual, k) -> dict[str, float]:
    place = {"x": float(rng.uniform(-0.3, 0.3)), "y": float(rng.uniform(-0.3, 0.3)), "z": -0.3}
    return place | {"slack": float(rng.uniform(0.1, 0.4)), "stiffness": log_uniform(rng, 0.1, 0.5) * plan.limbs[0].mass * GRAVITY}


def _draw_vibration(rng, plan, usual, k) -> dict[str, float]:
    size = {"torque": log_uniform(rng, 0.3, 1.0) * float(usual.torque[3])}
    return size | {"frequency": float(rng.uniform(1.5, 6.0)), "phase": float(rng.uniform(0.0, 2.0 * np.pi))}


def _all(plan: RobotPlan, field: str, value) -> RobotPlan:
    return plan._replace(rotors=tuple(r._replace(**{field: value(r)}) for r in plan.rotors))


FLOWN: dict[str, Fault] = {name: FAULTS[name] for name in SHARED} | {
    "com_offset": Fault("body", _draw_centre, FAULTS["com_offset"].plan),
    "servo_gain": Fault(
        "actuator",
        one_parameter("gain", 0.08, 0.3, None, True),
        lambda plan, k, v: plan.with_rotor(k, gain=plan.rotors[k].gain * (1.0 + v["gain"])),
    ),
    "torque_offset": Fault(
        "actuator", one_parameter("torque", 0.04, 0.15, _hover, True), lambda plan, k, v: plan.with_rotor(k, offset=v["torque"])
    ),
    "torque_saturation": Fault(
        "actuator", one_parameter("limit", 0.95, 1.15, _hover), lambda plan, k, v: plan.with_rotor(k, limit=v["limit"])
    ),
    "thrust_loss": Fault(
        "robot", one_parameter("share", 0.08, 0.3), lambda plan, k, v: _all(plan, "gain", lambda r: r.gain * (1.0 - v["share"]))
    ),
    "thruster_lag": Fault(
        "robot", one_parameter("time", 0.02, 0.08), lambda plan, k, v: _all(plan, "lag", lambda r: float(v["time"]))
    ),
    "command_quantisation": Fault("actuator", one_parameter("step", 0.03, 0.1, _hover)),
    # outside every catalogue
    "tether": Fault("robot", _draw_tether),
    "body_vibration": Fault("robot", _draw_vibration),
}
LEAST_LIMIT = 0.9  # times a rotor's thrust in hover
FLOWN_OUTSIDE = ("tether", "body_vibration")


def draw_flown(name: str, rng: np.random.Generator, plan: RobotPlan, usual: UsualMotion, strength: float = 1.0) -> dict[str, Any]:
    """Draws {name@site: values} at a random site, `strength` times the usual size."""
    fault = FLOWN[name]
    k = int(rng.integers(len(plan.rotors))) if fault.site == "actuator" else 0
    site = {"actuator": "@" + rotor(k), "body": "@" + body(k)}.get(fault.site, "")
    values = {key: float(value) for key, value in fault.draw(rng, plan, usual, k).items()}
    values = values if name == "tether" else stronger(name, values, strength, LEAST_LIMIT * _hover(plan, usual, k))
    return {name + site: values}
