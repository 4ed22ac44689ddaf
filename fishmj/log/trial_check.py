"""Checks a table or a meta dictionary against the schema, the same way on reading and on writing.

A breach is a `LogError` that begins with file:line:column (row number and column number for binary tables) and ends
with the fix. Absent or unusual things are returned as notes. The largest values before a unit is doubted stand in
`data/calib/plausible.toml`, relaxed by a trial's `[plausible]`.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np

from fishmj.base.calib import calib_folder, read_toml
from fishmj.base.errors import LogError, UnknownName
from fishmj.base.options import TURN
from fishmj.log.limits import listed, quoted
from fishmj.log.trial import META, ORIGINS, SCHEMA, YEAR, Table, TableSpec, gaps, look_up, table_spec

PLAUSIBLE = "plausible"  # of meta.toml
Place = Callable[[int, str], str]  # (row from 0 or -1 for the header, column name) -> "file:line:column"

_BOUNDS = {  # bound -> what a value does that is beyond it, and its unit
    **{"angle": ("is", "rad"), "turns": ("is", "rad"), "rate": ("is", "rad/s"), "speed": ("is", "m/s")},
    **{"start": ("starts at", "m"), "reach": ("goes away from its first row by", "m")},
    **{"period": ("has a median step of", "s"), "voltage": ("is usually", "V"), "current": ("is usually", "A")},
}
_LIMITS = {
    "angle": ("degrees; the schema says rad.", "Multiply the column by pi/180"),
    "rate": ("degrees per second; the schema says rad/s.", "Multiply the column by pi/180"),
    "speed": ("mm/s; the schema says m/s.", "Divide the column by 1000"),
}
_SUPPLY = {"V": "voltage", "I": "current"}  # of the table power: bound
_MILLIMETRES = "looks like millimetres or pixels; the schema says m."
_METRES = "Divide the column by 1000, or multiply it by the metres of a pixel"
SCALED = 0.1  # of a decade: how near to a factor of 10, 100, 1000 a change of units is
JUMP, AROUND = 5.0, 50  # m of a step that stays, and rows on either side that say whether it does
FAST = 1.999e-4  # s, a median step below which the unit of the stamps is doubted
STEP = 1e-3  # s; shorter steps of stamps are jitter
_STAMPS = ((3e3, "milliseconds", "1000"), (3e6, "microseconds", "1e6"), (math.inf, "nanoseconds", "1e9"))  # by the median step


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
    spike: float  # rad, of physical_checks from here on
    still: float  # of the command's span
    stale: float  # of the moving rows
    against: float  # correlation
    course: float  # rad
    hand: float  # correlation
    wave: float  # sine of a phase
    leap: float  # m/s, of a pose that comes back
    alternate: float  # distance between two sources over that within each
    gain: float  # movement of a joint over that of its command
    stride: float  # body lengths a beat
    sway: float  # of a body length for a radian of the head
    agree: float  # of two measured rates, times
    overlap: float  # of two tables of one swim, share of the longer

    def span(self, name: str) -> tuple[float, float]:
        """(least, largest) of a bound."""
        return getattr(self, f"{name}_least", 0.0), getattr(self, name)

    def relaxed(self, said: Mapping, where: str) -> "Plausible":
        """Copy of the bounds with those of `said` in their place.

        Raises LogError: a value is no positive number; UnknownName: no such bound.
        """
        known = [f.name for f in fields(self)]
        for name, value in said.items():
            if name not in known:
                raise UnknownName(f"bound in {where}", str(name)[:40], known)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise LogError(f"{where}: {name} = {str(value)[:40]!r}; expected a positive number, in SI units")
        return replace(self, **{name: float(value) for name, value in said.items()})


@cache
def shipped_bounds() -> Plausible:
    """The bounds that ship with fishmj.

    Raises LogError: a bound is missing or no positive number; UnknownName: an unknown bound.
    """
    path = calib_folder() / "plausible.toml"
    found, names = read_toml(path), [f.name for f in fields(Plausible)]
    if missing := [name for name in names if name not in found]:
        raise LogError(f"{path}: lacks {', '.join(missing)}; install fishmj again")
    return Plausible(*[1.0] * len(names)).relaxed(found, str(path))


_SAID: ContextVar[Mapping | None] = ContextVar("said", default=None)  # on the command line


@contextmanager
def relaxed_bounds(said: Mapping) -> Iterator[None]:
    """Context in which every table is read with these bounds in place of the shipped ones; a trial's own take precedence."""
    shipped_bounds().relaxed(said, "--plausible")
    token = _SAID.set(said)
    try:
        yield
    finally:
        _SAID.reset(token)


