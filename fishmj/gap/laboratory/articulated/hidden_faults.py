"""Effects and faults to hide in an articulated robot: ranges of their sizes, and where each acts.

    plan      changes constants of the robot, before a generator builds it
    timing    changes commands in transit, or readings (robot_stand.py)
    law       a torque or a friction at a joint (plant_laws.py)

Names and parameters of known effects are those of `fishmj.effects`, `name@site`; others are outside every catalogue.
Sizes are relative to the joint's usual torque, rate and command, so that they suit large and small joints.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from fishmj.gap.laboratory.articulated.robot_plan import GRAVITY, RobotPlan, body, carried_inertia, joint

Hidden = Mapping[str, Mapping[str, float]]  # effect at its site -> its parameters -> values
AIR = 1.2  # kg/m3


class UsualMotion(NamedTuple):
    """Usual torque [N m], rate [rad/s] and command of each joint, (J,)."""

    torque: np.ndarray
    rate: np.ndarray
    command: np.ndarray


class Fault(NamedTuple):
    """site: joint, actuator, body or robot. draw(rng, plan, usual, number) -> values. plan(plan, number, values) -> plan."""

    site: str
    draw: Callable[[np.random.Generator, RobotPlan, UsualMotion, int], dict[str, float]]
    plan: Callable[[RobotPlan, int, dict[str, float]], RobotPlan] | None = None
    servos: bool = False  # needs commands that are angles
    coupled: bool = False  # needs a parent joint


def log_uniform(rng, low: float, high: float, signed: bool = False) -> float:
    value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return -value if signed and rng.integers(2) else value


def one_parameter(name: str, low: float, high: float, scale: Callable | None = None, signed: bool = False):
    """Returns a function that draws one parameter: log-uniform, times a scale."""

    def draw(rng, plan, usual, k):
        return {name: log_uniform(rng, low, high, signed) * (scale(plan, usual, k) if scale else 1.0)}

    return draw


torque = lambda plan, usual, k: float(usual.torque[k])
damping = lambda plan, usual, k: float(usual.torque[k] / usual.rate[k])
drag = lambda plan, usual, k: float(usual.torque[k] / usual.rate[k] ** 2)
inertia = lambda plan, usual, k: float(carried_inertia(plan)[k])
mass = lambda plan, usual, k: plan.limbs[k].mass
command = lambda plan, usual, k: float(usual.command[k])


def _added(field: str, name: str):
    return lambda plan, k, v: plan.changed(k, **{field: getattr(plan.limbs[k], field) + v[name]})


def _gain(plan: RobotPlan, k: int, v) -> RobotPlan:
    b = plan.limbs[k]
    return plan.changed(k, gear=b.gear * (1 + v["gain"]), kp=b.kp * (1 + v["gain"]), kv=b.kv * (1 + v["gain"]))


def _mass(plan: RobotPlan, k: int, v) -> RobotPlan:
    b = plan.limbs[k]
    return plan.changed(k, mass=b.mass + v["mass"], inertia=tuple(x * (1 + v["mass"] / b.mass) for x in b.inertia))


def _carry(plan: RobotPlan, k: int, v) -> RobotPlan:
    """A point mass twice as far from the hinge as the link's centre; the principal axes stay those of the frame."""
    b = plan.limbs[k]
    own, more, centre = b.mass, v["mass"], np.array(b.centre)
    lever = centre  # from the old centre to the load
    both = own * more / (own + more) * (lever @ lever - lever**2)
    new = centre + more / (own + more) * lever
    return plan.changed(k, mass=own + more, centre=tuple(map(float, new)), inertia=tuple(map(float, np.array(b.inertia) + both)))


def _centre(plan: RobotPlan, k: int, v) -> RobotPlan:
    return plan.changed(k, centre=tuple(float(c + v[n]) for c, n in zip(plan.limbs[k].centre, "xyz", strict=True)))


def _draw_centre(rng, plan, usual, k):
    offset = rng.standard_normal(3)
    offset *= log_uniform(rng, 0.08, 0.25) * np.linalg.norm(plan.limbs[k].centre) / np.linalg.norm(offset)
    return dict(zip("xyz", map(float, offset), strict=True))


def _draw_tilt(rng, plan, usual, k):
    angle, size = rng.uniform(0.0, 2 * np.pi), log_uniform(rng, 0.02, 0.08)
    return {"pitch": float(size * np.cos(angle)), "roll": float(size * np.sin(angle))}


