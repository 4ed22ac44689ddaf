"""What a policy must find again on a robot: links and joints in order, lengths, servo range, observation, timing. Plain types.

Masses, gains, water and effects are left out: a calibrated fish is the same structure, whatever was learnt about it.
"""

from fishmj.mjcf.description import Robot


def structure_of(robot: Robot) -> dict:
    """The structure as the header of a policy holds it: {"links", "lengths" m, "joints", "servo_range" rad}."""
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