def bounds_of(meta: Mapping, where: str) -> Plausible:
    """The shipped bounds, relaxed by the command line and by the `[plausible]` table of a trial's meta data."""
    said = meta.get(PLAUSIBLE, {})
    if not isinstance(said, Mapping):
        raise LogError(f"{where}: {PLAUSIBLE} = {str(said)[:40]!r}; expected a table such as [{PLAUSIBLE}] reach = 5000.0")
    return shipped_bounds().relaxed(_SAID.get() or {}, "--plausible").relaxed(said, f"{where} [{PLAUSIBLE}]")


def read_bounds(text: str) -> dict[str, float]:
    """Parses `reach=1000,speed=30` to {"reach": 1000.0, "speed": 30.0}; `relaxed` checks the values."""
    out = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        name, _, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise LogError(f"--plausible {part[:40]!r}: expected NAME=NUMBER, for example reach=1000") from None
    shipped_bounds().relaxed(out, "--plausible")
    return out


class Implausible(LogError):
    """A value beyond the bounds of a log, so that its unit is doubted.

    column: of the schema. value: in `si`, described by `verb`; span: of a plausible log; bound: its name in plausible.toml.
    """

    def __init__(self, place: str, fault: str, fix: str, column: str, value: float, bound: str, bounds: Plausible):
        super().__init__(f"{place}: {fault} {fix}")
        low, high = bounds.span(bound)
        self.place, self.column, self.value = place, column, value
        self.span = (low, high * 2 * math.pi if bound == "turns" else high)
        (self.verb, self.si), self.bound = _BOUNDS[bound], f"{bound}_least" if abs(value) < low else bound

    @property
    def value_and_range(self) -> str:
        """Found value and plausible range in words, without advice."""
        low, high = self.span
        allowed = f"{low:g} to {high:.4g}" if low else f"at most {high:.4g}"
        return f"{self.verb} {self.value:.4g} {self.si}; plausible is {allowed}"


def check_table(name: str, table: Table, place: Place, bounds: Plausible | None = None) -> list[str]:
    """Raises `LogError` for the first breach of the schema; returns notes about gaps and extra columns.

    Args:
        bounds: on magnitude; the shipped ones when None.
    """
    spec, bounds = table_spec(name), bounds or shipped_bounds()
    _check_shapes(name, table, place)
    extra = check_columns(name, spec, list(table), place)
    for column, values in table.items():
        _check_finite(column, values, place)
    told = [f"{name}: {note}" for note in _check_time(table["t"], place, bounds)]
    for column, values in table.items():
        _check_units(spec.kind(column), column, values, table["t"], place, bounds)
        if name == "power" and column in _SUPPLY:
            _check_supply(column, np.asarray(values, float), place, bounds)
    notes = told + [note for c in table if spec.kind(c) == "position" for note in _strays(name, c, table, place, bounds)]
    if extra:
        notes.append(f"{name}: {', '.join(map(quoted, extra))} {'are' if extra[1:] else 'is'} not in the schema; kept")
    pauses = gaps(table["t"])
    if spec.continuous and len(pauses):
        t = np.asarray(table["t"], float)
        longest = int(pauses[np.argmax(np.diff(t)[pauses])])
        notes.append(
            f"{name}: {len(pauses)} gap(s) over 0.1 s, the first after t = {t[pauses[0]]:.3f} s, the longest a gap of "
            f"{t[longest + 1] - t[longest]:.6g} s after t = {t[longest]:.3f} s ({place(longest + 1, 't')}); "
            "segments(trial) splits there"
        )
    return notes