def _tilt(plan: RobotPlan, k: int, v) -> RobotPlan:
    pitch, roll = v["pitch"], v["roll"]
    down = np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
    return plan._replace(gravity=tuple(map(float, GRAVITY * down)))


def _draw_wind(rng, plan, usual, k):
    angle = rng.uniform(0.0, 2 * np.pi)
    size = log_uniform(rng, 6.0, 25.0)
    return {"x": float(size * np.cos(angle)), "y": float(size * np.sin(angle)), "z": 0.0}


def _draw_ripple(rng, plan, usual, k):
    size, phase = log_uniform(rng, 0.08, 0.25) * usual.torque[k], rng.uniform(0.0, 2 * np.pi)
    period = 2.0 * np.pi / int(rng.integers(6, 24))
    return {"sine": float(size * np.cos(phase)), "cosine": float(size * np.sin(phase)), "period": period}


FAULTS: dict[str, Fault] = {
    "coulomb_friction": Fault("joint", one_parameter("torque", 0.04, 0.25, torque), _added("friction", "torque")),
    "viscous_friction": Fault("joint", one_parameter("damping", 0.05, 0.3, damping), _added("damping", "damping")),
    "quadratic_friction": Fault("joint", one_parameter("drag", 0.05, 0.3, drag), _added("drag", "drag")),
    "rotor_inertia": Fault("joint", one_parameter("inertia", 0.12, 0.7, inertia), _added("armature", "inertia")),
    "joint_stiffness": Fault("joint", one_parameter("stiffness", 0.06, 0.4, torque), _added("stiffness", "stiffness")),
    "servo_gain": Fault("actuator", one_parameter("gain", 0.1, 0.4, None, True), _gain),
    "servo_damping_gain": Fault(
        "actuator",
        one_parameter("gain", 0.2, 0.8, None, True),
        lambda plan, k, v: plan.changed(k, kv=plan.limbs[k].kv * (1 + v["gain"])),
        servos=True,
    ),
    "torque_offset": Fault("actuator", one_parameter("torque", 0.05, 0.25, torque, True), _added("offset", "torque")),
    "torque_saturation": Fault(
        "actuator", one_parameter("limit", 0.5, 0.85, torque), lambda plan, k, v: plan.changed(k, limit=v["limit"])
    ),
    "body_mass": Fault("body", one_parameter("mass", 0.12, 0.5, mass), _mass),
    "payload": Fault("body", one_parameter("mass", 0.06, 0.4, mass), _carry),
    "com_offset": Fault("body", _draw_centre, _centre),
    "link_inertia": Fault(
        "body",
        one_parameter("share", 0.4, 1.5),
        lambda plan, k, v: plan.changed(k, inertia=tuple(x * (1 + v["share"]) for x in plan.limbs[k].inertia)),
    ),
    "base_tilt": Fault("robot", _draw_tilt, _tilt),
    "air_drag": Fault("robot", one_parameter("density", 8.0, 60.0), lambda plan, k, v: plan._replace(density=v["density"])),
    "steady_wind": Fault("robot", _draw_wind, lambda plan, k, v: plan._replace(density=AIR, wind=(v["x"], v["y"], v["z"]))),
    "joint_zero_offset": Fault("joint", one_parameter("offset", 0.02, 0.08, None, True)),
    "joint_scale": Fault("joint", one_parameter("scale", 0.02, 0.08, None, True)),
    "command_latency": Fault("robot", one_parameter("delay", 0.006, 0.04)),
    "joint_sensor_delay": Fault("robot", one_parameter("delay", 0.006, 0.04)),
    "command_hold": Fault("robot", one_parameter("period", 0.02, 0.07)),
    "command_quantisation": Fault("actuator", one_parameter("step", 0.12, 0.5, command)),
    "clock_drift": Fault("robot", lambda rng, plan, usual, k: {"rate": 1.0 + log_uniform(rng, 1e-3, 6e-3, True)}),
    "latency_jitter": Fault("robot", one_parameter("sigma", 0.006, 0.03)),
    "packet_loss": Fault("robot", one_parameter("probability", 0.02, 0.15)),
    "stribeck": Fault(
        "joint",
        lambda rng, plan, usual, k: {
            "torque": log_uniform(rng, 0.06, 0.25) * usual.torque[k],
            "speed": log_uniform(rng, 0.06, 0.3),
        },
    ),
    "load_friction": Fault("joint", one_parameter("ratio", 0.08, 0.3)),
    "speed_limit": Fault(
        "actuator", lambda rng, plan, usual, k: {"slowness": log_uniform(rng, 0.35, 0.8) / float(usual.rate[k])}
    ),
    "torque_ripple": Fault("joint", _draw_ripple),
    # outside every catalogue
    "elastic_coupling": Fault("joint", one_parameter("stiffness", 0.15, 0.6, torque), coupled=True),
    "cable_torque": Fault(
        "joint",
        lambda rng, plan, usual, k: {
            "torque": log_uniform(rng, 0.15, 0.6) * usual.torque[k],
            "from": float(rng.uniform(-0.4, 0.2)) * plan.limbs[k].swing[1],
            "side": float(rng.choice((-1.0, 1.0))),
        },
    ),
    "vibration": Fault(
        "joint",
        lambda rng, plan, usual, k: {
            "torque": log_uniform(rng, 0.1, 0.35) * usual.torque[k],
            "frequency": float(rng.uniform(1.5, 6.0)),
            "phase": float(rng.uniform(0, 2 * np.pi)),
        },
    ),
    "hysteresis": Fault(
        "joint",
        lambda rng, plan, usual, k: {
            "torque": log_uniform(rng, 0.12, 0.4) * usual.torque[k],
            "angle": log_uniform(rng, 0.3, 0.8) * plan.limbs[k].swing[1],
        },
    ),
}
OUTSIDE = ("elastic_coupling", "cable_torque", "vibration", "hysteresis")
ONLY_MUJOCO = ("air_drag", "steady_wind")  # drag at each link: MuJoCo's own


