"""Numbers with units in common notation: `60 cm`, `17kgcm`, `0.2s/60deg`. SI without a unit, but of a torque or rate."""

import argparse
import math
import re
from collections.abc import Callable
from typing import NamedTuple

from fishmj.mjcf.servos import KG_CM, RPM, S_PER_60_DEG


class Quantity(NamedTuple):
    """A kind of quantity: its SI unit, and factors to it. bare: a number without a unit is SI, not a question."""

    si: str
    units: dict[str, float]
    inverse: dict[str, float] = {}  # unit -> factor over the number, such as s/60deg
    bare: bool = True


KINDS = {
    "length": Quantity("m", {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}),
    "mass": Quantity("kg", {"kg": 1.0, "g": 0.001}),
    "torque": Quantity(  # data sheets mostly state kg cm or oz in, and rpm or s/60deg
        "N m", {"nm": 1.0, "mnm": 0.001, "kgcm": KG_CM, "kgfcm": KG_CM, "gcm": KG_CM / 1000, "ozin": 0.00706155}, bare=False
    ),
    "rate": Quantity(
        "rad/s", {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": RPM, "rev/min": RPM}, {"s/60deg": S_PER_60_DEG}, bare=False
    ),
    "voltage": Quantity("V", {"v": 1.0}),
    "current": Quantity("A", {"a": 1.0, "ma": 0.001}),
    "scale": Quantity("m per pixel", {"m": 1.0, "mm": 0.001}),
    "ratio": Quantity("", {}),
}
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([^\d].*)?\Z", re.IGNORECASE | re.ASCII)


def quantity(kind: str, low: float, high: float) -> Callable[[str], float]:
    """The `type=` of an option that takes a quantity from `low` to `high` (SI); a unit may follow the number."""
    what = KINDS[kind]
    units = f" (units: {', '.join([*what.units, *what.inverse])})" if what.units else ""
    expected = f"{f'{low:g} to {high:g} {what.si}'.strip()}{units if what.bare else f', with its unit{units}'}"

    def parse(text: str) -> float:
        value = _value(text, what)
        if value is None or not math.isfinite(value) or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"got {text[:40]!r}, expected {expected}")
        return value

    return parse


def _value(text: str, kind: Quantity) -> float | None:
    """Value in SI units; None if it is no number or the unit is of another kind."""
    found = _NUMBER.match(text[:80])
    if found is None:
        return None
    number, unit = float(found[1]), re.sub(r"[\s.*·-]", "", (found[2] or "").lower().replace("°", "deg"))
    if not unit:
        return number if kind.bare else None
    if unit in kind.inverse:
        return kind.inverse[unit] / number if number else None
    return number * kind.units[unit] if unit in kind.units else None
