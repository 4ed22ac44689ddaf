"""What the tests of policies share: a whole header of the default fish, small weights, and files with any header."""

import json

import numpy as np
from safetensors.numpy import save

from fishmj.base.store.arrays import _digest
from fishmj.control.policy import SCHEMA
from fishmj.control.policy_meta import structure_sha256
from fishmj.mjcf.identity import constants_sha256, observation_of, structure_of
from fishmj.mjcf.reading import load_robot
from fishmj.water.water_identity import water_identity

ROBOT = load_robot("fish")
SHORT = ["--water", "structured", "--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "1"]


def header(**changes) -> dict:
    """A whole header as training writes it for the fish."""
    robot = ROBOT
    if "structure" in changes:
        changes = {"structure_sha256": None, **changes}
    return {
        "schema": SCHEMA, "robot": robot.name, "joints": robot.n_joints, "structure": structure_of(robot),
        "structure_sha256": structure_sha256(structure_of(robot)), "constants_sha256": constants_sha256(robot),
        "water": water_identity(robot), "command": None,
        "observation": observation_of(robot.n_joints), "action": f"joint angle over {robot.servo.range:.6f} rad",
        "scale": [1.0] * (5 + 2 * robot.n_joints), "activation": "relu", "memory": 1, "control_dt": robot.timing.control_dt,
        "command_path": robot.timing.command_path, "algorithm": "ppo", "seed": 0, **changes,
    }  # fmt: skip


def arrays() -> dict:
    """Weights of a small policy."""
    rng, sizes = np.random.default_rng(0), [(8, 11), (3, 8)]
    made = {f"w{i}": rng.normal(size=size).astype(np.float32) for i, size in enumerate(sizes)}
    return made | {f"b{i}": np.zeros(size[0], np.float32) for i, size in enumerate(sizes)}


def stored(path, meta, some=None):
    """A policy file with any header, NaN and all, and its right checksum."""
    some, text, path = arrays() if some is None else some, json.dumps(meta), path / "mine.safetensors"
    some = {name: np.array(value, order="C") for name, value in some.items()}
    path.write_bytes(save(some, {"fishmj": text, "sha256": _digest(some, text)}))
    return str(path)
