"""Sizes of the catalogue's effects for a body or a servo of another size.

Bounds and typical sizes of an effect are those of a fish of 0.725 kg and half a metre, or of a servo of 0.7 N m. For another
body they scale with its mass and length, by the powers in their units; times stay.

    N s2/m2 = kg/m    times mass / length        N m s = kg m2/s    times mass length^2
"""

import math
import re
from collections.abc import Iterable
from dataclasses import replace

from fishmj.effects.effect import Effect, Parameter

MASS, INERTIA = 0.725, 2.66e-3  # kg, kg m2: of the fish
STALL = 0.7  # N m: of the servo


def dimensions(unit: str) -> tuple[int, int]:
    """Powers of kg and m of a unit such as "N s2/m2"."""
    mass = length = 0
    top, _, bottom = unit.partition("/")
    for text, sign in ((top, 1), (bottom, -1)):
        for symbol, power in re.findall(r"(kg|N|m)(\d?)(?![a-z])", text):
            n = sign * int(power or 1)
            mass += n if symbol in ("kg", "N") else 0
            length += n if symbol in ("m", "N") else 0
    return mass, length


def sized(terms: Iterable[Effect], mass: float, length: float = 1.0) -> list[Effect]:
    """The same terms for a body `mass` times as heavy and `length` times as long."""
    if mass == length == 1.0:
        return list(terms)
    return [replace(e, parameters=tuple(_scaled(p, mass, length) for p in e.parameters)) for e in terms]


def _scaled(p: Parameter, mass: float, length: float) -> Parameter:
    if p.null:  # such as a torque that means "no limit": the formula knows it as a number
        return p
    kg, m = dimensions(p.unit)
    k = mass**kg * length**m
    return replace(p, low=k * p.low, high=k * p.high, typical=(k * p.typical[0], k * p.typical[1]))


def of_body(mass: float, inertia: float) -> tuple[float, float]:
    """(mass, length) over those of the fish."""
    return mass / MASS, math.sqrt((inertia / INERTIA) / (mass / MASS))