def check_columns(name: str, spec: TableSpec, columns: list[str], place: Place) -> list[str]:
    """Raises for a missing column; returns the columns that the schema does not name."""
    missing = [column for column in spec.fixed if column not in columns]
    counts = {template: _count(template, columns) for template in spec.numbered}
    n = max([1, *counts.values()])
    missing += [t.replace("#", str(i)) for t in spec.numbered for i in range(1, n + 1) if t.replace("#", str(i)) not in columns]
    if missing:
        raise LogError(
            f"{place(-1, columns[-1] if columns else '')}: table {name!r} lacks column {', '.join(map(repr, missing))}; "
            f"it has {listed(columns) or 'none'}; expected {spec.describe()}. Add the column or rename the one that means it"
        )
    known = {*spec.fixed, *spec.numbered, *spec.optional, *spec.host}
    return [column for column in columns if re.sub(r"\d+", "#", column) not in known and column not in known]


def check_meta(meta: dict, where: str) -> list[str]:
    """Raises `LogError` for an impossible value; returns a note on missing keys of a log that fishmj did not write."""
    schema = meta.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise LogError(f"{where}: schema = {schema!r}; expected {SCHEMA!r}. Convert the trial or use the fishmj that wrote it")
    origin = meta.get("origin")
    if origin is not None and origin not in ORIGINS:
        raise LogError(f"{where}: origin = {origin!r}; expected one of {', '.join(map(repr, ORIGINS))}")
    speed, direction = (_number(meta, key, where) for key in ("flow.speed", "flow.direction"))
    if speed < 0:
        raise LogError(f"{where}: flow.speed = {speed} m/s is negative; turn flow.direction by pi instead")
    if abs(direction) > TURN[1]:
        raise LogError(f"{where}: flow.direction = {direction} looks like degrees; the schema says rad. Multiply it by pi/180")
    own = str(meta.get("source") or "").startswith("fishmj")  # states all that it knows
    missing = [key for key in META if not own and look_up(meta, key) is None]
    return [f"{where}: missing {', '.join(missing)}"] if missing else []


def check_counts(tables: dict[str, Table], meta: dict) -> list[str]:
    """Notes about tables and meta data that disagree on the number of joints."""
    templates = {"cmd": "c#", "joint": "j#", "truth": "j#"}
    counts = {name: _count(template, list(tables[name])) for name, template in templates.items() if name in tables}
    counts |= {name: _count(t, list(tables[name])) - 1 for name, t in (("flow", "u#x"), ("wrench", "m#")) if name in tables}
    counts |= {"meta": meta["joints"]} if counts and isinstance(meta.get("joints"), int) else {}
    if len(set(counts.values())) < 2:
        return []
    return ["number of joints differs: " + ", ".join(f"{name} {count}" for name, count in counts.items())]


def _number(meta: dict, key: str, where: str) -> float:
    """Finite number behind `key`, 0 if the key is absent."""
    value = look_up(meta, key, 0.0)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise LogError(f"{where}: {key} = {value!r}; expected a finite number, or leave the key out when it is unknown")
    return float(value)


def _count(template: str, columns: list[str]) -> int:
    """The highest number N of a template's columns."""
    pattern = re.compile(re.escape(template).replace(r"\#", r"([1-9]\d{0,2})") + r"\Z")
    return max([int(m.group(1)) for m in map(pattern.match, columns) if m], default=0)


def _check_shapes(name: str, table: Table, place: Place) -> None:
    lengths = {}
    for column, values in table.items():
        if not isinstance(values, np.ndarray) or values.ndim != 1 or values.dtype.kind not in "fiub":
            got = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
            raise LogError(f"{place(-1, column)}: column {column!r} of {name!r} must be a 1-d array of numbers, got {got}")
        lengths[column] = len(values)
    if len(set(lengths.values())) > 1:
        shapes = ", ".join(f"{c} {n}" for c, n in lengths.items())
        raise LogError(f"{place(-1, 't')}: columns of {name!r} differ in length: {shapes}. Give every column one value a row")
    if not lengths or not next(iter(lengths.values())):
        raise LogError(f"{place(-1, 't')}: table {name!r} has no rows; leave an empty table out of the trial")


