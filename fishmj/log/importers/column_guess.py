"""A column's guessed meaning, and the files that share their columns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fishmj.log.importers import header
from fishmj.log.importers.cells import TIME_CODE
from fishmj.log.importers.column_map import measured
from fishmj.log.importers.column_units import SI, unit_of
from fishmj.log.importers.sheet import Sheet
from fishmj.log.limits import quoted

TAKEN, UNCLEAR, LEFT = "taken", "unclear", "left out"
TEXT = "its cells are text"  # of a column that should hold numbers
ROWS = 200_000  # of one file that the statistics look at


@dataclass(frozen=True)
class Guess:
    """Guessed meaning of one column of one kind of file."""

    kind: int
    column: str
    state: str = LEFT
    places: tuple[str, ...] = ()  # "cmd.c1"; "t" for stamps; several where it is unclear which
    unit: str = ""
    scale: float = 1.0
    why: str = ""
    said: bool = False  # by the user
    fits: tuple[str, ...] = ()  # units that its values allow, where its name says another

    @property
    def place(self) -> str:
        """First place of the guess, such as "cmd.c1"; "" without one."""
        return self.places[0] if self.places else ""

    @property
    def table(self) -> str:
        """Table of the first place."""
        return self.place.partition(".")[0]

    def left(self, why: str) -> "Guess":
        """Copy of the guess, left out."""
        return replace(self, state=LEFT, places=(), why=why)

    def unclear(self, why: str, **changes: Any) -> "Guess":
        """Copy of the guess, left to the user."""
        return replace(self, state=UNCLEAR, why=why, **changes)


@dataclass(frozen=True)
class FileKind:
    """Files with the same columns and names of the same meaning."""

    sheets: tuple[Sheet, ...]
    pattern: str  # of their names

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.sheets[0].columns)

    def called(self, name: str) -> bool:
        """Returns True if `name` is one of its columns, or a file or topic of it."""
        return name in self.sheets[0].columns or any(name == sheet.name for sheet in self.sheets)

    def doubt(self, column: str) -> str:
        """Reason from the file that the user must decide on a column; "" without one."""
        text = next((sheet.text[column] for sheet in self.sheets if column in sheet.text), "")
        if re.search(r"\d", text) and not np.isfinite(self.values(column)).any():
            unit = unit_of(text.lstrip("+-.,0123456789 "))
            named = f" and their unit, {unit}, in its name" if unit and not header.parse(column).unit else ""
            return f"{TEXT}, such as {quoted(text)}: write plain numbers{named}, or leave it out"
        return next((sheet.doubts[column] for sheet in self.sheets if column in sheet.doubts), "")

    def values(self, column: str) -> np.ndarray:
        """Values of a column (T,), all files one after the other."""
        return np.concatenate([sheet.columns[column][:ROWS] for sheet in self.sheets[:16]])


def context(sheet: Sheet) -> frozenset[str]:
    """Words in the name of a file or topic."""
    return frozenset(header.words(re.sub(r"\.[A-Za-z0-9]{1,8}\Z", "", sheet.name)))


def without_letter(column: str, columns: Sequence[str]) -> str:
    """Name of a column without the letter that tells alike columns apart: cmdA beside cmdB is no current."""
    stem, last = column[:-1], column[-1:]
    alike = {stem + letter for letter in ("ab" if last.islower() else "AB")} <= set(columns)
    return stem.rstrip("_-. ") or column if alike and last.isalpha() else column


def doubt(kind: FileKind, column: str, place: str) -> tuple[str, tuple[str, ...]]:
    """Reason that the user must decide on a column (its cells, or a unit without a factor), and what fits; "" without one."""
    other = header.parse(without_letter(column, kind.columns)).other
    if told := kind.doubt(column):
        return told, ("skip",) * told.startswith(TEXT)
    if not other or kind.sheets[0].units.get(column):
        return "", ()
    table, _, ours = place.replace("#", "1").partition(".")
    unit = "s" if place == "t" else SI.get(measured(table, ours)) or "m"
    return f"{other} is no unit that is known: say one with a scale, such as {unit}*0.3", (f"{unit}*SCALE",)


def doubted(kind: FileKind, g: Guess) -> Guess:
    """The guess, unclear if its cells or the unit in its name raise a doubt."""
    why, fits = doubt(kind, g.column, g.place)
    unit = fits[0].removesuffix("*SCALE") if fits else g.unit
    return g.unclear(why, unit=unit, fits=fits or g.fits) if why and (fits or g.state == TAKEN) else g


def stamps(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Takes, in a file without a named time, the only column that rises in every row and is in a unit of stamps: mcu_ms."""
    out = list(guesses)
    for k, kind in enumerate(found):
        mine = [i for i, g in enumerate(guesses) if g.kind == k]
        if any(guesses[i].place == "t" for i in mine) or all(guesses[i].state == LEFT for i in mine):
            continue
        units = {i: header.stamp_unit(guesses[i].column) for i in mine if guesses[i].state == LEFT and not guesses[i].said}
        rising = [i for i, unit in units.items() if unit and all(_rises(s.columns[guesses[i].column]) for s in kind.sheets)]
        if len(rising) == 1:
            i = rising[0]
            why = "no column is called a time, and it alone rises in a unit of time"
            out[i] = replace(guesses[i], state=TAKEN, places=("t",), unit=units[i], why=why)
    return out


