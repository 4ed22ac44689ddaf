"""What can be hidden in a virtual robot: named effects with parameters, each a field of `constants.py`."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fishmj.errors import ConfigError, UnknownName

CHANNELS = ("joint", "position", "heading", "velocity", "power")


@dataclass(frozen=True, kw_only=True)
class EntryParameter:
    """One number, SI. typical = (low, high) magnitude; signed: both sides of the null occur; least, most: what is possible."""

    name: str
    unit: str
    field: str  # "motor.deadband"
    typical: tuple[float, float]
    null: float = 0.0
    signed: bool = False
    least: float = -np.inf
    most: float = np.inf
    default: bool = False  # secondary: means nothing while the first is null; null is its usual value


@dataclass(frozen=True, kw_only=True)
class CatalogueEntry:
    """A hidden effect. shows: channels in which it must be seen; runs: experiments that show it well."""

    name: str
    stage: str
    parameters: tuple[EntryParameter, ...]
    shows: tuple[str, ...]
    runs: tuple[str, ...]
    stochastic: bool = False  # differs between replicates
    catalogued: bool = True
    about: str = ""  # for those that no catalogue explains

    @property
    def nulls(self) -> dict[str, float]:
        """Values at which it is not there."""
        return {p.name: p.null for p in self.parameters}

    @property
    def typical(self) -> dict[str, float]:
        """The larger typical magnitude; secondary parameters at their usual value."""
        return {p.name: p.null if p.default else p.typical[1] for p in self.parameters}

    def draw(self, rng: np.random.Generator, strength: float = 1.0) -> dict[str, float]:
        """Values of typical size, log-uniform between low and high times `strength`, either sign where both occur."""
        values = {}
        for p in self.parameters:
            low, high = sorted(p.typical)
            size = float(np.exp(rng.uniform(np.log(low), np.log(high))))
            sign = -1.0 if p.signed and rng.random() < 0.5 else 1.0
            if p.default:
                values[p.name] = sign * size
            elif p.null:
                values[p.name] = p.null + (size - p.null) * strength
            else:
                values[p.name] = sign * size * strength
            values[p.name] = float(np.clip(values[p.name], p.least, p.most))
        return values

    def fields(self, values: Mapping[str, float]) -> dict[str, float]:
        """{"motor.deadband": 0.01} for given parameter values; those not named stay at their null.

        Raises:
            UnknownName: a parameter that the effect does not have. ConfigError: a value that is no number or impossible.
        """
        known = {p.name: p for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise UnknownName(f"parameter of {self.name}", name, known)
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not np.isfinite(value):
                raise ConfigError(f"effect {self.name}: {name} = {value!r}; expected a finite number in {known[name].unit}")
            if not known[name].least <= value <= known[name].most:
                bounds = f"{known[name].least:g} to {known[name].most:g} {known[name].unit}"
                raise ConfigError(f"effect {self.name}: {name} = {value!r} is impossible; it lies in {bounds}")
        return {p.field: float(values.get(p.name, p.null)) for p in self.parameters}