def _check_finite(column: str, values: np.ndarray, place: Place) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        rows = f" ({len(bad)} such rows)" if len(bad) > 1 else ""
        raise LogError(
            f"{place(int(bad[0]), column)}: column {column!r} is {float(values[bad[0]])}{rows}; values must be finite numbers. "
            "Leave the row out (a gap over 0.1 s splits the trial) or leave the column out"
        )


def _check_time(t: np.ndarray, place: Place, bounds: Plausible) -> list[str]:
    notes: list[str] = []
    step = np.diff(np.asarray(t, float))
    back = np.flatnonzero(step <= 0)
    if len(back):
        i = int(back[0])
        verb = "goes back" if step[i] < 0 else "stands still"
        raise LogError(
            f"{place(i + 1, 't')}: time {verb}: {float(t[i + 1]):.6f} s after {float(t[i]):.6f} s; stamps must rise. "
            "Sort the rows by t, remove repeated ones, or split the trial where the clock was set"
        )
    middle = float(np.median(step)) if len(step) else 0.0
    if middle > bounds.period:
        unit, factor = next((unit, factor) for limit, unit, factor in _STAMPS if middle < limit)
        raise Implausible(
            place(1, "t"),
            f"the median step is {middle:g} s, which looks like {unit}; the schema says s.",
            f"Divide the column by {factor}",
            *("t", middle, "period", bounds),
        )
    if 0 < middle < FAST:
        notes.append(f"the median step is {middle:.3g} s, {1 / middle:.3g} rows a second: are the stamps in s?")
    jumps = np.flatnonzero(step > YEAR)
    if len(jumps):
        i = int(jumps[0])
        raise LogError(
            f"{place(i + 1, 't')}: time jumps by {step[i]:.6g} s after t = {float(t[i]):.6g} s, which is more than a year; "
            "was the clock set? Split the file there"
        )
    return notes


def _check_units(kind: str, column: str, values: np.ndarray, t: np.ndarray, place: Place, bounds: Plausible) -> None:
    if kind == "heading":
        _check_heading(column, np.asarray(values, float), np.asarray(t, float), place, bounds)
    elif kind == "position":
        _check_position(column, np.asarray(values, float), np.asarray(t, float), place, bounds)
    elif kind:
        looks, fix = _LIMITS[kind]
        bad = np.flatnonzero(np.abs(values) > getattr(bounds, kind))
        if len(bad):
            row, value = int(bad[0]), float(values[bad[0]])
            fault = f"column {column!r}: {value:g} looks like {looks}"
            raise Implausible(place(row, column), fault, fix, column, value, kind, bounds)


def _check_supply(column: str, values: np.ndarray, place: Place, bounds: Plausible) -> None:
    """Checks a supply by its usual value; a supply that is off, or an inrush, says nothing about the unit."""
    value, (low, high) = usual(values), bounds.span(_SUPPLY[column])
    below = int(np.sum(values < 0))
    if column == "V" and 2 * below > np.count_nonzero(values):
        first = int(np.argmax(values < 0))
        raise LogError(
            f"{place(first, column)}: column {column!r}: {values[first]:g} V, and negative in {below} of {len(values)} rows; a"
            " supply's voltage is positive: is there no sensor? Leave the column out (--set COLUMN=skip on import), or give it"
            " sign = -1 in a map"
        )
    if value and not low <= value <= high:
        si = _BOUNDS[_SUPPLY[column]][1]
        looks, fix = (f"k{si}", "Multiply") if value < low else (f"m{si}", "Divide")
        raise Implausible(
            place(int(np.argmax(np.abs(values) >= value)), column),
            f"column {column!r}: usually {value:g}, which looks like {looks}; the schema says {si}.",
            f"{fix} the column by 1000",
            *(column, value, _SUPPLY[column], bounds),
        )


def usual(values: np.ndarray) -> float:
    """Median magnitude of the values that are not zero; 0 if all are."""
    some = np.abs(values[np.isfinite(values) & (values != 0)])
    return float(np.median(some)) if len(some) else 0.0