def placed(name: str) -> tuple[str, int]:
    """Splits `effect@site`: (effect, number of its limb, -1 for the whole robot)."""
    effect, _, site = name.partition("@")
    return effect, int(site[1:]) - 1 if site else -1


SHAPES = ("speed", "phase", "frequency", "from", "side", "angle")  # parameters other than sizes, besides a ripple's period
MOST = {  # largest sizes of a working robot
    **{"gain": 0.7, "scale": 0.2, "offset": 0.3, "pitch": 0.25, "roll": 0.25, "density": 400.0, "probability": 0.5},
    **{"delay": 0.12, "period": 0.15, "sigma": 0.08, "ratio": 0.7},
}
LEAST_LIMIT = 0.4  # of the usual torque
FASTEST_CLOCK = 0.015


def stronger(effect: str, values: dict[str, float], strength: float, least: float) -> dict[str, float]:
    """Scales an effect's values by `strength`, within its bounds. least: smallest torque limit."""
    out = {}
    for key, value in values.items():
        if key in SHAPES or (effect, key) == ("torque_ripple", "period"):
            out[key] = value
        elif key == "limit":
            out[key] = max(value / strength, least)
        elif key == "rate":
            out[key] = 1.0 + float(np.clip(strength * (value - 1.0), -FASTEST_CLOCK, FASTEST_CLOCK))
        else:
            most = MOST.get(key, np.inf)
            out[key] = float(np.clip(strength * value, -most, most))
    return out


def draw_hidden(
    name: str, rng: np.random.Generator, plan: RobotPlan, usual: UsualMotion, strength: float = 1.0
) -> dict[str, Any]:
    """Draws {name@site: values} at a random site, `strength` times the usual size."""
    fault = FAULTS[name]
    able = [k for k, b in enumerate(plan.limbs) if not fault.coupled or b.parent >= 0]
    k = int(rng.choice(able))
    site = {"robot": "", "body": "@" + body(k)}.get(fault.site, "@" + joint(k))
    values = {key: float(value) for key, value in fault.draw(rng, plan, usual, k).items()}
    return {name + site: stronger(name, values, strength, LEAST_LIMIT * float(usual.torque[k]))}


def fits(name: str, plan: RobotPlan) -> bool:
    """Returns True if a robot can have an effect."""
    fault = FAULTS[name]
    return not (fault.servos and plan.torques) and not (fault.coupled and len(plan.limbs) < 2)


def with_hidden(plan: RobotPlan, hidden: Hidden, faults: Mapping[str, Fault] = FAULTS) -> RobotPlan:
    """Applies the hidden effects that change the robot's constants. faults: those of its kind of robot."""
    for name, values in hidden.items():
        effect, k = placed(name)
        change = faults[effect].plan if effect in faults else None
        if change is not None:
            plan = change(plan, k, dict(values))
    return plan
