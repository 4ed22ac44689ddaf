"""Which robot a log or a result is of: its name, its number of joints, and a sum that changes with every number of it."""

import json
from dataclasses import asdict
from hashlib import sha256

from fishmj.mjcf.description import Robot
from fishmj.store import plain


def robot_sha256(robot: Robot) -> str:
    """Hex digest of everything that a description says: links, servo, timing, water, effects. Equal for equal descriptions."""
    return sha256(json.dumps(plain(asdict(robot)), sort_keys=True, default=str).encode()).hexdigest()


def identity(robot: Robot) -> dict:
    """The keys of a trial's meta data that say which robot it is of."""
    return {"robot": robot.name, "joints": robot.n_joints, "robot_sha256": robot_sha256(robot)}
