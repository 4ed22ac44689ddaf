"""Words for the names and numbers of an answer, the same in a terminal and on a page."""

import math
import re

SCALES = {
    "s": (1e3, "ms"),
    "rad": (math.degrees(1.0), "deg"),
    "rad/s": (math.degrees(1.0), "deg/s"),
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
}
PLAIN = 1e6  # larger numbers are written with an exponent
PERSONS = re.compile(r"\b(coulomb|munk|stribeck)\b")  # names of persons, which get a capital


def title(name: str) -> str:
    """Words for an effect's id, or for several joined by +: `coulomb_friction@left_hip` is Coulomb friction at left hip."""
    parts = (part.strip().replace("_", " ").partition("@") for part in name.split("+"))
    capital = lambda found: found[0].capitalize()
    return " and ".join(PERSONS.sub(capital, effect) + f"{at}{place}".replace("@", " at ") for effect, at, place in parts)


def sentence(text: str) -> str:
    """Text with a capital and a full stop; an empty text stays empty."""
    return text[:1].upper() + text[1:].rstrip(".") + "." if text else ""


def number(value: float) -> str:
    """A number with three significant digits."""
    shown = f"{value:.3g}"
    return f"{float(shown):.0f}" if 100 <= abs(value) < PLAIN else shown


def level(value: float) -> str:
    """A mean square over its expectation, with three digits."""
    return number(value) if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def pair(before: float, after: float | None) -> str:
    """A gap before and after; only the present one if nothing was changed."""
    return f"gap {level(before)}" + ("" if after is None or after == before else f" -> {level(after)}")


def percent(share: float) -> str:
    """A share in readable percent; never 100 % if a little is missing."""
    shown = f"{100 * share:.0f}"
    return f"{shown} %" if shown != "100" or share >= 1.0 else f"{min(100 * share, 99.9):.1f} %"


def quantity(value: float, unit: str, low: float | None = None, high: float | None = None) -> str:
    """A value in the unit that a lab uses, with its interval."""
    small = unit.startswith("rad") or max(abs(value), abs(high or 0.0)) < 1.0
    factor, shown = SCALES[unit] if unit in SCALES and small else (1.0, "" if unit == "1" else unit)
    text = number(factor * value)
    if low is not None and high is not None:
        text += f" ({number(factor * low)} to {number(factor * high)})"
    return f"{text} {shown}".strip()


def sizes(name: str, parameters: dict, alone: bool = False) -> str:
    """Values of an effect in words, with their intervals. parameters: of a `NamedEffect`. alone: leave out the effect's name."""
    many = len(parameters) > 1
    text = lambda p: quantity(p.value, p.unit, getattr(p, "low", None), getattr(p, "high", None))
    values = [f"{title(k) + ' ' if many else ''}{text(p)}" for k, p in parameters.items()]
    return f"{'' if alone else title(name) + ' '}{', '.join(values)}"


def untold(parameters: dict) -> str:
    """Warning if the interval of an effect's size contains 0, else "". parameters: of a `NamedEffect`."""
    units = [p.unit for p in parameters.values()][:1]
    main = [p for p in parameters.values() if p.unit in units]  # a parameter of shape has another unit
    holds = bool(main) and all(getattr(p, "low", 1.0) <= 0.0 <= getattr(p, "high", -1.0) for p in main)
    return "not distinguishable from zero: its interval contains 0" if holds else ""