def lost_time(kind: FileKind) -> str:
    """Reason that the column of a file which is called a time holds none; "" without such a column."""
    lost = next((c for c in kind.columns if header.role(header.parse(c), set()).places == ("t",)), "")
    cell = kind.sheets[0].text.get(lost, "")
    what = f"frames, {cell}: write seconds, s + frame / frames a second" if TIME_CODE.fullmatch(cell) else "no number"
    such = f", such as {quoted(cell)}" if cell and what == "no number" else ""
    return f"{quoted(lost)} holds {what}{such}" if lost else ""


def _rises(values: np.ndarray) -> bool:
    step = np.diff(values)
    return len(step) > 0 and bool((step >= 0).all()) and 2 * int((step > 0).sum()) > len(step)


def headings(guesses: list[Guess]) -> list[Guess]:
    """Asks about one angle without a number beside x and y: the heading of the fish, or the angle of a joint."""
    places, out = {(g.kind, g.place) for g in guesses}, list(guesses)
    free = [i for i, g in enumerate(guesses) if g.places == ("cmd.c#", "joint.j#") and (g.kind, "pose.x") in places]
    if len(free) == 1 and all(place != "pose.yaw" for _, place in places):
        if not header.parse(guesses[free[0]].column).has(header.SERVO):
            why = "an angle beside x and y: the heading, or a joint's?"
            out[free[0]] = guesses[free[0]].unclear(why, places=("pose.yaw", "joint.j#"))
    return out


def lost_commands(guesses: list[Guess], found: Sequence[FileKind]) -> list[Guess]:
    """Asks about left-out columns whose names, or their file's, speak of a command, in a log without: they may be these."""
    if any(g.place.startswith("cmd.") and g.state == TAKEN and not g.said for g in guesses):
        return guesses
    out = list(guesses)
    for k, kind in enumerate(found):
        mine = []
        told = header.ORDERED & context(kind.sheets[0]) and not any(g.kind == k and g.table == "target" for g in guesses)
        for i, g in enumerate(guesses):
            name = header.parse(g.column)
            speaks = told or name.has(header.COMMAND | header.SERVO)
            speaks = speaks and not name.has(header.RATE | header.HEADING | header.AXES)
            if g.kind == k and g.state == LEFT and not g.said and speaks and g.why in (header.UNKNOWN, header.NO_COLUMN):
                mine += [i] * (len(np.unique(kind.values(g.column)[np.isfinite(kind.values(g.column))])) > 1)
        said = sum(g.kind == k and g.said and g.place.startswith("cmd.c") for g in guesses)
        for n, i in enumerate(mine if len(mine) + said > 1 else []):
            why = f"{'its file' if told else 'its name'} speaks of a command, and the log has none; =skip leaves it out"
            out[i] = out[i].unclear(why, places=(f"cmd.c{said + n + 1}",))
    return out


def off_centre(guesses: list[Guess]) -> list[Guess]:
    """Asks about a pose of another point than the centre of mass, which the name of the column tells."""
    out = list(guesses)
    for i, g in enumerate(guesses):
        part = header.ENDS.intersection(header.parse(g.column).words)
        if part and g.state == TAKEN and not g.said and g.place in ("pose.x", "pose.y"):
            out[i] = g.unclear(f"the {part.pop()}; a pose is of the straight fish's centre of mass: shift it, or take it as is")
    return out


def without_holes(guesses: list[Guess], mine: list[int], template: str) -> list[Guess]:
    """Asks about the joints `mine` whose numbers, with those that the user said, do not count from 1: identities on a bus."""
    out, size, numbers = list(guesses), len(template), {i: int(guesses[i].place[len(template) :]) for i in mine}
    held = [g for g in guesses if g.said or (g.state == UNCLEAR and len(g.places) == 1)]  # the place of an unclear one is known
    said = [int(g.place[size:]) for g in held if g.place.startswith(template) and g.place[size:].isdecimal()]
    many = len(mine) + len(said)
    if sorted([*numbers.values(), *said]) == list(range(1, many + 1)) or len(set(numbers.values())) < len(mine):
        return out
    for i, own in numbers.items():
        free = [n for n in range(1, many + 1) if n not in said] + [own] * (own == many + 1)
        why = f"numbers {', '.join(map(str, sorted(numbers.values())))} have holes: which joint is it?"
        out[i] = guesses[i].unclear(why, places=tuple(f"{template}{n}" for n in free))
    return out
