"""Layout of a text table: its separator, its first row of values, and the names and units of its columns in the rows above.

The rows of values decide. The separator is the mark that cuts most of the first lines into equally many cells, most of them
numbers, dates or blanks. The last row above the values names the columns, apart from a row of units. Repeated or blank names get
those of the rows above in front: `nose` over `x` is `nose x`. Rows above that add nothing are titles.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from fishmj.base.errors import LogError
from fishmj.log.importers import motive
from fishmj.log.importers.cells import BLANKS, is_number, is_value
from fishmj.log.importers.column_units import other_unit, unit_of
from fishmj.log.importers.header import AXES, COMMAND, HEADING, JOINT, MEASURED, SERVO, TIME, words
from fishmj.log.limits import COLUMNS, quoted

HEAD = 40  # lines that are looked at
SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", " ": "blanks"}
_BLANK_CELL = re.compile(r'"([^"]*)"(?=\s|\Z)|(\S+)')
_BRACKETS = "[](){}<>"
NAMES = AXES | COMMAND | HEADING | JOINT | MEASURED | SERVO  # words that no unit begins with
UNITLESS = ("-", "--", "\N{EN DASH}", "\N{EM DASH}", "n/a", "none", "counts", "ticks")  # of a column, in a row of units
Lines = Sequence[tuple[int, str]]  # (number in the file, text)


@dataclass(frozen=True)
class Layout:
    """Separator, names, and units by name of the columns of one file, and notes.

    above: lines before the first row of values. line: of the names, in the file. settings: of a Motive export.
    """

    mark: str
    names: list[str]
    units: dict[str, str]
    above: int
    line: int
    notes: tuple[str, ...] = ()
    settings: tuple[tuple[str, str], ...] = ()

    def cut(self, line: str) -> list[str]:
        """Cells of a line, without blank ones beyond the last column."""
        fields = split(line, self.mark)
        if len(fields) == len(self.names) - 1 and self.names[-1].lower() == "comment":  # LabVIEW writes none
            fields.append("")
        while len(fields) > len(self.names) and not fields[-1].strip():
            fields.pop()
        return fields


def split(line: str, mark: str) -> list[str]:
    """The cells of a line."""
    if mark == " ":
        return [quoted_cell or cell for quoted_cell, cell in _BLANK_CELL.findall(line)]
    if '"' in line:
        try:
            return next(csv.reader([line], delimiter=mark), [])
        except csv.Error:
            return line.split(mark)
    return line.split(mark)


def find(path, head: Lines, comment: str, said: str) -> Layout:
    """Finds the layout of a file from its first lines.

    Args:
        comment: the last line of comment above them, without its mark. said: the separator that the file itself states, or "".

    Raises LogError: at file:line, one column only, no names, or a name twice.
    """
    mark, first = _rows(head, [said] if said else list(SEPARATORS))
    if not mark:
        mark, first = said or _separator(path, head, comment), 1
    rows = [[cell.strip() for cell in split(line, mark)] for _, line in head]
    values = [row for row in rows[first:] if _is_row(row)]
    if first == 0 or (first == 1 and all(is_number(cell) for cell in rows[0])):
        named = [name.strip() for name in split(comment, mark)] if comment else []
        if len(named) != len(rows[0]) or all(map(is_number, named)):
            raise LogError(
                f"{path}:{head[0][0]}:1: the first row holds numbers; write the names of the columns there, such "
                "as time_s,servo1_deg"
            )
        return Layout(mark, _checked(path, head[0][0], named)[0], {}, 0, head[0][0], _separated(mark))
    row, units = first - 1, []
    if first > 1 and (told := _units(rows[row])) and len(_without_end(rows[row - 1])) >= len(_without_end(rows[row])):
        row, units = row - 1, told
    line, notes = head[row][0], []
    settings = motive.settings(rows[0])
    if settings:
        names, used = motive.names(path, line, rows[1 : row + 1]), row
    else:
        names, used = _composed(rows[: row + 1])
    while len(names) > 1 and not names[-1]:
        names.pop()
    width = len(_without_end(values[0], len(names))) if values else len(names)
    if width == len(names) + 1 and _counts([r[0] for r in values]):
        names = ["row", *names]
        notes.append("the first column has no name and counts the rows; called 'row'")
    names, told = _checked(path, line, names)
    if above := row - used:
        notes.append(f"{above} row(s) of titles above the names of the columns left out")
    units = units[: len(names)] + [""] * (len(names) - len(units))
    names = [f"{name} [{unit}]" if other_unit(unit) else name for name, unit in zip(names, units, strict=True)]
    known = {name: unit for name, unit in zip(names, units, strict=True) if unit and not other_unit(unit)}
    return Layout(mark, names, known, first, line, (*notes, *told, *_separated(mark)), settings)


def _separated(mark: str) -> tuple[str, ...]:
    return () if mark == "," else (f"columns are separated by {SEPARATORS.get(mark, quoted(mark))}",)


def _is_row(cells: Sequence[str]) -> bool:
    """Returns True if most cells that are not blank are numbers or dates."""
    filled = [cell for cell in cells if cell.strip().lower() not in BLANKS]
    return len(cells) > 1 and bool(filled) and 2 * sum(map(is_value, filled)) >= len(filled)


def holds_values(lines: Sequence[str]) -> bool:
    """Returns True for lines with a table: two rows of one width, most of their cells values and one a number at least."""
    for mark in SEPARATORS:
        widths = [len(row) for row in (split(line, mark) for line in lines) if _is_row(row) and _values(row) > 1]
        if len(set(widths)) < len(widths):
            return True
    return False


def _values(cells: Sequence[str]) -> int:
    """Number of values among cells; 0 if all are dates."""
    return sum(map(is_value, cells)) if any(map(is_number, cells)) else 0


def _rows(head: Lines, marks: Sequence[str]) -> tuple[str, int]:
    """(separator, index of the first row of values); ("", 0) if there are no such rows."""
    best: tuple[int, bool, str, int] = (0, False, "", 0)
    for mark in marks:
        cells = [split(line, mark) for _, line in head]
        good = [_is_row(row) for row in cells]
        for k in range(len(cells)):
            if not all(good[k : k + 3]) or (k and all(map(is_number, filter(None, cells[k - 1])))):
                continue
            size = len(cells[k])
            like = sum(ok and abs(len(row) - size) <= size // 2 for row, ok in zip(cells[k:], good[k:], strict=True))
            if 2 * like < len(cells) - k:
                continue
            fits = bool(k) and len(cells[k - 1]) == len(cells[k])
            if (like, fits) > best[:2]:
                best = (like, fits, mark, k)
            break
    return best[2], best[3]


def _without_end(cells: Sequence[str], least: int = 0) -> list[str]:
    """Cells without the blank ones at the end, but at least `least` of them."""
    out = list(cells)
    while len(out) > least and not out[-1].strip():
        out.pop()
    return out


def _separator(path, head: Lines, comment: str) -> str:
    """Separator of a file without rows of values: the mark that cuts its first line into most cells."""
    first = comment if comment and all(map(is_number, re.split(r"[;,\t| ]+", head[0][1].strip()))) else head[0][1]
    best, most = "", 1
    for mark in SEPARATORS:
        counts = [len(split(line, mark)) for _, line in head[1:] or head]
        fields = len(split(first, mark))
        if fields > most and sum(count in (fields, fields + 1) for count in counts) * 2 >= len(counts):
            best, most = mark, fields
            if mark in ";\t":
                break
    if best:
        return best
    for mark in SEPARATORS:
        if mark in first.strip():
            return mark
    raise LogError(
        f"{path}:{head[0][0]}:1: one column only, {quoted(first)}; expected columns separated by commas, "
        "semicolons, tabs or blanks"
    )


def _units(cells: Sequence[str]) -> list[str]:
    """Units of a row of units, "" for a cell without one; empty if it is no such row."""
    bare = [cell.strip().strip(_BRACKETS) for cell in cells]
    filled = [cell for cell in bare if cell and cell.lower() not in UNITLESS]
    units = [unit_of(cell) or other_unit(cell) for cell in bare]
    known = sum(map(bool, units))
    named = any(is_number(cell) or not TIME.isdisjoint(words(cell)) for cell in filled)  # t (s) is a name
    named |= any(not NAMES.isdisjoint(words(cell)[:1]) for cell in filled)
    return units if known and 2 * known >= len(filled) and not named else []


def _composed(rows: Sequence[Sequence[str]]) -> tuple[list[str], int]:
    """Names from the last of `rows` and from as many rows above it as make them differ, and the number of those rows."""
    names, used = list(rows[-1]), 0
    while any(not name for name in names[1:-1]) or len(set(filter(None, names))) < len(list(filter(None, names))):
        if used + 1 >= len(rows):
            return list(rows[-1]), 0
        above = rows[-2 - used]
        if len(above) > len(names) or sum(map(bool, above)) < 2:
            return list(rows[-1]), 0
        last, filled = "", []
        for k in range(len(names)):
            last = (above[k] if k < len(above) else "") or last
            filled.append(last)
        names = [f"{front} {name}".strip() for front, name in zip(filled, names, strict=True)]
        used += 1
    return names, used


def _counts(cells: Sequence[str]) -> bool:
    """Returns True if cells count up by one."""
    whole = [int(cell) for cell in cells if cell.isdecimal()]
    return len(whole) == len(cells) > 1 and all(b - a == 1 for a, b in zip(whole, whole[1:], strict=False))


def _checked(path, line: int, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Unique names, with blank ones filled, and notes."""
    if len(names) > COLUMNS:
        raise LogError(f"{path}:{line}:1: {len(names)} columns; at most {COLUMNS} are read. Is it a picture or a matrix?")
    out: list[str] = []
    notes = []
    for k, name in enumerate(names):
        if not name:
            name = f"unnamed {k + 1}"
            notes.append(f"column {k + 1} has no name; called {name!r}")
        if name in out:
            raise LogError(f"{path}:{line}:1: column {quoted(name)} appears twice; rename or remove one of them")
        out.append(name)
    return out, notes
