"""Identity of the robot of a log, a result or a policy.

A log holds its name, its number of joints, and hashes of every number of the description and of the body alone. A policy holds
the structure that it needs. Masses, gains, water and effects are no part of the structure, so a calibrated fish has the same one.
All of these but the water have a hash of their own.
"""

from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

from fishmj.base.calib import calib_folder
from fishmj.base.store import json_sha256, plain
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of


def robot_sha256(robot: Robot) -> str:
    """Hex digest of a description of the fish: links, servo, timing, water, effects. Equal for equal descriptions.

    The rig is left out: another plug or paint does not make another fish.
    """
    table = asdict(robot)
    del table["rig"], table["file"]
    if robot.hull == "turbulent":  # as in hashes from before hulls were stated
        del table["hull"]
    water = table["water"].get("own", table["water"])  # as described, whatever water was chosen (water.choice)
    table["water"] = {"model": "structured", **water}
    return json_sha256(plain(table))


def body_sha256(robot: Robot) -> str:
    """Hex digest of the parts of a robot that matter to the water and to a drawing: lengths, sections, fins, water's density.

    Not servo, masses or timing.
    """
    links = [(link.length, link.sections, link.fin_from) for link in robot.links]
    parts = (links, robot.fins, robot.density_water, robot.water.get("stations", 6))
    return sha256(repr(parts).encode()).hexdigest()


def identity(robot: Robot) -> dict:
    """Keys of a trial's meta data that identify its robot."""
    hashes = {"robot_sha256": robot_sha256(robot), "body_sha256": body_sha256(robot)}
    return {"robot": robot.name, "joints": robot.n_joints, **hashes}


def robot_names(robot: Robot) -> dict[str, str]:
    """Name, file and hash of a judged robot, for results: {"name", "file", "sha256"}.

    file: of a shipped robot the name under which it is shipped; "" of one that was built by hand.
    """
    path = Path(robot.file)
    file = path.stem if path.parent == calib_folder() else robot.file
    return {"name": robot.name, "file": file, "sha256": robot_sha256(robot)}


def robot_line(robot: Robot) -> str:
    """Line on a robot for the head of a page."""
    return robot_line_of(**robot_names(robot))


def robot_line_of(name: str, file: str, sha256: str) -> str:
    """The same by name, file and hash."""
    where = f"shipped as {file}" if file and not Path(file).suffix else file or "described in Python"
    return f"Robot {name}, {where}, sha256 {sha256[:12]}"


def another_body(meta: Mapping, robot: Robot) -> bool:
    """Returns True if a trial's meta data state another body than this robot's; older logs state none."""
    return meta.get("body_sha256") not in (None, body_sha256(robot))


def structure_of(robot: Robot) -> dict:
    """Links and joints in order, as the header of a policy holds them.

    Returns:
        {"links", "lengths" m, "joints", "servo_range" rad, "reference_point" m behind the nose, to a micrometre}
    """
    return {
        "links": [link.name for link in robot.links],
        "lengths": [float(link.length) for link in robot.links],
        "joints": [f"j{i}" for i in range(1, len(robot.links))],
        "servo_range": float(robot.servo.range),
        "reference_point": round(geometry_of(robot).reference, 6),
    }


def constants_sha256(robot: Robot) -> str:
    """Hex digest of a description without structure, command path, water and texts.

    It covers masses and sections of links and fins, servo, times, water's density, and effects that are not at their null.
    """
    table = {
        "links": [[link.mass, link.com, link.sections, link.fin_from] for link in robot.links],
        "fins": [asdict(fin) for fin in robot.fins],
        "servo": {key: value for key, value in asdict(robot.servo).items() if key != "range"},
        "timing": {key: value for key, value in asdict(robot.timing).items() if key != "command_path"},
        "density_water": robot.density_water,
        "effects": [[effect.name, effect.parameters] for effect in robot.effects if effect.parameters],
    }
    return json_sha256(plain(table))


def constants_of(robot: Robot) -> dict[str, float | str]:
    """The single numbers among the constants of `constants_sha256`, and the names of effects, for the header of a policy."""
    found: dict[str, float | str] = {f"mass of {link.name}": float(link.mass) for link in robot.links}
    found |= {f"servo {key}": value for key, value in asdict(robot.servo).items() if key != "range"}
    found |= {f"timing {key}": value for key, value in asdict(robot.timing).items() if key != "command_path"}
    found |= {"density_water": robot.density_water}
    found["effects"] = ", ".join(sorted(effect.name for effect in robot.effects if effect.parameters)) or "none"
    return {key: value for key, value in plain(found).items() if isinstance(value, int | float | str)}


def observation_of(joints: int) -> list[dict]:
    """The observations in their order, each {"name", "unit"}: body frame, as camera and encoders give them."""
    rows = [("target_x", "m"), ("target_y", "m"), ("velocity_x", "m/s"), ("velocity_y", "m/s"), ("yaw_rate", "rad/s")]
    rows += [(f"j{i}", "rad") for i in range(1, joints + 1)] + [(f"j{i}_rate", "rad/s") for i in range(1, joints + 1)]
    return [{"name": name, "unit": unit} for name, unit in rows]