def _check_position(column: str, x: np.ndarray, t: np.ndarray, place: Place, bounds: Plausible) -> None:
    """Checks a position by its travel and speed; distance from the origin proves nothing (a boat, a grid of a map)."""
    away = np.flatnonzero(np.abs(x - x[0]) > bounds.reach)
    if abs(x[0]) > bounds.start:
        bad, told, value, name = 0, f"starts at {x[0]:g}", float(x[0]), "start"
    elif len(away):
        value = float(abs(x[away[0]] - x[0]))
        bad, told, name = int(away[0]), f"{x[away[0]]:g} is {value:g} from the first row", "reach"
    elif (row := _level(x, t, bounds)) >= 0:
        raise LogError(
            f"{place(row + 1, column)}: column {column!r} goes from {x[row]:g} to {x[row + 1]:g} in {t[row + 1] - t[row]:.3g} s "
            "and stays there: m before, cm, mm or px after? Split the file there; if the fish was put there, allow it with a "
            "larger speed in [plausible] of meta.toml, or --plausible speed=... on import"
        )
    elif len(x) > 10 and (pace := _pace(x, t)) > bounds.speed:
        bad, told, value, name = 1, f"moves {pace:.3g} a second", pace, "speed"
    else:
        return
    raise Implausible(
        place(bad, column),
        f"column {column!r}: {told}, which {_MILLIMETRES}",
        f"{_METRES}; if it is m, allow it with a larger {name} in [plausible] of meta.toml, or --plausible {name}=... on import",
        *(column, value, name, bounds),
    )


def _steps(x: np.ndarray, t: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows after which a position moves faster than any swimmer."""
    return np.flatnonzero(np.abs(np.diff(x)) > bounds.speed * np.maximum(np.diff(t), STEP))


def _level(x: np.ndarray, t: np.ndarray, bounds: Plausible) -> int:
    """Row after which a position is permanently 10, 100 or 1000 times larger, metres away; -1 if there is none.

    A jump alone is no change of units: satellite fixes also return metres from the last one.
    """
    for row in _steps(x, t, bounds)[:100]:
        before, after = np.median(x[max(row - AROUND, 0) : row + 1]), np.median(x[row + 1 : row + 2 + AROUND])
        small, large = sorted((abs(before), abs(after)))
        power = math.log10(large) - math.log10(small) if small > 0 else 0.0  # their ratio may be infinite
        units = round(power) in (1, 2, 3) and abs(power - round(power)) < SCALED
        if units and min(abs(after - before), abs(x[row + 1] - x[row])) > JUMP:
            return int(row)
    return -1


def _strays(name: str, column: str, table: Table, place: Place, bounds: Plausible) -> list[str]:
    rows = _steps(np.asarray(table[column], float), np.asarray(table["t"], float), bounds)
    if name == "target" or not len(rows):
        return []
    first = place(int(rows[0]) + 1, column)
    return [f"{name}: {column} steps faster than {bounds.speed:g} m/s {len(rows)} time(s), first at {first}: a stray fix?"]


def _pace(x: np.ndarray, t: np.ndarray) -> float:
    """Median speed over a second, so that the noise of a fix does not count."""
    rows = int(np.clip(round(1.0 / max(float(np.median(np.diff(t))), 1e-9)), 1, len(x) - 1))
    return float(np.median(np.abs(x[rows:] - x[:-rows]) / (t[rows:] - t[:-rows])))


def _check_heading(column: str, yaw: np.ndarray, t: np.ndarray, place: Place, bounds: Plausible) -> None:
    """Checks a heading by its start and its turning rate: unwrapped headings may add up turns, so size alone proves nothing."""
    bad, most = -1, bounds.turns * 2 * math.pi
    if abs(yaw[0]) > most:
        bad = 0
    elif len(yaw) > 2:
        turn = np.abs((np.diff(yaw) + math.pi) % (2 * math.pi) - math.pi)
        rate = turn / np.diff(t)
        if np.quantile(rate, 0.9) > bounds.rate and np.max(np.abs(yaw)) > 2 * math.pi:
            bad = int(np.argmax(np.abs(yaw)))
    if bad >= 0:
        raise Implausible(
            place(bad, column),
            f"column {column!r}: {yaw[bad]:g} looks like degrees; the schema says rad.",
            "Multiply the column by pi/180",
            *(column, float(yaw[bad]), "turns", bounds),
        )
