"""Text of an effect to hide: `NAME`, `NAME=value` (first parameter) or `NAME:p=1,q=2`."""

from math import isfinite
from typing import NamedTuple

from fishmj.base.errors import ConfigError


class EffectText(NamedTuple):
    """Parsed text. main: value of the first parameter; listed: (parameter, value) pairs; None if the text has none."""

    name: str
    main: str | None
    listed: list[tuple[str, str]] | None


def split_text(text: str) -> EffectText:
    """Splits `text`; values remain text."""
    name, colon, rest = text.partition(":")
    if colon:
        pairs = [pair.partition("=") for pair in rest.split(",")]
        return EffectText(name, None, [(key.strip(), value) for key, _, value in pairs])
    name, equals, main = text.partition("=")
    return EffectText(name, main if equals else None, None)


def finite_number(asked: str, value: str, example: str) -> float:
    """Converts `value` to a finite number. Raises ConfigError, which begins with `asked` and shows the `example`."""
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not isfinite(number):
        raise ConfigError(f"{asked}: {value[:40]!r} is no finite number; write {example} (SI)")
    return number


def check_range(asked: str, name: str, value: float, low: float, high: float, unit: str) -> None:
    """Raises ConfigError, which begins with `asked`, unless low <= value <= high."""
    if not low <= value <= high:
        raise ConfigError(f"{asked}: {name} = {value:g}; expected {low:g} to {high:g} {unit}")
