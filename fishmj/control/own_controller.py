"""Wrapper of the user's own controller: it passes a copy of the observations and checks every command."""

from collections.abc import Sequence
from inspect import isclass
from typing import Any

import numpy as np

from fishmj.base import plugins
from fishmj.base.errors import OwnCodeError
from fishmj.base.names import nearest
from fishmj.engines import ticks_per
from fishmj.mjcf.description import Robot

EXAMPLE = (  # of a class in one line
    "{0} must take the robot and return the controller; if it takes obs, wrap it in a class and name that:"
    " class Mine: __init__ = lambda self, robot: None; reset = lambda self, n: None; __call__ = lambda self, obs: {0}(obs)"
)
LARGEST = np.pi  # rad; a larger command is probably in degrees


class Own:
    """Wraps `factory(robot)`. taken: names already in use.

    Attributes:
        name: the object's `name` if it is valid in a path, else made from the reference. sha256: of its source file.

    Raises OwnCodeError: the factory fails, or its result has no `reset(n)` and `__call__(obs)`.
    """

    def __init__(self, robot: Robot, factory: Any, text: str, taken: Sequence[str] = ()):
        self.robot, self.what = robot, f"controller {text}"
        try:
            plugins.takes(self.what, factory, "Name(robot)", 1)
            self.controller = plugins.call(self.what, factory, robot)
            plugins.takes(self.what, getattr(self.controller, "reset", None), "reset(n)", 1)
            plugins.takes(self.what, self.controller, "__call__(obs)", 1)
        except OwnCodeError as error:
            if isclass(factory):
                raise
            raise OwnCodeError(f"{error}. {EXAMPLE.format(text.rpartition(':')[2])}") from error
        declared = nearest(str(getattr(self.controller, "name", "")))
        self.name = declared if declared and declared not in taken else plugins.name_of(text)
        self.sha256 = plugins.source_sha256(factory)

    def reset(self, n: int) -> None:
        """Starts n trials."""
        self.n, self.count = n, 0
        plugins.call(f"{self.what}: reset({n})", self.controller.reset, n)

    def __call__(self, obs) -> np.ndarray:
        """Commands (B, T, J) rad.

        Raises OwnCodeError if it fails, or returns another shape, numbers that are not finite, or degrees.
        """
        answer = plugins.call(f"{self.what}, control step {self.count}", self.controller, np.array(obs, float))
        shape = (len(obs), ticks_per(self.robot)[1], self.robot.n_joints)
        expected = f"bus commands {shape}, (trials, ticks, joints) in rad"
        try:
            commands = np.array(answer, float)
        except (TypeError, ValueError) as error:
            raise self._wrong(f"returned a {type(answer).__name__}, not an array of numbers", expected) from error
        if commands.shape != shape:
            raise self._wrong(f"returned an array of shape {commands.shape}", expected)
        if not np.isfinite(commands).all():
            raise self._wrong(f"returned {int((~np.isfinite(commands)).sum())} values that are not finite", expected)
        if (most := float(np.abs(commands).max())) > LARGEST:
            raise self._wrong(f"returned a command of {most:.4g}", f"{expected}, below {LARGEST:.3g}; are these degrees?")
        self.count += 1
        return commands

    def _wrong(self, got: str, expected: str) -> OwnCodeError:
        return OwnCodeError(f"{self.what}, control step {self.count}: {got}; expected {expected}")
