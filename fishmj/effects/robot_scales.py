"""Constants of the described robot that effects are sized by: the catalogue states sizes of the default fish.

A parameter with `of="torque"` has null, bounds and typical sizes in proportion to the robot's stall torque: for the default fish
those of the catalogue to the bit, for any other robot x times its own quantity over the default's. A law reads `p.robot.length`.
"""

from collections.abc import Callable, Mapping
from math import isclose
from typing import Any, NamedTuple

from fishmj.base.calib import constant


class RobotScales(NamedTuple):
    """Constants of a robot, SI. By default those of the default fish."""

    length: float = constant("robot", "length")  # m, straight
    mass: float = constant("robot", "mass")  # kg
    torque: float = constant("servo", "torque")  # N m, of a servo at stall
    speed_no_load: float = constant("servo", "speed_no_load")  # rad/s
    resistance: float = constant("servo", "resistance")  # ohm, of a servo
    voltage: float = constant("servo", "voltage")  # V, at which the stall torque is quoted
    idle_power: float = constant("servo", "idle_power")  # W

    @classmethod
    def of(cls, robot: Any) -> "RobotScales":
        """Those of a `mjcf.description.Robot`."""
        return cls._near({"length": robot.length, "mass": robot.mass, **vars(robot.servo)})

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> "RobotScales":
        """Those of a parsed description; what it leaves out is the default fish's."""
        links, found = table.get("link", []), dict(table.get("servo", {}))
        for key in ("length", "mass") if links else ():
            found[key] = sum(link[key] for link in links)
        return cls._near(found)

    @classmethod
    def _near(cls, found: Mapping[str, Any]) -> "RobotScales":
        """Values within rounding of the default fish's become those."""
        mine = {key: (found[key], usual) for key, usual in cls._field_defaults.items() if found.get(key) is not None}
        return cls(**{key: usual if isclose(x, usual, rel_tol=1e-9) else float(x) for key, (x, usual) in mine.items()})


QUANTITIES: dict[str, Callable[[RobotScales], float]] = {
    "torque": lambda r: r.torque,  # N m, and N m/rad
    "damping": lambda r: r.torque / r.speed_no_load,  # N m s/rad
    "slowness": lambda r: 1.0 / r.speed_no_load,  # s/rad
    "resistance": lambda r: r.resistance,  # ohm
    "mass": lambda r: r.mass,  # kg
    "length": lambda r: r.length,  # m
    "inertia": lambda r: r.mass * r.length**2,  # kg m2
    "drag": lambda r: r.length**2,  # of a force over the square of a speed, or over a speed
    "turning_drag": lambda r: r.length**5,  # of a moment over the square of a rate
}
DEFAULT = RobotScales()


def scaled(x: float, quantity: str, robot: RobotScales) -> float:
    """`x`, a size that belongs to the default fish, for this robot."""
    usual, own = QUANTITIES[quantity](DEFAULT), QUANTITIES[quantity](robot)
    return x if own == usual else own * (x / usual)
