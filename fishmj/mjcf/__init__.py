"""The robot: from a small description (dataclass or TOML) to geometry and a MuJoCo model."""

from typing import TYPE_CHECKING, Any

from fishmj.mjcf.description import Fin, Link, RigSpec, Robot, Servo, Timing
from fishmj.mjcf.geometry import Geometry, geometry_of
from fishmj.mjcf.reading import load_robot

if TYPE_CHECKING:
    from fishmj.mjcf.model import build, build_spec, mjcf_xml

__all__ = [
    "Fin",
    "Geometry",
    "Link",
    "RigSpec",
    "Robot",
    "Servo",
    "Timing",
    "build",
    "build_spec",
    "geometry_of",
    "load_robot",
    "mjcf_xml",
]


def __getattr__(name: str) -> Any:
    """Loads `build`, `build_spec` and `mjcf_xml`, and so MuJoCo, at their first use."""
    if name not in __all__:
        raise AttributeError(f"module 'fishmj.mjcf' has no attribute {name!r}")
    from fishmj.mjcf import model

    return getattr(model, name)
