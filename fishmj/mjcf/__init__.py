"""The robot: a small description (dataclass or TOML) in, geometry and a MuJoCo model out."""

from fishmj.mjcf.description import Fin, Link, Robot, Servo, Timing, load_robot
from fishmj.mjcf.geometry import Geometry, geometry_of

__all__ = ["Fin", "Geometry", "Link", "Robot", "Servo", "Timing", "geometry_of", "load_robot"]
