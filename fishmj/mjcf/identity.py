"""Which robot a log, a result or a policy is of.

A log says its name, its number of joints, and a sum that changes with every number of it. A policy says the structure that it
must find again. Masses, gains, water and effects are left out there: a calibrated fish is the same structure.
"""

import json
from dataclasses import asdict
from hashlib import sha256

from fishmj.mjcf.description import Robot
from fishmj.store import plain


def robot_sha256(robot: Robot) -> str:
    """Hex digest of everything that a description says: links, servo, timing, water, effects. Equal for equal descriptions."""
    table = asdict(robot)
    water = table["water"].get("own", table["water"])  # as described, whatever water was chosen (water.choice)
    table["water"] = {"model": "structured", **water}
    return sha256(json.dumps(plain(table), sort_keys=True, default=str).encode()).hexdigest()


def identity(robot: Robot) -> dict:
    """The keys of a trial's meta data that say which robot it is of."""
    return {"robot": robot.name, "joints": robot.n_joints, "robot_sha256": robot_sha256(robot)}


def structure_of(robot: Robot) -> dict:
    """Links and joints in order, as the header of a policy holds them: {"links", "lengths" m, "joints", "servo_range" rad}."""
    return {
        "links": [link.name for link in robot.links],
        "lengths": [float(link.length) for link in robot.links],
        "joints": [f"j{i}" for i in range(1, len(robot.links))],
        "servo_range": float(robot.servo.range),
    }


def observation_of(joints: int) -> list[dict]:
    """The observations in their order, each {"name", "unit"}: body frame, as camera and encoders give them."""
    rows = [("target_x", "m"), ("target_y", "m"), ("velocity_x", "m/s"), ("velocity_y", "m/s"), ("yaw_rate", "rad/s")]
    rows += [(f"j{i}", "rad") for i in range(1, joints + 1)] + [(f"j{i}_rate", "rad/s") for i in range(1, joints + 1)]
    return [{"name": name, "unit": unit} for name, unit in rows]
