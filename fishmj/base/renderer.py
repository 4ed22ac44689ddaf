"""MUJOCO_GL: MuJoCo and dm_control choose their renderer on import, and fail there if it does not load.

fishmj uses it only for dm_control's own pictures. `watch` turns such a failure into one line with the remedy.
"""

import os
import sys
import warnings
from importlib.abc import MetaPathFinder

from fishmj.base.errors import ConfigError

VARIABLE = "MUJOCO_GL"
WATCHED = ("mujoco", "dm_control._render")  # modules whose import loads a renderer
CHOICES = "egl (GPU), osmesa, glfw (screen) or disabled"


def watch() -> None:
    """Watches the imports of `WATCHED` from now on; a second call changes nothing.

    It hides GLFW's warning that there is no screen, since dm_control then takes another renderer.
    """
    if not any(isinstance(finder, _Watch) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watch())
        warnings.filterwarnings("ignore", r"\(65550\) .*DISPLAY environment variable is missing")


def said_of(error: Exception) -> str:
    """One-line message for a renderer that does not load."""
    why = " ".join(str(error).split()) or type(error).__name__
    return (
        f"{VARIABLE} = {os.environ[VARIABLE]!r}: this renderer does not load here ({why[:200]}); unset the variable, or set it"
        f" to another of {CHOICES}, in small letters; fishmj's own pictures and replays need none"
    )


class _Watch(MetaPathFinder):
    """Import finder that finds nothing itself: it adds an explanation to the error of a watched module if `VARIABLE` is set."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname not in WATCHED or VARIABLE not in os.environ:
            return None
        others = (finder.find_spec(fullname, path, target) for finder in list(sys.meta_path) if finder is not self)
        spec = next((found for found in others if found is not None), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def explain(module) -> None:
                try:
                    execute(module)
                except ModuleNotFoundError:
                    raise
                except Exception as error:
                    raise ConfigError(said_of(error)) from error

            spec.loader.exec_module = explain
        return spec


__all__ = ["CHOICES", "VARIABLE", "said_of", "watch"]
