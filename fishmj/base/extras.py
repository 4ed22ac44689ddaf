"""Optional packages: which extra of fishmj installs what is missing.

`watch` makes the failed import of such a package by a module of fishmj one line with the install command.
"""

import sys
from importlib.abc import MetaPathFinder
from types import FrameType

from fishmj.base.errors import MissingExtra

EXTRA_OF = {  # import name -> the extra that installs it
    "jax": "train",
    "optax": "train",
    "gymnasium": "train",
    "mujoco.mjx": "train",
    "cmaes": "train",
    "numba": "fast",
    "dm_control": "suite",
    "dm_env": "suite",
    "warp": "solver",
    "cv2": "tank",
    "serial": "tank",
    "roslibpy": "ros",
    "meshcat": "view",
    "tornado": "view",
    "mcap": "logs",
    "zstandard": "logs",
    "pyarrow": "logs",
    "rosbags": "logs",
    "ruamel": "logs",
    "mujoco_menagerie": "menagerie",
    "pysindy": "bench",
    "pinocchio": "bench",
    "ray": "ray",
    "onnx": "onnx",
    "torch": "sb3",
    "stable_baselines3": "sb3",
    "matplotlib": "all",  # a package of every install, but not of the computer beside the tank
}


def watch() -> None:
    """Explain failed imports from now on; a second call changes nothing."""
    if not any(isinstance(finder, _Explain) for finder in sys.meta_path):
        sys.meta_path.append(_Explain())


class _Explain(MetaPathFinder):
    """The last finder: it is asked only for what no other one found, and finds nothing itself."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname in EXTRA_OF and (asking := _importing(sys._getframe(1))).partition(".")[0] in ("fishmj", "studies"):
            raise MissingExtra(fullname.partition(".")[0], EXTRA_OF[fullname], asking)
        return None


def _importing(frame: FrameType | None) -> str:
    """Name of the module whose import statement is running; "" for a mere question whether a package is there (`find_spec`)."""
    loading = False
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if not name.startswith(("importlib", "_frozen_importlib")):
            return name if loading else ""
        loading = loading or frame.f_code.co_name == "_find_and_load"
        frame = frame.f_back
    return ""
