"""Entry of an effect of the catalogue, or of a fault, that a generator can hide."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.effects import Parameter
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters


class HiddenEntry(NamedTuple):
    """Effect or fault to hide. act(fish, **values) changes the robot's constants."""

    name: str
    parameters: tuple[Parameter, ...]
    act: Callable
    catalogued: bool
    about: str

    @property
    def nulls(self) -> dict[str, float]:
        """Parameter values without effect."""
        return {p.name: p.null for p in self.parameters}

    def draw(self, rng: np.random.Generator, strength: float = 1.0) -> dict[str, float]:
        """Draws values of typical size: log-uniform distance from the null, times strength; random side if signed."""
        out = {}
        for p in self.parameters:
            low, high = (t - p.null for t in p.typical)
            if p.shape or low * high <= 0.0:
                out[p.name] = float(rng.uniform(*p.typical))
                continue
            near, far = sorted((abs(low), abs(high)))
            size = float(np.exp(rng.uniform(np.log(near), np.log(far)))) * strength * np.sign(high)
            side = -1.0 if p.signed and rng.random() < 0.5 else 1.0
            out[p.name] = float(np.clip(p.null + side * size, p.low, p.high))
        return out

    def put(self, fish: RobotParameters, values: Mapping[str, float]) -> None:
        """Hides the effect in a robot; missing parameters stay at their null.

        Raises UnknownName: no such parameter; ConfigError: a value that is no number or outside its bounds.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise UnknownName(f"parameter of {self.name}", name, known)
            p = known[name]
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not p.low <= value <= p.high:
                raise ConfigError(f"{self.name}: {name} = {value!r}; expected {p.low:g} to {p.high:g} {p.unit}")
        self.act(fish, **(self.nulls | {k: float(v) for k, v in values.items()}))
