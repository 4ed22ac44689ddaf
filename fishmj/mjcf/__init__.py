"""The robot: a small description (dataclass or TOML) in, geometry and a MuJoCo model out."""

from fishmj.mjcf.description import Fin, Link, Robot, Servo, Timing, load_robot
from fishmj.mjcf.geometry import Geometry, geometry_of


def build(robot="fish", root: str = "planar", *, bare: bool = False, ellipsoid: bool = False):
    """The compiled MuJoCo model of a robot; see `fishmj.mjcf.model.build`."""
    from fishmj.mjcf import model

    return model.build(robot, root, bare=bare, ellipsoid=ellipsoid)


def build_spec(robot="fish", root: str = "planar", *, bare: bool = False, ellipsoid: bool = False):
    """The editable `mujoco.MjSpec` of a robot; see `fishmj.mjcf.model.build_spec`."""
    from fishmj.mjcf import model

    return model.build_spec(robot, root, bare=bare, ellipsoid=ellipsoid)


def mjcf_xml(robot="fish", root: str = "planar") -> str:
    """The MJCF text of a robot."""
    from fishmj.mjcf import model

    return model.mjcf_xml(robot, root)


__all__ = ["Fin", "Geometry", "Link", "Robot", "Servo", "Timing", "build", "build_spec", "geometry_of", "load_robot", "mjcf_xml"]
