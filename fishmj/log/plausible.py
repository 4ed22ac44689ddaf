"""How large a value may be before its unit is doubted: `data/calib/plausible.toml`, relaxed by a trial's `[plausible]`."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from functools import cache

from fishmj.calib import calib_folder, read_toml
from fishmj.errors import LogError, UnknownName

FILE = "plausible.toml"
KEY = "plausible"  # of meta.toml


@dataclass(frozen=True)
class Plausible:
    """Bounds on magnitude, SI units and radians; a value outside is taken for a mistake of units."""

    angle: float  # rad, a joint
    rate: float  # rad/s
    reach: float  # m from the first row
    start: float  # m, the first row
    speed: float  # m/s
    turns: float  # of a heading before the first row
    period: float  # s, median time step
    tank: float  # m, a position in cm or mm
    voltage: float  # V, a supply
    voltage_least: float
    current: float  # A, of a supply
    current_least: float

    def span(self, name: str) -> tuple[float, float]:
        """(least, largest) of a bound."""
        return getattr(self, f"{name}_least", 0.0), getattr(self, name)

    def relaxed(self, said: Mapping, where: str) -> "Plausible":
        """These bounds with those of `said` in their place.

        Raises:
            LogError: a value is no positive number. UnknownName: no such bound.
        """
        known = [f.name for f in fields(self)]
        for name, value in said.items():
            if name not in known:
                raise UnknownName(f"bound in {where}", str(name)[:40], known)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise LogError(f"{where}: {name} = {str(value)[:40]!r}; expected a positive number, in SI units")
        return replace(self, **{name: float(value) for name, value in said.items()})


@cache
def shipped() -> Plausible:
    """The table that ships with fishmj.

    Raises:
        LogError: a bound is missing or no positive number. UnknownName: one that there is not.
    """
    path = calib_folder() / FILE
    found, names = read_toml(path), [f.name for f in fields(Plausible)]
    if missing := [name for name in names if name not in found]:
        raise LogError(f"{path}: lacks {', '.join(missing)}; install fishmj again")
    return Plausible(*[1.0] * len(names)).relaxed(found, str(path))


_SAID: ContextVar[Mapping | None] = ContextVar("said", default=None)  # on the command line


@contextmanager
def relaxing(said: Mapping) -> Iterator[None]:
    """Within: every table is read with these bounds in place of the shipped ones; a trial's own go before them."""
    shipped().relaxed(said, "--plausible")
    token = _SAID.set(said)
    try:
        yield
    finally:
        _SAID.reset(token)


def of_meta(meta: Mapping, where: str) -> Plausible:
    """The shipped bounds, relaxed by the command line and by the `[plausible]` table of a trial's meta data."""
    said = meta.get(KEY, {})
    if not isinstance(said, Mapping):
        raise LogError(f"{where}: {KEY} = {str(said)[:40]!r}; expected a table such as [{KEY}] reach = 5000.0")
    return shipped().relaxed(_SAID.get() or {}, "--plausible").relaxed(said, f"{where} [{KEY}]")


def told(text: str) -> dict[str, float]:
    """`reach=1000,speed=30` -> {"reach": 1000.0, "speed": 30.0}; values are checked by `relaxed`."""
    out = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        name, _, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise LogError(f"--plausible {part[:40]!r}: expected NAME=NUMBER, for example reach=1000") from None
    shipped().relaxed(out, "--plausible")
    return out
