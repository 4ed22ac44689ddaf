"""Answer of a baseline: effects with values, or nothing."""

from typing import NamedTuple

import numpy as np


class BaselineAnswer(NamedTuple):
    """effects: {name: {parameter: value}}, empty for "nothing is missing". seen: True if it found a gap at all, named or not."""

    effects: dict[str, dict[str, float]]
    seen: bool
    reason: str

    @property
    def word(self) -> str:
        """One of the five answers."""
        return "NAMED" if self.effects else "UNEXPLAINED" if self.seen else "AGREES"


NOTHING = BaselineAnswer({}, False, "nothing stands out")


def values(plant, row: np.ndarray, names) -> dict[str, dict[str, float]]:
    """{effect: {parameter: value}} of a parameter row."""
    return {n: {p.name: float(row[plant.index(n, p.name)]) for p in plant.active.effect(n).parameters} for n in names}


def unsized(plant, name: str, reason: str) -> BaselineAnswer:
    """Answer that names an effect without a value; that something is missing, if the plant has no effect of this name."""
    effects = {e.name: {p.name: float("nan") for p in e.parameters} for e in plant.active.effects if e.name == name}
    return BaselineAnswer(effects, True, reason)
