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
    mine = {e.name: e for e in plant.active.effects}
    return {n: {p.name: float(row[plant.index(n, p.name)]) for p in mine[n].parameters} for n in names}


def unsized(plant, name: str) -> dict[str, float]:
    """The parameters of an effect that was named without a value."""
    effect = next(e for e in plant.active.effects if e.name == name)
    return {p.name: float("nan") for p in effect.parameters}
